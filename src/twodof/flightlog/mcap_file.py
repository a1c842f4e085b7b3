"""Flight logs in MCAP, the container that Foxglove Studio and rosbags open.

`decode_mcap` and `write_mcap` are for whole logs; `recorder.Recorder` writes the same layout while a drone flies, and
`recover` reads a recording that was cut off.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from twodof.errors import LogError
from twodof.flightlog import fence, provenance
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.files import answer_of, log_of
from twodof.flightlog.log import FlightLog, sanitise
from twodof.flightlog.mcap_decoder import UNVERIFIED_NOTE, McapContents, scan
from twodof.flightlog.mcap_encoder import McapEncoder, McapSamples
from twodof.flightlog.mcap_stream import nanoseconds, seconds, streams_of
from twodof.flightlog.provenance import noted

NOTE = "twodof"
END_NOTE = "twodof.end"
RECOVERED_NOTE = "twodof.recovered"
CHUNK_SAMPLES, CHUNK_BYTES = 8192, 1 << 22
"""Largest chunk, which a reader inflates to find one sample: about a second of every topic at full rate."""


def decode_mcap(data: bytes, where: str) -> FlightLog:
    """Return the log in an MCAP file. Raises LogError for a file that is damaged, cut off or without topics of twodof.

    Messages of foreign topics are counted in provenance["ignored"]. Samples that are not finite or repeat a stamp are
    left out and counted in provenance["left_out"]. Those that the recorder dropped are in provenance["dropped"].
    """
    return to_log(scan(data, where), provenance.of_file(where, data, "mcap"), where)


def write_mcap(log: FlightLog, path: str | Path) -> None:
    """Write a log, atomically, so that it reads back bit for bit. Raises LogError for stamps before 0."""
    contents = McapContents(dict(enumerate(streams_of(log).values())))
    for k, (name, channel) in enumerate(log.channels.items()):
        value = channel.value if channel.value.ndim == 2 else channel.value[:, None]
        stamp = channel.time if contents.streams[k].stamped else None
        contents.samples[k] = [McapSamples(nanoseconds(channel.time, f"{path}: {name}"), value, stamp)]
    contents.metadata.append((NOTE, {"provenance": provenance.to_json(log), "empty": "kept"}))
    with atomic_write(path) as file:
        file.writelines(parts_of(contents))


def parts_of(contents: McapContents) -> Iterator[bytes]:
    """Yield the parts of a complete file with these streams, samples, tables and attachments.

    Chunks are in the order of time.
    """
    encoder = McapEncoder([*contents.streams.values()])
    yield encoder.head({}, contents.attachments)
    for name, rows in contents.metadata:
        yield encoder.metadata(name, rows)
    samples = [contents.joined(number) for number in contents.streams]
    samples = [some.part(np.argsort(some.time_ns, kind="stable")) for some in samples]
    every = np.sort(np.concatenate([np.empty(0, np.uint64), *(some.time_ns for some in samples)]))
    widest = max((stream.row.itemsize for stream in contents.streams.values()), default=1)
    each = max(1, min(CHUNK_SAMPLES, CHUNK_BYTES // widest))
    bounds = np.append(np.unique(every[::each]), every[-1:] + np.uint64(1))
    edges = [np.searchsorted(some.time_ns, bounds).tolist() for some in samples]
    for n in range(len(bounds) - 1):
        yield encoder.chunk({k: some.part(slice(*edges[k][n : n + 2])) for k, some in enumerate(samples)})
    yield encoder.tail()


def to_log(contents: McapContents, file: dict[str, Any], where: str) -> FlightLog:
    """Return the log in the contents of an MCAP file. Raises LogError if no topic is one of twodof."""
    if not contents.streams:
        others = ", ".join(list(contents.ignored)[:10]) or "none"
        raise LogError(f"no topic of a flight log is in it; topics: {others}", where, "give a recording of twodof")
    kept = _provenance(contents, where)
    keep_empty = any(rows.get("empty") == "kept" for name, rows in contents.metadata if name == NOTE)
    channels, counts = {}, {}
    for number, stream in contents.streams.items():
        some = contents.joined(number)
        if not len(some) and not keep_empty:
            continue
        time = seconds(some.time_ns) if some.stamp is None else some.stamp
        value = some.value[:, 0] if stream.width == 1 else some.value
        name = stream.mat
        channels[name], counts[name] = sanitise(time, value, stream.unit, stream.fields, f"{where}: {name}")
    if not channels:
        raise LogError("no sample is in it", where, "record the flight again")
    if contents.ignored:
        kept["ignored"] = dict(contents.ignored)
    return FlightLog(channels, {**noted(kept, counts), "file": file})


def _provenance(contents: McapContents, where: str) -> dict[str, Any]:
    kept: dict[str, Any] = {}
    for name, rows in contents.metadata:
        if name == NOTE and "provenance" in rows:
            kept |= provenance.from_json(rows["provenance"], where)
        elif name == END_NOTE and "noted" in rows:
            kept |= provenance.from_json(rows["noted"], where)
        elif name == RECOVERED_NOTE:
            kept["recovered"] = rows
        elif name == UNVERIFIED_NOTE:
            kept.setdefault("unverified", []).append(rows)
    return kept


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
