"""Writer of ULog, PX4's log format, for the on-board log of the virtual flight controller and for other logs.

A mark to synchronise on follows each part that goes to the disk; the part is acknowledged when it is there. The library
pyulog writes only logs that it has read before.

Source: PX4 user guide, "ULog file format", version 1. All numbers are little-endian; a message is a length (u16), a
type (one letter) and that many bytes.
"""

import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from struct import Struct, error
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, shown
from twodof.flightlog.append_only_file import AppendOnlyFile, Full
from twodof.signals import TOPICS, Topic

MAGIC = b"ULog\x01\x12\x35"
HEADER = Struct("<7sBQ")
MESSAGE = Struct("<HB")
SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
MARK = MESSAGE.pack(len(SYNC), ord("S")) + SYNC
LETTERS = frozenset(b"BFIMPQARDLCSO")
"""The types of messages."""
OWN = "twodof"
"""sys_name in the logs of the virtual flight controller, whose topics are those of TOPICS."""
MAX_RECORD = 65_533
"""Longest record: a message holds 65,535 bytes, two of them its number."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_FIELD = re.compile(r"(u?int(?:8|16|32|64)_t|float|double|bool)(?:\[([1-9]\d{0,4})\])? ([A-Za-z0-9_]+)")
_KINDS = {"float": "<f4", "double": "<f8", "bool": "u1"}
"""numpy's names of the types that it calls otherwise; a bool is any byte, so that 2 stays 2."""
_MAX_DROPOUT_MS = 65_535
LEVELS: Mapping[str, int] = {"error": 3, "warning": 4, "info": 6, "debug": 7}


def topic_format(topic: Topic) -> tuple[str, str]:
    """Return name and format of the records of a signal of TOPICS, with double for each of its numbers."""
    names = topic.fields or ("value",)
    return topic.name.replace(".", "_"), "uint64_t timestamp;" + "".join(f"double {name};" for name in names)


class ULogWriter(AppendOnlyFile):
    """Writer of records into a new ULog file, as a context manager.

    `formats` describes each topic's records by name, such as `uint64_t timestamp;float[3] xyz;`: basic types,
    `timestamp` [us] first. By default there is one for each signal of TOPICS that the flight controller has. `info`
    holds texts and whole numbers; `parameters` has an int for an int32 parameter of PX4, a float for a float one.
    `full`, `capacity_bytes` and `flush_s` are those of AppendOnlyFile; the time over which records were dropped is
    logged as a dropout. Raises LogError for values that ULog cannot hold and for a file that exists, RecordingError
    when the disk refuses.
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
        with _fitting(self._where):
            head = HEADER.pack(MAGIC, 1, start_us) + _message("B", bytes(40))
        added = b""
        for number, (name, description) in enumerate(described.items()):
            head += _message("F", f"{name}:{description}".encode("ascii", "replace"))
            added += _message("A", Struct("<BH").pack(0, number) + name.encode())
            self._layouts[name] = record_layout(name, description, self._where)
            self._records[name] = (number, _packing(self._layouts[name]))
        for key, value in {"sys_name": OWN, **(info or {})}.items():
            head += self._info(key, value)
        head += b"".join(self._parameter(name, value) for name, value in (parameters or {}).items())
        self._buffer = bytearray()
        self._dropped_since: int | None = None
        self.dropped = 0
        """Records, texts and changes dropped because of a slow disk."""
        super().__init__(path, flush_s, capacity_bytes, full)
        self._start(head + added + MARK)

    def write(self, name: str, timestamp_us: int, values: Sequence[float]) -> bool:
        """Write a record of the topic `name`; return False if it was dropped.

        `values` has one number for each element after `timestamp`. Raises LogError for a topic without a format or
        values that do not fit it, RecordingError after a failure.
        """
        self.layout(name)
        number, packing = self._records[name]
        with _fitting(f"{self._where}: {name}"):
            payload = packing.pack(number, timestamp_us, *values)
        return self._put(_message("D", payload), timestamp_us)

    def layout(self, name: str) -> np.dtype[np.void]:
        """Return numpy's layout of the records of the topic `name`. Raises LogError for a topic without a format."""
        if name not in self._layouts:
            raise LogError(f"no topic {shown(name)}", self._where, "give ULogWriter a format for it")
        return self._layouts[name]

    def write_many(self, name: str, rows: NDArray[np.void]) -> bool:
        """Write records (n,) of `layout(name)`, all or none; return False if they were dropped. Raises as `write`."""
        layout = self.layout(name)
        if rows.dtype != layout or rows.ndim != 1:
            what = f"records of {rows.dtype}, shape {rows.shape}, do not fit the topic"
            raise LogError(what, f"{self._where}: {name}", "give an array (n,) with the dtype layout(name)")
        if not len(rows):
            return True
        whole: NDArray[Any] = np.empty(
            len(rows), dtype=[("size", "<u2"), ("letter", "u1"), ("number", "<u2"), ("record", layout)]
        )
        whole["size"], whole["letter"] = layout.itemsize + 2, ord("D")
        whole["number"], whole["record"] = self._records[name][0], rows
        return self._put(whole.tobytes(), int(rows["timestamp"][-1]), len(rows))

    def dropout(self, lost_ms: int, timestamp_us: int) -> bool:
        """Log that nothing could be logged for `lost_ms` before `timestamp_us`."""
        return self._put(_dropout(lost_ms), timestamp_us)

    def text(self, level: str, timestamp_us: int, line: str) -> bool:
        """Log a line of text of a level of LEVELS. Raises LogError for another level."""
        if level not in LEVELS:
            raise LogError(f"no level {shown(level)}", self._where, f"use {', '.join(LEVELS)}")
        with _fitting(self._where):
            body = Struct("<BQ").pack(ord("0") + LEVELS[level], timestamp_us) + line.encode()[:1000]
        return self._put(_message("L", body), timestamp_us)

    def parameter(self, name: str, value: float, timestamp_us: int) -> bool:
        """Log a change of a parameter. Raises LogError for a value that ULog cannot hold."""
        return self._put(self._parameter(name, value), timestamp_us)

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
        with _fitting(f"{self._where}: {key}"):
            return _keyed("I", f"int64_t {key}", Struct("<q").pack(value))

    def _parameter(self, name: str, value: float) -> bytes:
        _named(name, self._where)
        kind, letter = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
        with _fitting(f"{self._where}: {name}"):
            return _keyed("P", f"{kind} {name}", Struct(letter).pack(value))

    def _take(self) -> bytes | None:
        taken, self._buffer = bytes(self._buffer), bytearray()
        return taken or None

    def _encode(self, taken: object) -> bytes:
        return (taken if isinstance(taken, bytes) else b"") + MARK


