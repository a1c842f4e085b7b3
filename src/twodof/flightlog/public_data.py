"""Public flight logs of a real drone and files of other programs: their addresses, and the search for them.

Seven logs of an ANT-X 2DoF Drone, published under the MIT licence in two repositories of M. Di Mauro. They are not part
of this package. A log is searched in the folder TWODOF_FLIGHT_DATA, then in the cache, and downloaded otherwise. Its
checksum is verified each time. FOREIGN_FILES come from the tests of programs that write such files; ours read them
where they are at hand.
"""

import hashlib
import os
import threading
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from types import MappingProxyType

from twodof.errors import DownloadError, LogError
from twodof.flightlog.atomic import atomic_write

VARIABLE = "TWODOF_FLIGHT_DATA"
MAX_BYTES = 1 << 26

_RAW = "https://raw.githubusercontent.com/MattiaDiMauro"
_COURSE = (
    f"{_RAW}/Modeling-Identification-and-Control-of-a-2-DoF-Quadrotor-ANT-X-/f8ab3e060070b564418aed3f9dbb57f57b796819"
)
_ESTIMATION = (
    f"{_RAW}/Model-identification-and-state-estimation-for-a-multirotor-UAV/83867039b2bf01ede021cf451a3f7bd96d69cf7f"
)


@dataclass(frozen=True)
class PublicLog:
    """One published log: its name in twodof and the suffix of its file, its address and its checksum.

    `gains` names the gains that flew. Simulations are compared with the channels `compared` of the log in `window` [s],
    a start and an end on the log's time axis.
    """

    name: str
    url: str
    sha256: str
    text: str
    gains: str = "default"
    window: tuple[float, float] = (0.0, 0.0)
    compared: tuple[str, ...] = ()
    suffix: str = ".mat"

    @property
    def file(self) -> str:
        """Return the name of its file."""
        return f"{self.name}{self.suffix}"


_ROWS = (
    PublicLog(
        "free-response-impulse",
        f"{_COURSE}/Lab01_part2/part2/log_0_2024-5-22-17-22-44_2dd.mat",
        "a7237be432402776f2ea7fe59f930c5ad2ede2ab818aeeceec19c25c5c78ebcc",
        "1DoF, open loop, rotors off: M = 0.1 for 0.196 s, then the free response",
        window=(188.30, 197.50),
        compared=("q",),
    ),
    PublicLog(
        "doublet-0.03",
        f"{_COURSE}/Lab01_part2/part2/log_1_2024-5-22-17-23-18_2dd.mat",
        "fbe156ac02db31d96af38ceecd415446b59d4831805f25484ffd00b0d4364af6",
        "1DoF, open loop, T = 0.4: doublet of M, +-0.03 about the trim",
        window=(244.70, 245.75),
        compared=("q",),
    ),
    PublicLog(
        "attitude-steps-10deg-default",
        f"{_COURSE}/Lab01_part1/part1/log_0_2024-5-22-17-21-28_2dd.mat",
        "82844fcca31dcf21ad67afa730e18007cc31327f62d5fa7af21080d4bbea1986",
        "1DoF, attitude loop, default gains: steps of 10 deg",
        window=(127.50, 135.80),
        compared=("theta", "q"),
    ),
    PublicLog(
        "attitude-steps-10deg-student",
        f"{_COURSE}/Lab03/Data/log_5_2024-5-22-17-26-58_2dd.mat",
        "9689c4ab9b915b17c87061544f5a12fb614373b93894fa88aae09e5506734710",
        "1DoF, attitude loop, student gains: steps of 10 deg",
        gains="student",
        window=(6.70, 15.00),
        compared=("theta", "q"),
    ),
    PublicLog(
        "rate-doublets-30dps-student",
        f"{_COURSE}/Lab02/Data/log_4_2024-5-22-17-25-08_2dd.mat",
        "fcdf079a5b4f4425bb82aa9d20e9d62fbed1c2f6755c6b350b5bb5f226d9ba41",
        "1DoF, pitch-rate loop, student gains: three doublets of 30 deg/s",
        gains="student",
        window=(346.60, 355.60),
        compared=("q",),
    ),
    PublicLog(
        "velocity-doublets-0.25",
        f"{_COURSE}/Lab04/log_1_2024-5-22-17-21-22_2dd.mat",
        "801ebe060f67aa2dbc88323c82fdc89f388646e89451393fbb832861ce2d52e4",
        "2DoF, velocity loop, student gains: doublets of 0.25 m/s",
        gains="student",
        window=(150.80, 160.50),
        compared=("theta", "v"),
    ),
    PublicLog(
        "position-sweep-default",
        f"{_ESTIMATION}/log_2_2024-5-22-17-28-50_2dd%20%281%29.mat",
        "e40bc492c1cd3ac314eefe1220dd3866315f2aa0f873cf9c0a5f6c91a32e1244",
        "2DoF, position loop, default gains: sweep of 0.2 m, 0.1 to 1 Hz",
        window=(133.00, 159.40),
        compared=("x", "v"),
    ),
)
PUBLIC_LOGS: Mapping[str, PublicLog] = MappingProxyType({row.name: row for row in _ROWS})

