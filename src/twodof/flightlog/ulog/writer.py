"""A small writer of ULog, for the on-board log of the virtual flight controller.

What PX4's tools need is written: flags, formats, information, parameters, records, texts, dropouts and marks to
synchronise on. A mark follows each part that goes to the disk, and a part is acknowledged when it is there.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from struct import Struct, error
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, shown
from twodof.flightlog.append_only_file import AppendOnlyFile, Full
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.ulog.format import (
    BASIC,
    HEADER,
    MAGIC,
    MESSAGE,
    SYNC,
    ULogField,
    fields_of,
    record_type,
)
from twodof.flightlog.ulog.ulog_file import OWN
from twodof.signals import TOPICS, Topic

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_MAX_DROPOUT_MS = 65_535
_MARK = MESSAGE.pack(len(SYNC), ord("S")) + SYNC
LEVELS: Mapping[str, int] = {"error": 3, "warning": 4, "info": 6, "debug": 7}


def topic_format(topic: Topic) -> tuple[str, str]:
    """Name and description of the records of a signal of TOPICS, in the precision in which it is computed."""
    names = topic.fields or ("value",)
    return topic.name.replace(".", "_"), "uint64_t timestamp;" + "".join(f"double {name};" for name in names)


class ULogWriter(AppendOnlyFile):
    """Writes records into a new ULog file, for `with`.

    `formats` describes each topic's records by name, such as `uint64_t timestamp;float[3] xyz;`: basic types,
    `timestamp` [us] first. By default there is one for each signal of TOPICS that the flight controller knows. `info`:
    texts and whole numbers; `parameters`: int for PX4's int32, float for its float, which it rounds to. `full`,
    `capacity_bytes` and `flush_s` are Spool's; the time over which records were dropped is logged as such. Raises
    LogError for what ULog cannot hold or a file that exists, RecordingError when the disk refuses.
    """

    def __init__(
        self,
        path: str | Path,
        formats: Mapping[str, str] | None = None,
        info: Mapping[str, str | int] | None = None,
        parameters: Mapping[str, float] | None = None,
        start_us: int = 0,
        flush_s: float = 0.25,
        capacity_bytes: int = 1 << 24,
        full: Full = "drop",
    ) -> None:
        described = dict(topic_format(topic) for topic in TOPICS if topic.onboard) if formats is None else dict(formats)
        self._where = str(path)
        self._records: dict[str, tuple[int, Struct]] = {}
        self._layouts: dict[str, np.dtype[np.void]] = {}
        head = HEADER.pack(MAGIC, 1, _whole(start_us, 64, self._where)) + _message("B", bytes(40))
        added = b""
        for number, (name, description) in enumerate(described.items()):
            head += _message("F", f"{name}:{description}".encode("ascii", "replace"))
            added += _message("A", Struct("<BH").pack(0, number) + name.encode())
            fields = _fields(name, description, self._where)
            self._records[name] = (number, _packing(fields))
            self._layouts[name] = record_type(name, {name: fields}, self._where, MemoryBudget(0, self._where))
        for key, value in {"sys_name": OWN, **(info or {})}.items():
            head += self._info(key, value)
        head += b"".join(self._parameter(name, value) for name, value in (parameters or {}).items())
        self._buffer = bytearray()
        self._dropped_since: int | None = None
        self.dropped = 0
        """Records, texts and changes that were not taken because the disk was too slow."""
        super().__init__(path, flush_s, capacity_bytes, full)
        self._start(head + added + _MARK)

    def write(self, name: str, timestamp_us: int, values: Sequence[float]) -> bool:
        """Takes a record: one number for each element after `timestamp`; False if it was dropped.

        Raises LogError for a name without a format or values that do not fit it, RecordingError after a failure.
        """
        try:
            self.layout(name)
            number, packing = self._records[name]
            payload = packing.pack(number, timestamp_us, *values)
        except (error, TypeError, OverflowError) as reason:
            raise LogError(f"{shown(values)} at {shown(timestamp_us)}: {reason}", f"{self._where}: {name}") from reason
        return self._put(_message("D", payload), timestamp_us)

    def layout(self, name: str) -> np.dtype[np.void]:
        """How numpy has the records of the topic `name`. Raises LogError for one without a format."""
        if name not in self._layouts:
            raise LogError(f"no topic {shown(name)}", self._where, "describe it when the log is opened")
        return self._layouts[name]

    def write_many(self, name: str, rows: NDArray[np.void]) -> bool:
        """Takes records (n,) laid out as `layout(name)`, all or none; False if they were dropped. Raises as `write`."""
        layout = self.layout(name)
        if rows.dtype != layout or rows.ndim != 1:
            raise LogError(f"records of {rows.dtype}, shape {rows.shape}", f"{self._where}: {name}", "see layout()")
        if not len(rows):
            return True
        whole: NDArray[Any] = np.empty(
            len(rows), dtype=[("size", "<u2"), ("letter", "u1"), ("number", "<u2"), ("record", layout)]
        )
        whole["size"], whole["letter"] = layout.itemsize + 2, ord("D")
        whole["number"], whole["record"] = self._records[name][0], rows
        return self._put(whole.tobytes(), int(rows["timestamp"][-1]), len(rows))

    def dropout(self, lost_ms: int, timestamp_us: int) -> bool:
        """Takes the mark that nothing could be logged for `lost_ms` before `timestamp_us`."""
        return self._put(_dropout(lost_ms), _whole(timestamp_us, 64, self._where))

    def text(self, level: str, timestamp_us: int, line: str) -> bool:
        """Takes a line for the log's reader, of a level of LEVELS. Raises LogError for another level."""
        if level not in LEVELS:
            raise LogError(f"no level {shown(level)}", self._where, f"use {', '.join(LEVELS)}")
        stamp = _whole(timestamp_us, 64, self._where)
        body = Struct("<BQ").pack(ord("0") + LEVELS[level], stamp) + line.encode()[:1000]
        return self._put(_message("L", body), stamp)

    def parameter(self, name: str, value: float, timestamp_us: int) -> bool:
        """Takes a change of a parameter. Raises LogError for one that ULog cannot hold."""
        return self._put(self._parameter(name, value), _whole(timestamp_us, 64, self._where))

    def _put(self, made: bytes, stamp_us: int, count: int = 1) -> bool:
        with self._changed:
            if not self._admit(len(made)):
                self.dropped += count
                self._dropped_since = stamp_us if self._dropped_since is None else self._dropped_since
                return False
            if self._dropped_since is not None:
                self._buffer += _dropout((stamp_us - self._dropped_since) // 1000)
                self._dropped_since = None
            self._buffer += made
            self.accepted += count
        return True

    def _info(self, key: str, value: str | int) -> bytes:
        _named(key, self._where)
        if isinstance(value, str):
            raw = value.encode()[:10_000]
            return _keyed("I", f"char[{max(len(raw), 1)}] {key}", raw or b"\0")
        return _keyed("I", f"int64_t {key}", Struct("<q").pack(_whole(value, 64, self._where, signed=True)))

    def _parameter(self, name: str, value: float) -> bytes:
        _named(name, self._where)
        if isinstance(value, int):
            return _keyed("P", f"int32_t {name}", Struct("<i").pack(_whole(value, 32, self._where, signed=True)))
        try:
            return _keyed("P", f"float {name}", Struct("<f").pack(value))
        except (error, OverflowError, TypeError) as reason:
            raise LogError(f"{shown(value)}: {reason}", f"{self._where}: {name}", "give a float32") from reason

    def _take(self) -> bytes | None:
        taken, self._buffer = bytes(self._buffer), bytearray()
        return taken or None

    def _encode(self, taken: object) -> bytes:
        return (taken if isinstance(taken, bytes) else b"") + _MARK

    def _ending(self) -> bytes:
        return b""


def _fields(name: str, description: str, where: str) -> list[ULogField]:
    """The fields of a topic's records. Raises LogError for what cannot be written."""
    _named(name, where)
    fields = fields_of(description, f"{where}: {name}")
    if fields[0] != ("uint64_t", 0, "timestamp") or any(kind not in BASIC or kind == "char" for kind, _, _ in fields):
        raise LogError(f"format {description[:80]!r}", where, f"begin with uint64_t timestamp; types: {list(BASIC)}")
    return fields


def _packing(fields: Sequence[ULogField]) -> Struct:
    """The packing of a record, its number first."""
    # numpy's letters are those of struct, but where C's long is of 8 bytes.
    letters = (max(count, 1) * np.dtype(BASIC[kind]).char for kind, count, _ in fields)
    return Struct("<H" + "".join(letters).replace("l", "q").replace("L", "Q"))


def _named(name: str, where: str) -> None:
    if not _NAME.fullmatch(name):
        raise LogError(f"{shown(name)} cannot name anything in a ULog", where, "use up to 64 letters, digits and _")


def _dropout(lost_ms: int) -> bytes:
    return _message("O", min(max(lost_ms, 1), _MAX_DROPOUT_MS).to_bytes(2, "little"))


def _message(letter: str, body: bytes) -> bytes:
    return MESSAGE.pack(len(body), ord(letter)) + body


def _keyed(letter: str, key: str, value: bytes) -> bytes:
    return _message(letter, bytes((len(key),)) + key.encode() + value)


def _whole(value: int, bits: int, where: str, signed: bool = False) -> int:
    low = -(1 << (bits - 1)) if signed else 0
    if not isinstance(value, int) or not low <= value < low + (1 << bits):
        what = f"{shown(value)} is not a whole number of {bits} bits"
        raise LogError(what, where, "give a smaller one" if signed else "give whole microseconds from 0")
    return value