def record_layout(name: str, description: str, where: str) -> np.dtype[np.void]:
    """Return numpy's layout of records with a format such as `uint64_t timestamp;float[3] xyz;`. Raises LogError."""
    _named(name, where)
    fields: list[Any] = []
    for part in filter(None, description.split(";")):
        match = _FIELD.fullmatch(part.strip())
        if match is None:
            what = f"{shown(part)} is not a field of a format"
            raise LogError(what, f"{where}: {name}", "give a type, such as uint8_t or float[3], and a name")
        kind = _KINDS.get(match[1], match[1].removesuffix("_t"))
        fields.append((match[3], kind, (int(match[2]),) if match[2] else ()))
    if not fields or fields[0] != ("timestamp", "uint64", ()):
        what = f"the format {description[:80]!r} does not begin with a time stamp"
        raise LogError(what, f"{where}: {name}", "begin it with uint64_t timestamp")
    try:
        layout = np.dtype(fields)
    except ValueError as reason:
        raise LogError(f"a format names a field twice: {reason}", f"{where}: {name}", "rename one field") from reason
    if layout.itemsize > MAX_RECORD:
        raise LogError(
            f"a record has {layout.itemsize} bytes", f"{where}: {name}", f"at most {MAX_RECORD} are possible"
        )
    return layout


def _packing(layout: np.dtype[np.void]) -> Struct:
    """Return the packing of a record, its number first."""
    kinds = [layout[name] for name in layout.names or ()]
    letters = (int(np.prod(kind.shape)) * kind.base.char for kind in kinds)
    # numpy's letters are those of struct, except where C's long has 8 bytes.
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


@contextmanager
def _fitting(where: str) -> Iterator[None]:
    """Turn what `struct` raises for numbers that do not fit into a LogError."""
    try:
        yield
    except (error, TypeError, OverflowError) as reason:
        raise LogError(f"a number does not fit: {reason}", where, "give numbers that the format can hold") from reason


MOST = 249
"""Bytes of LOGGING_DATA."""
NO_MESSAGE = 255
_FIRST_RECORDS = frozenset(b"DLO")
"""Messages with which the log itself begins: records, texts, dropouts."""


class ULogFragment(NamedTuple):
    """Bytes of a log that fit into one LOGGING_DATA; `first` is the index of the first message in them, or NO_MESSAGE.

    `described` marks the bytes before the first record, without which nothing can be read.
    """

    data: bytes
    first: int
    described: bool


class ULogFragments:
    """Cutter of a ULog's bytes into fragments for LOGGING_DATA, as the file grows."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._given = 0
        self._starts: deque[int] = deque([0])  # of messages, and of the file, that were not given yet
        self._next = HEADER.size  # start of the next message, whose length is not known yet
        self._records: int | None = None  # start of the first record

    @property
    def waiting(self) -> int:
        """Return the number of bytes that were fed and not returned."""
        return len(self._bytes)

    def feed(self, data: bytes) -> None:
        """Append the file's next bytes."""
        self._bytes += data
        end = self._given + len(self._bytes)
        while self._next + MESSAGE.size <= end:
            length, letter = MESSAGE.unpack_from(self._bytes, self._next - self._given)
            if letter in _FIRST_RECORDS and self._records is None:
                self._records = self._next
            self._starts.append(self._next)
            self._next += MESSAGE.size + length

    def next(self) -> ULogFragment | None:
        """Return the next fragment, None while there is none; the first record begins a new fragment."""
        at = self._given
        end = min(at + MOST, at + len(self._bytes), self._next)
        described = self._records is None or at < self._records
        if self._records is not None and described:
            end = min(end, self._records)
        if end == at:
            return None
        first = self._starts[0] - at if self._starts and self._starts[0] < end else NO_MESSAGE
        while self._starts and self._starts[0] < end:
            self._starts.popleft()
        data = bytes(self._bytes[: end - at])
        del self._bytes[: end - at]
        self._given = end
        return ULogFragment(data, first, described)
