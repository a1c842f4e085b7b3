"""What is left of a recording that was cut off: by a crash, a power cut, a full or damaged disk."""

from dataclasses import dataclass
from pathlib import Path

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.log import FlightLog
from twodof.flightlog.mcap.decoder import McapContents, scan
from twodof.flightlog.mcap.mcap_file import RECOVERED_NOTE, to_log, write_contents, write_mcap
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.ulog.decoder import scan_ulog
from twodof.flightlog.ulog.ulog_file import ulog_to_log

NO_CHECKSUMS = "every value: a ULog has no checksums"


@dataclass(frozen=True)
class Recovered:
    """What was read: `log`, `samples` in it, `lost_bytes` that could not be used, `what` was wrong, in words.

    `unverified` says what is in `log` although no checksum vouches for it; it is part of `what`.
    """

    log: FlightLog
    samples: int
    lost_bytes: int
    what: tuple[str, ...]
    unverified: tuple[str, ...] = ()
    contents: McapContents | None = None

    def write(self, path: str | Path, overwrite: bool = False) -> None:
        """Writes a complete MCAP file, atomically. Raises LogError, also if it is there."""
        check_free(path, overwrite)
        if self.contents is None:
            write_mcap(self.log, path)
        else:
            with atomic_write(path) as file:
                write_contents(self.contents, file)


def recover(path: str | Path) -> Recovered:
    """Reads an .mcap or .ulg file as far as it is sound; of an MCAP file, what has a checksum only if that holds.

    Everything that a Recorder or ULogWriter has acknowledged is in the result, even if later bytes were cut off or
    written over. What had to be taken unverified is named in `unverified` and in the provenance (`recovered`). These
    are topics with a damaged description, all logs of PX4, and tables and descriptions of earlier versions. The last
    two lack checksums. A table whose checksum is wrong is kept apart, in provenance["unverified"].
    Raises LogError for a file in which no sample can be read: that is never a success.
    """
    data = provenance.read_bytes(path)
    where = str(path)
    budget = MemoryBudget(len(data), where)
    contents = None
    if Path(path).suffix.lower() == ".ulg":
        found = scan_ulog(data, where, salvage=True, budget=budget)
        log = ulog_to_log(found, provenance.of_file(path, data, "ulog"), where, budget)
        lost, finished, unverified = found.lost, found.finished, [NO_CHECKSUMS]
    elif Path(path).suffix.lower() == ".mcap":
        contents = scan(data, where, salvage=True, budget=budget)
        log = to_log(contents, provenance.of_file(path, data, "mcap"), where, budget)
        lost, finished, unverified = contents.lost, contents.finished, contents.unverified
    else:
        raise LogError(f"cannot recover {Path(path).suffix!r} files", where, "give an .mcap or .ulg file")
    samples = sum(len(channel) for channel in log.channels.values())
    if not samples:
        raise LogError("no sample can be read in it", where, "nothing was acknowledged, or the file is another's")
    what = [f"{loss.size} bytes at byte {loss.at}: {loss.why}" if loss.size else loss.why for loss in lost]
    if not finished:
        what.insert(0, "the recording was not closed")
    size = sum(loss.size for loss in lost)
    ignored = contents.ignored if contents is not None else {}
    what += [f"{count} messages of {name} are left out: not a topic of ours" for name, count in ignored.items()]
    what += [f"not verified: {one}" for one in unverified]
    note = {"from": Path(path).name, "lost_bytes": str(size), "what": "; ".join(what)[:10_000]}
    note |= {"unverified": "; ".join(unverified)[:10_000]} if unverified else {}
    if contents is not None and what:
        contents.metadata.append((RECOVERED_NOTE, note))
    if what:
        log = FlightLog(log.channels, {**log.provenance, "recovered": note})
    return Recovered(log, samples, size, tuple(what), tuple(unverified), contents)
