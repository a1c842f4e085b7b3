"""Recorder: every topic at full rate into an MCAP file that is readable up to the last acknowledged sample.

Schemas, channels, provenance and attachments come first. Then come chunks with checksums, one each quarter of a second
by default, each followed by its index and an fsync. So `mcap_file.recover` finds every acknowledged sample, however the
process or the machine ends, and nothing false.
"""

import json
from array import array
from collections.abc import Iterable, Mapping, Sequence
from operator import index
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from twodof.errors import LogError, listed, shown
from twodof.flightlog.append_only_file import AppendOnlyFile, Full
from twodof.flightlog.mcap_encoder import Attachment, McapEncoder, McapSamples
from twodof.flightlog.mcap_file import END_NOTE, NOTE
from twodof.flightlog.mcap_stream import McapStream, named
from twodof.flightlog.provenance import kept_json
from twodof.signals import Topic

_LATEST_NS = (1 << 63) - 1


class _Slot:
    """Samples of a stream that wait to be written."""

    def __init__(self, number: int, stream: McapStream) -> None:
        self.number, self.width = number, stream.width
        self.bytes = 8 * (1 + stream.width)
        self.times, self.values = array("Q"), array("d")
        self.dropped = 0

    def take(self) -> McapSamples:
        times = np.frombuffer(self.times, np.uint64) if self.times else np.empty(0, np.uint64)
        values = np.frombuffer(self.values, np.float64) if self.values else np.empty(0)
        self.times, self.values = array("Q"), array("d")
        return McapSamples(times, values.reshape(-1, self.width))


class Recorder(AppendOnlyFile):
    """Recorder of samples of topics into a new MCAP file, as a context manager.

    `topics`: names of TOPICS (`imu.gyro`), rows of TOPICS, or streams that you describe. `provenance` holds JSON values
    (seed, parameters, versions, ...), `attachments` files such as the diagram. Both reach the disk before the first
    sample. Values are recorded as they come, NaN included; `read_log` leaves NaN out and counts it.

    `full="drop"`, the default, is for a caller that must not wait. It drops samples that do not fit into
    `capacity_bytes`, counts them by topic in `dropped` and keeps the counts in the file. `full="wait"` waits for the
    disk, for flights in lockstep. Raises LogError if the file exists or cannot be made, RecordingError when the disk
    refuses or does not answer.
    """

    def __init__(
        self,
        path: str | Path,
        topics: Iterable[str | Topic | McapStream],
        provenance: Mapping[str, object] | None = None,
        attachments: Sequence[Attachment] = (),
        flush_s: float = 0.25,
        capacity_bytes: int = 1 << 24,
        full: Full = "drop",
        overwrite: bool = False,
    ) -> None:
        streams = named(topics)
        if not streams or any(stream.stamped for stream in streams.values()):
            raise LogError("no topic is named, or a topic has stamps in seconds", str(path), "name topics to record")
        note = kept_json(dict(provenance or {}), str(path))
        self._slots = {name: _Slot(k, stream) for k, (name, stream) in enumerate(streams.items())}
        self._encoder = McapEncoder(list(streams.values()))
        self._notes: dict[str, object] = {}
        super().__init__(path, flush_s, capacity_bytes, full, overwrite=overwrite)
        self._start(self._encoder.head({NOTE: {"provenance": note, "empty": "left out"}}, attachments))

    @property
    def dropped(self) -> dict[str, int]:
        """Number of samples that were dropped because of a slow disk, by topic, for topics that lost any."""
        with self._changed:
            return {name: slot.dropped for name, slot in self._slots.items() if slot.dropped}

    def write(self, topic: str, time_ns: int, values: float | Sequence[float]) -> bool:
        """Record a sample at `time_ns`, a time of flight from 0 to 2^63 - 1; return False if it was dropped.

        `values` is a number, or one for each field, in the topic's unit. Raises LogError for an unknown topic or values
        that do not fit it, RecordingError once the recording has ended.
        """
        slot = self._slot(topic)
        try:
            row = array("d", values if isinstance(values, Sequence) else (values,))
            stamp = index(time_ns)
        except (TypeError, ValueError, OverflowError) as reason:
            raise self._misfit(topic, f"{shown(values)} at {shown(time_ns)}: {reason}") from reason
        if len(row) != slot.width or not 0 <= stamp <= _LATEST_NS:
            raise self._misfit(topic, f"{len(row)} values at {shown(stamp)} ns, the topic has {slot.width}")
        with self._changed:
            if not self._admit(slot.bytes):
                slot.dropped += 1
                return False
            slot.times.append(stamp)
            slot.values.extend(row)
            self.accepted += 1
        return True

    def write_many(self, topic: str, time_ns: ArrayLike, values: ArrayLike) -> bool:
        """Record `values` (n,) or (n, k) at the times `time_ns` (n,), all or none; return False if they were dropped.

        Raises the errors of `write`.
        """
        slot = self._slot(topic)
        times, rows = np.asarray(time_ns), np.asarray(values)
        if times.dtype.kind not in "iu" or rows.dtype.kind not in "biuf" or times.ndim != 1:
            raise self._misfit(topic, f"times {times.dtype} {times.shape}, values {rows.dtype}")
        if rows.shape not in ((len(times), slot.width), (len(times),) if slot.width == 1 else ()):
            raise self._misfit(topic, f"values {rows.shape} for {len(times)} times")
        if len(times) and (int(times.min()) < 0 or int(times.max()) > _LATEST_NS):
            raise self._misfit(topic, f"times from {times.min()} to {times.max()} ns")
        with self._changed:
            if not self._admit(slot.bytes * len(times)):
                slot.dropped += len(times)
                return False
            slot.times.frombytes(times.astype(np.uint64).tobytes())
            slot.values.frombytes(rows.astype(np.float64).tobytes())
            self.accepted += len(times)
        return True

    def note(self, name: str, value: object) -> None:
        """Add a JSON value that is known only at the end to the log's provenance under `name`.

        It is written after the last sample, so a recording that is cut off lacks it. Raises LogError for a value that
        JSON cannot hold.
        """
        kept_json({name: value}, str(self.path))
        self._notes[name] = value

    def _slot(self, topic: str) -> _Slot:
        try:
            return self._slots[topic]
        except (KeyError, TypeError):
            what = f"{shown(topic)} is not recorded"
            raise LogError(what, str(self.path), f"recorded are {listed(self._slots)}") from None

    def _misfit(self, topic: str, what: str) -> LogError:
        return LogError(what, f"{self.path}: {topic}", "give whole nanoseconds from 0 and a number for each field")

    def _take(self) -> dict[int, McapSamples] | None:
        taken = {slot.number: slot.take() for slot in self._slots.values() if slot.times}
        return taken or None

    def _encode(self, taken: object) -> bytes:
        return self._encoder.chunk(taken) if isinstance(taken, dict) else b""

    def _ending(self) -> bytes:
        self._encoder.cut(self.acknowledged.position)
        notes = {**self._notes, **({"dropped": dropped} if (dropped := self.dropped) else {})}
        rows = {"noted": json.dumps(notes)}
        return (self._encoder.metadata(END_NOTE, rows) if notes else b"") + self._encoder.tail()
