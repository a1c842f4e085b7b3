"""Recovery of a recording that was cut off: by a crash, a power cut, a full or damaged disk."""

from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import fence, provenance
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.files import answer_of, log_of
from twodof.flightlog.log import FlightLog
from twodof.flightlog.mcap_decoder import McapContents, scan
from twodof.flightlog.mcap_encoder import Attachment, McapSamples
from twodof.flightlog.mcap_file import RECOVERED_NOTE, to_log, write_contents, write_mcap
from twodof.flightlog.mcap_stream import McapStream
from twodof.flightlog.provenance import Loss

NO_CHECKSUMS = "every value: a ULog has no checksums"


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery: the `log`, its `samples`, the `lost_bytes`, and what was wrong, in words.

    `unverified` names what is in `log` although no checksum vouches for it; it is part of `what`.
    """

    log: FlightLog
    samples: int
    lost_bytes: int
    what: tuple[str, ...]
    unverified: tuple[str, ...] = ()
    contents: McapContents | None = None

    def write(self, path: str | Path, overwrite: bool = False) -> None:
        """Write a complete MCAP file, atomically. Raises LogError, also if it is there."""
        check_free(path, overwrite)
        if self.contents is None:
            write_mcap(self.log, path)
        else:
            with atomic_write(path) as file:
                write_contents(self.contents, file)


def recover(path: str | Path) -> Recovered:
    """Read an .mcap or .ulg file as far as it is sound; of an MCAP file, parts with a checksum only if that holds.

    Everything that a Recorder or ULogWriter has acknowledged is in the result, even if later bytes were cut off or
    written over. Parts that had to be taken unverified are named in `unverified` and in the provenance (`recovered`).
    These are topics with a damaged description, all logs of PX4, and tables and descriptions of earlier versions. The
    last two lack checksums. A table whose checksum is wrong is kept apart, in provenance["unverified"].
    Raises LogError for a file in which no sample can be read: that is never a success.
    """
    where = str(path)
    contents = None
    suffix = Path(path).suffix.lower()
    if suffix == ".ulg":
        plain, arrays = fence.read(_salvaged_ulog, path, needs="twodof.flightlog.ulog_file")
        log = log_of(plain, arrays)
        lost, finished, unverified = [Loss(*row) for row in plain["lost"]], plain["finished"], [NO_CHECKSUMS]
    elif suffix == ".mcap":
        plain, arrays = fence.read(_salvaged_mcap, path, needs="twodof.flightlog.mcap_file")
        contents = _contents_of(plain, arrays)
        log = to_log(contents, plain["file"], where)
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


def _salvaged_ulog(data: bytes, where: str) -> fence.Answer:
    """Read a damaged ULog file. Runs behind the fence."""
    from_ulog = import_module("twodof.flightlog.ulog_file")
    found = from_ulog.scan_ulog(data, where, salvage=True)
    plain, arrays = answer_of(from_ulog.ulog_to_log(found, provenance.of_file(where, data, "ulog"), where))
    return {
        **plain,
        "lost": [[loss.at, loss.size, loss.why] for loss in found.lost],
        "finished": found.finished,
    }, arrays


def _salvaged_mcap(data: bytes, where: str) -> fence.Answer:
    """Read a damaged MCAP file. Runs behind the fence."""
    found = scan(data, where, salvage=True)
    joined = {number: found.joined(number) for number in found.streams}
    arrays: list[NDArray[Any]] = [np.frombuffer(one.data, "u1") for one in found.attachments]
    for some in joined.values():
        arrays += [some.time_ns, some.value, *([] if some.stamp is None else [some.stamp])]
    plain = {
        "file": provenance.of_file(where, data, "mcap"),
        "streams": [[number, asdict(stream)] for number, stream in found.streams.items()],
        "attachments": [[one.name, one.media_type, one.time_ns] for one in found.attachments],
        "lost": [[loss.at, loss.size, loss.why] for loss in found.lost],
        "metadata": found.metadata,
        "ignored": found.ignored,
        "unverified": found.unverified,
        "finished": found.finished,
    }
    return plain, arrays


def _contents_of(plain: dict[str, Any], arrays: list[NDArray[Any]]) -> McapContents:
    """Return the contents that `_salvaged_mcap` took apart."""
    waiting = iter(arrays)
    found = McapContents(
        attachments=[
            Attachment(name, kind, next(waiting).tobytes(), time) for name, kind, time in plain["attachments"]
        ],
        metadata=[(name, rows) for name, rows in plain["metadata"]],
        lost=[Loss(*row) for row in plain["lost"]],
        ignored=plain["ignored"],
        unverified=plain["unverified"],
        finished=plain["finished"],
    )
    for number, row in plain["streams"]:
        stream = McapStream(**{**row, "fields": tuple(row["fields"])})
        found.streams[number] = stream
        time_ns, value = next(waiting), next(waiting)
        stamp = next(waiting) if stream.stamped else None
        found.samples[number] = [McapSamples(time_ns, value, stamp)]
    return found