_REPOSITORIES = {
    "pyulog": "https://raw.githubusercontent.com/PX4/pyulog/3cf17793f14709713ab297d3743314c658874068/test",
    "scipy": "https://raw.githubusercontent.com/scipy/scipy/v1.17.1/scipy/io/matlab/tests/data",
    # Both keep them in Git LFS, which this host serves.
    "mcap": "https://media.githubusercontent.com/media/foxglove/mcap/95d0673564eac0b27fd9a8616083fdd47c4c2ec7",
    "ulog": "https://media.githubusercontent.com/media/foxglove/ulog/fcb6db0820b47829c09262588764fe2cf3af9471",
}
_FILES = """
ulog-px4-2016 pyulog sample.ulg 81952e6059bc095717e7911c010e07f85749d6b04d332a5ffc51575a3fd0a558
ulog-px4-2019-appended pyulog sample_appended_multiple.ulg
    daf30f3224303e39d5c97701e048e84ba04480797e369502331f45ab2e99a2b7
ulog-px4-small pyulog sample_log_small.ulg 68d1020f688109f027dba08d2950247cc0ae34aaefdcf37e4a7d60838f3e1aa3
ulog-px4-tagged pyulog sample_logging_tagged_and_default_params.ulg
    32f564608d46caf5a4cbb1cb0cd0dc839fb9512b06c6d1384fb96ec3d6c9173d
ulog-px4-events pyulog sample_px4_events.ulg 4b43a23a7b7f649004facba5c7835d800bbc8cc13e71cbc96678d971451e3d7e
ulog-truncated ulog tests/truncated.ulg da9ec75b12b92b98bdf6974d578679d416459bfe7102b8820dc982f696e1f423
mcap-demo mcap testdata/mcap/demo.mcap b90a0af442bfc6aaf31d7ae0a361f04d2a4eecca7168f9917391b74697af5c8c
mcap-one-message mcap tests/conformance/data/OneMessage/OneMessage-ch-chx-mx-pad-rch-rsh-st-sum.mcap
    f380e836539fa2bab3d2de4b052aaef82fac40d7a506d994a283f480345daf62
mcap-one-attachment mcap tests/conformance/data/OneAttachment/OneAttachment-ax-pad-st-sum.mcap
    37faf0439dcf55de3be64cff668371987dfafab1f9e78102c74845716ed78a5b
mcap-not-closed mcap rust/mcap/tests/data/chunk_not_closed.mcap
    7b49182be8db86f194a34617cab44720d50460d9caa7ec54cbcf5c19700b8578
matlab-two-vectors scipy testmulti_7.4_GLNX86.mat 62be182823f6ef231694ae5438adc1004380c8cafe9b4c9819c8fcbf5b42c7e2
matlab-hdf5 scipy testhdf5_7.4_GLNX86.mat 66855b1a4dfcfcc0a9a59d0b46be8e134ec72fc641e2b1d780c8fd2f05018068
matlab-v4 scipy test_mat4_le_floats.mat db1be7dc2838d37f6c84997ad93f9b1fe55e54ffdb2adc1daaf19f231bfc149e
matlab-object scipy testobject_7.4_GLNX86.mat e4ec0b4cc802065c6c0df8845339558ea7126d5406f97e66230e497d6df04170
matlab-functions scipy some_functions.mat 240ef7ea81b7b3c3cf74a85db182be06774b52c1ab24224021106c79220466d3
matlab-sparse scipy testsparse_7.4_GLNX86.mat 41b64e0aa22f9da2b45ce1f791a49705efa6ff5fd16f7de9b2af04f963120535
"""
"""Name, repository, path in it and checksum of each file."""


