"""Flight logs in MCAP, the container that Foxglove Studio and rosbags open.

`decode_mcap` and `write_mcap` are for whole logs; `recorder.Recorder` writes the same layout while a drone flies, and
`recovery.recover` reads a recording that was cut off.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
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
