"""Flight logs in MCAP, the container that Foxglove Studio and rosbags open.

`decode_mcap` and `write_mcap` are for whole logs; `recorder.Recorder` writes the same layout while a drone flies, and
`recovery.recover` reads a recording that was cut off.
"""

from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

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
# A reader that seeks inflates one chunk: about a second of every topic at full rate.
CHUNK_SAMPLES = 8192
CHUNK_BYTES = 1 << 22


def decode_mcap(data: bytes, where: str) -> FlightLog:
    """Return the log in a recording. Raises LogError for what is no MCAP, damaged, cut off or not ours.

    Foreign topics are counted in provenance["ignored"]. Samples that are not finite or repeat a stamp are left out and
    counted in provenance["left_out"]. Those that the recorder could not take are in provenance["dropped"].
    """
    return to_log(scan(data, where), provenance.of_file(where, data, "mcap"), where)


def write_mcap(log: FlightLog, path: str | Path) -> None:
    """Write a log, atomically, so that it reads back bit for bit. Raises LogError for stamps before 0."""
    described = streams_of(log)
    contents = McapContents(dict(enumerate(described.values())))
    for k, (name, stream) in enumerate(described.items()):
        channel = log[name]
        value = channel.value if channel.value.ndim == 2 else channel.value[:, None]
        stamp = channel.time if stream.stamped else None
        contents.samples[k] = [McapSamples(nanoseconds(channel.time, f"{path}: {name}"), value, stamp)]
    contents.metadata.append((NOTE, {"provenance": provenance.to_json(log), "empty": "kept"}))
    with atomic_write(path) as file:
        write_contents(contents, file)


def write_contents(contents: McapContents, file: IO[bytes]) -> None:
    """Write streams, samples, tables and attachments as a complete file, in chunks ordered by time."""
    numbers = list(contents.streams)
    encoder = McapEncoder([contents.streams[number] for number in numbers])
    file.write(encoder.head({}, contents.attachments))
    for name, rows in contents.metadata:
        file.write(encoder.metadata(name, rows))
    sorted_by_time = {}
    for k, number in enumerate(numbers):
        some = contents.joined(number)
        sorted_by_time[k] = some.part(np.argsort(some.time_ns, kind="stable"))
    widest = max((contents.streams[number].record_bytes for number in numbers), default=1)
    # Of many streams each is to have some samples in a chunk.
    each = max(1, min(max(CHUNK_SAMPLES, 100 * len(numbers)), CHUNK_BYTES // widest))
    bounds = _bounds([some.time_ns for some in sorted_by_time.values()], each)
    edges = {k: np.searchsorted(some.time_ns, bounds).tolist() for k, some in sorted_by_time.items()}
    for n in range(len(bounds) - 1):
        file.write(encoder.chunk({k: some.part(slice(*edges[k][n : n + 2])) for k, some in sorted_by_time.items()}))
    file.write(encoder.tail())


def to_log(contents: McapContents, file: dict[str, Any], where: str) -> FlightLog:
    """Return the log that a file holds. Raises LogError if none of its topics is ours."""
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
        raise LogError("no sample is in it", where, "nothing was recorded")
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


def _bounds(times: list[NDArray[np.uint64]], each: int) -> NDArray[np.uint64]:
    """Return times [ns] that cut all samples into stretches of about `each`; the last is after the last sample."""
    every = np.sort(np.concatenate(times)) if times else np.empty(0, np.uint64)
    return np.append(np.unique(every[::each]), every[-1:] + np.uint64(1))
