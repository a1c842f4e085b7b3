"""Recovery of a recording that was cut off: by a crash, a power cut, a full or damaged disk."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from twodof.errors import LogError
from twodof.flightlog import fence, provenance
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.files import answer_of, log_of
from twodof.flightlog.log import FlightLog
from twodof.flightlog.mcap_decoder import scan
from twodof.flightlog.mcap_file import RECOVERED_NOTE, parts_of, to_log, write_mcap

NO_CHECKSUMS = "every value: a ULog has no checksums"
_NEEDED = {".mcap": "twodof.flightlog.mcap_file", ".ulg": "twodof.flightlog.ulog_file"}


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery: the `log`, its number of `samples`, the `lost_bytes`, and the damage in words, `what`.

    `unverified`, which is part of `what`, names the content of `log` that no checksum confirms. `file` has the bytes of
    a complete MCAP file if an MCAP file was recovered.
    """

    log: FlightLog
    samples: int
    lost_bytes: int
    what: tuple[str, ...]
    unverified: tuple[str, ...] = ()
    file: bytes = b""

    def write(self, path: str | Path, overwrite: bool = False) -> None:
        """Write the recovered log as a complete MCAP file, atomically. Raises LogError, also if the file exists."""
        check_free(path, overwrite)
        if not self.file:
            write_mcap(self.log, path)
            return
        with atomic_write(path) as file:
            file.write(self.file)


def recover(path: str | Path) -> Recovered:
    """Recover the sound parts of an .mcap or .ulg file; parts of an MCAP file with a wrong checksum are left out.

    Everything that a Recorder or ULogWriter has acknowledged is in the result, even if later bytes were cut off or
    written over. Parts without a checksum are named in `unverified` and in the provenance (`recovered`): topics with a
    damaged description, all logs of PX4, and tables and descriptions of earlier versions. A table with a wrong checksum
    is kept apart, in provenance["unverified"]. Raises LogError for a file in which no sample can be read.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _NEEDED:
        raise LogError(f"cannot recover {suffix!r:.40} files", str(path), "give an .mcap or .ulg file")
    plain, (*arrays, file) = fence.read(_salvaged, path, suffix, needs=_NEEDED[suffix])
    samples = sum(map(len, arrays[::2]))
    what, unverified = tuple(plain["what"]), tuple(plain["unverified"])
    return Recovered(log_of(plain, arrays), samples, plain["lost_bytes"], what, unverified, file.tobytes())


def _salvaged(data: bytes, where: str, suffix: str) -> fence.Answer:
    """Read a damaged file, and make a complete one of it. Runs behind the fence."""
    file = provenance.of_file(where, data, suffix.removeprefix("."))
    ignored, contents, unverified = {}, None, [NO_CHECKSUMS]
    if suffix == ".ulg":
        ulog_file = import_module("twodof.flightlog.ulog_file")
        found = ulog_file.scan_ulog(data, where, salvage=True)
        log = ulog_file.ulog_to_log(found, file | {"format": "ulog"}, where)
    else:
        found = contents = scan(data, where, salvage=True)
        log = to_log(contents, file, where)
        ignored, unverified = contents.ignored, contents.unverified
    if not any(map(len, log.channels.values())):
        remedy = "nothing was acknowledged, or another program wrote the file: record the flight again"
        raise LogError("no sample can be read in it", where, remedy)
    what = [] if found.finished else ["the recording was not closed"]
    what += [f"{loss.size} bytes at byte {loss.at}: {loss.why}" if loss.size else loss.why for loss in found.lost]
    what += [f"{count} messages of {name} are left out: not a topic of ours" for name, count in ignored.items()]
    what += [f"not verified: {one}" for one in unverified]
    lost_bytes = sum(loss.size for loss in found.lost)
    if what:
        note = {"from": Path(where).name, "lost_bytes": str(lost_bytes), "what": "; ".join(what)[:10_000]}
        note |= {"unverified": "; ".join(unverified)[:10_000]} if unverified else {}
        log = FlightLog(log.channels, {**log.provenance, "recovered": note})
        if contents is not None:
            contents.metadata.append((RECOVERED_NOTE, note))
    whole = b"" if contents is None else b"".join(parts_of(contents))
    plain, arrays = answer_of(log)
    told = {"what": what, "unverified": unverified, "lost_bytes": lost_bytes}
    return plain | told, [*arrays, np.frombuffer(whole, "u1")]
