"""Public flight logs of a real drone: their addresses, and the search for them.

Seven logs of an ANT-X 2DoF Drone, published under the MIT licence in two repositories of M. Di Mauro. They are not part
of this package. A log is searched in the folder TWODOF_FLIGHT_DATA, then in the cache, and downloaded otherwise. Its
checksum is verified each time.
"""

import hashlib
import os
import threading
import urllib.request
from collections.abc import Mapping
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
    """One published log: its name in twodof, its address and its checksum.

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


def find(name: str, deadline_s: float = 60.0) -> Path:
    """Return the file of a public log, after a download into the cache if it is not on this computer.

    `name` is one of PUBLIC_LOGS, with or without ".mat". Raises LogError for an unknown name, for a wrong
    checksum, and for a log that is not found and not downloaded within `deadline_s` seconds.
    """
    row = PUBLIC_LOGS.get(name.removesuffix(".mat"))
    if row is None:
        raise LogError("no such public log", name, f"choose one of {', '.join(PUBLIC_LOGS)}")
    return _at_hand(row) or download(row, cache_folder(), deadline_s)


def available() -> dict[str, Path]:
    """Return the files of the public logs that are on this computer, by name.

    Raises LogError for a file with a log's name and another checksum.
    """
    found = {name: _at_hand(row) for name, row in PUBLIC_LOGS.items()}
    return {name: path for name, path in found.items() if path is not None}


def _at_hand(row: PublicLog) -> Path | None:
    path = next((path for folder in _folders() if (path := folder / f"{row.name}.mat").is_file()), None)
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
    remedy = f"set {VARIABLE} to a folder that holds {row.name}.mat, or try again with a network"
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
    path = folder / f"{row.name}.mat"
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