def _foreign() -> Iterator[PublicLog]:
    words = iter(_FILES.split())
    for name, repository, path, sha256 in zip(words, words, words, words, strict=True):
        yield PublicLog(name, f"{_REPOSITORIES[repository]}/{path}", sha256, "", suffix=Path(path).suffix)


FOREIGN_FILES: Mapping[str, PublicLog] = MappingProxyType({row.name: row for row in _foreign()})
"""Files of the tests of pyulog and foxglove/ulog (PX4's logs), foxglove/mcap and scipy, by name."""


def find(name: str, deadline_s: float = 60.0) -> Path:
    """Return the file of a public log, after a download into the cache if it is not on this computer.

    `name` is one of PUBLIC_LOGS or FOREIGN_FILES, with or without its suffix. Raises LogError for an unknown name, for
    a wrong checksum, and for a log that is not found and not downloaded within `deadline_s` seconds.
    """
    known = {**PUBLIC_LOGS, **FOREIGN_FILES}
    row = next((row for row in known.values() if name in (row.name, row.file)), None)
    if row is None:
        raise LogError("no such public log", name, f"choose one of {', '.join(known)}")
    return _at_hand(row) or download(row, cache_folder(), deadline_s)


def available(rows: Mapping[str, PublicLog] | None = None) -> dict[str, Path]:
    """Return the files of `rows`, by default the public logs, that are on this computer, by name.

    Raises LogError for a file with a log's name and another checksum.
    """
    found = {name: _at_hand(row) for name, row in (PUBLIC_LOGS if rows is None else rows).items()}
    return {name: path for name, path in found.items() if path is not None}


def _at_hand(row: PublicLog) -> Path | None:
    path = next((path for folder in _folders() if (path := folder / row.file).is_file()), None)
    if path is not None:
        _verify(path.read_bytes(), row, path)
    return path


def cache_folder() -> Path:
    """Return the folder of downloaded logs: below XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twodof" / "flight-data"


def download(row: PublicLog, folder: Path, deadline_s: float) -> Path:
    """Download a log into `folder` and return its path; nothing is kept unless its checksum is right.

    Raises DownloadError if that does not succeed within `deadline_s` seconds.
    """
    remedy = f"set {VARIABLE} to a folder that holds {row.file}, or try again with a network"
    received: list[bytes | Exception] = []
    # A thread, because looking up a host's name has no deadline of its own.
    thread = threading.Thread(target=lambda: received.append(_receive(row.url, deadline_s)), daemon=True)
    thread.start()
    thread.join(deadline_s)
    data = received.pop() if received else TimeoutError()
    if isinstance(data, TimeoutError):
        raise DownloadError(f"no answer within {deadline_s:g} s from {row.url}", row.name, remedy)
    if isinstance(data, Exception):
        raise DownloadError(f"cannot be downloaded from {row.url}: {data}", row.name, remedy) from data
    _verify(data, row, Path(row.url))
    path = folder / row.file
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as refusal:
        raise LogError(f"the cache cannot be made: {refusal.strerror}", str(folder), remedy) from refusal
    with atomic_write(path) as file:
        file.write(data)
    return path


def _receive(url: str, deadline_s: float) -> bytes | Exception:
    """Return the content of an address, or the exception that prevented it."""
    try:
        with urllib.request.urlopen(url, timeout=deadline_s) as reply:
            data: bytes = reply.read(MAX_BYTES + 1)
    except (OSError, ValueError) as reason:  # URLError, HTTP errors and time-outs are kinds of OSError
        cause = getattr(reason, "reason", None)  # of a URLError: of a connection that did not come in time, say
        return cause if isinstance(cause, TimeoutError) else reason
    except HTTPException:
        return ValueError("the answer is not HTTP")
    return data if len(data) <= MAX_BYTES else ValueError(f"more than {MAX_BYTES} bytes")


def _folders() -> list[Path]:
    """Return the folders to search, in order."""
    named = os.environ.get(VARIABLE)
    if named:
        return [Path(named), cache_folder()]
    # In a checkout, the folder that the tests use by default.
    project = Path(__file__).resolve().parents[3]
    beside = [project.parent / "shared" / "flight-data"] if (project / "pyproject.toml").is_file() else []
    return [*beside, cache_folder()]


def _verify(data: bytes, row: PublicLog, path: Path) -> None:
    seen = hashlib.sha256(data).hexdigest()
    if seen != row.sha256:
        what = f"its sha256 is {seen[:12]}..., not {row.sha256[:12]}..."
        raise LogError(what, str(path), "remove the file and try again")
