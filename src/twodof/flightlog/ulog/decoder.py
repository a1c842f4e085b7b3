"""Walks a ULog file into its records; bounded, and exact about what it could not read."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, shown
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.sanitise import RECOVER, Loss
from twodof.flightlog.ulog.format import (
    BASIC,
    HEADER,
    LETTERS,
    MAGIC,
    MAX_FORMATS,
    MESSAGE,
    SYNC,
    ULogField,
    fields_of,
    record_type,
)

MAX_LOGGED = 5000
MAX_TEXTS = 100_000
MAX_DROPOUTS = 1_000_000
# The specification's bit 0 of the incompatible flags: data is appended, at offsets that the message holds.
_APPENDED = 1
_SYNC_MESSAGE = MESSAGE.pack(len(SYNC), ord("S")) + SYNC
_ADD = Struct("<BH")
# A field of a format is 7 bytes and some 200 of objects; a value of a byte is a pointer, one of eight an object more.
_FORMAT_FACTOR = 12
_VALUE_FACTOR = 3
# In the information of our own logs, which have a mark at the end of each part that reached the disk.
_MARKED = b"\x10char[6] sys_nametwodof"


@dataclass(frozen=True)
class Logged:
    """The records of one topic: `rows` is a table with a column for each field."""

    name: str
    instance: int
    rows: NDArray[np.void]


@dataclass
class ULog:
    """What a file holds. `dropouts_ms` is the time that the logger could not write; `finished` that no damage is seen.

    `parameters` are those at the start; `changes` (time of the last record before it [us], name, value) later ones.
    """

    start_us: int = 0
    info: dict[str, Any] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    changes: list[tuple[int, str, float]] = field(default_factory=list)
    topics: list[Logged] = field(default_factory=list)
    texts: list[tuple[int, int, str]] = field(default_factory=list)
    dropouts_ms: list[int] = field(default_factory=list)
    lost: list[Loss] = field(default_factory=list)
    finished: bool = True

    def topic(self, name: str, instance: int = 0) -> Logged | None:
        """The records of a topic; None where it was not logged."""
        return next((one for one in self.topics if (one.name, one.instance) == (name, instance)), None)


class _Walk:
    def __init__(self, data: bytes, where: str, salvage: bool, budget: MemoryBudget) -> None:
        self.data, self.where, self.salvage, self.budget = data, where, salvage, budget
        self.found = ULog()
        self.formats: dict[str, list[ULogField]] = {}
        self.names: dict[int, tuple[str, int, np.dtype[np.void]]] = {}
        self.layouts: dict[tuple[str, int], np.dtype[np.void]] = {}
        self.made: dict[str, np.dtype[np.void]] = {}
        self.payloads: dict[tuple[str, int], list[bytes]] = {}
        self.started = False
        self.now_us = 0

    def run(self) -> ULog:
        if self.data[: len(MAGIC)] != MAGIC or len(self.data) < HEADER.size:
            raise LogError("is no ULog file", self.where, "give a log of PX4 or of the virtual flight controller")
        _, version, self.found.start_us = HEADER.unpack_from(self.data)
        if version > 1:
            raise LogError(f"is of ULog version {version}", self.where, "version 1 is read")
        at = HEADER.size
        for start, end in self._stretches(at):
            self._stretch(start, end)
        self._tables()
        return self.found

    def _stretches(self, at: int) -> Iterator[tuple[int, int]]:
        """Parts of the file whose messages follow each other without a break."""
        data, size = self.data, len(self.data)
        start, synced, marked = at, 0, False
        while at < size:
            length, letter = MESSAGE.unpack_from(data, at) if size - at >= MESSAGE.size else (size, 0)
            after = at + MESSAGE.size + length
            if after <= size and letter in LETTERS:
                self.budget.record()
                if letter == ord("S"):
                    synced = after
                marked = marked or data[at + MESSAGE.size : after] == _MARKED
                at = after
                continue
            # A tail that is only cut is the rule with logs on a flight controller; the messages before it are whole.
            cut = at + MESSAGE.size > size or letter in LETTERS
            if not cut and not self.salvage:
                raise LogError(f"no message at byte {at}", self.where, RECOVER)
            resume = data.find(_SYNC_MESSAGE, at) if self.salvage else size
            resume = size if resume < 0 else resume
            # Between the last mark and rubbish nothing vouches for a message. In a log of others that just ends, what
            # is before its end is taken; in our own nothing behind the last mark was acknowledged.
            ends = cut and resume == size
            sound = at if (ends and not marked) or not synced else max(synced, start)
            if sound > start:
                yield start, sound
            self._lose(sound, resume, "the last message is cut off" if ends else "rubbish")
            start = at = resume
        if min(at, size) > start:
            yield start, at

    def _lose(self, start: int, end: int, why: str) -> None:
        self.found.finished = False
        self.found.lost.append(Loss(start, end - start, why))
        if len(self.found.lost) > MAX_LOGGED:
            raise LogError(f"more than {MAX_LOGGED} damaged parts", self.where, "nothing can be trusted in it")

    def _stretch(self, at: int, end: int) -> None:
        data, number = self.data, Struct("<H")
        while at < end:
            length, letter = MESSAGE.unpack_from(data, at)
            start, after = at + MESSAGE.size, at + MESSAGE.size + length
            if letter == 0x44:  # D: nearly all of a file
                self._record(number.unpack_from(data, start)[0] if length >= 2 else -1, data[start + 2 : after], at)
            else:
                self._other(chr(letter), data[start:after], at)
            at = after

    def _record(self, number: int, payload: bytes, at: int) -> None:
        known = self.names.get(number)
        if known is None or len(payload) < known[2].itemsize:
            if not self.salvage:
                said = "is not described" if known is None else f"of {known[0]} has only {len(payload)} bytes"
                raise LogError(f"the record at byte {at} {said}", self.where, RECOVER)
            self._lose(at, at + MESSAGE.size + 2 + len(payload), "a record that is not described")
            return
        name, instance, layout = known
        self.payloads.setdefault((name, instance), []).append(payload[: layout.itemsize])
        if layout.names and layout.names[0] == "timestamp":
            self.now_us = int.from_bytes(payload[:8], "little")

    def _other(self, letter: str, body: bytes, at: int) -> None:
        try:
            match letter:
                case "B":
                    self._flags(body)
                case "F":
                    self._format(body)
                case "I" | "P":
                    self._value(letter, body)
                case "A":
                    self._added(body)
                case "L" | "C":
                    self._text(body, 9 if letter == "L" else 11)
                case "O" if len(body) == 2 and len(self.found.dropouts_ms) < MAX_DROPOUTS:
                    self.found.dropouts_ms.append(int.from_bytes(body, "little"))
        except LogError as reason:
            if not self.salvage or self.budget.spent:
                raise
            self._lose(at, at + MESSAGE.size + len(body), reason.what)

    def _flags(self, body: bytes) -> None:
        if len(body) < 16 or body[8] & ~_APPENDED or any(body[9:16]):
            raise LogError("needs a reader of a later ULog version", self.where, "use a newer twodof")

    def _format(self, body: bytes) -> None:
        name, colon, description = body.decode("ascii", "replace").partition(":")
        if not colon or len(self.formats) >= MAX_FORMATS:
            raise LogError(f"a format that is none: {shown(name)}", self.where, RECOVER)
        self.budget.text(_FORMAT_FACTOR * len(body))
        self.formats[name] = fields_of(description, f"{self.where}: {name[:80]}")
        self.made.clear()

    def _value(self, letter: str, body: bytes) -> None:
        self.budget.text(_VALUE_FACTOR * len(body))
        size = body[0] if body else 0
        found = fields_of(body[1 : 1 + size].decode("ascii", "replace"), self.where)
        kind, count, name = found[0]
        raw = body[1 + size :]
        width = np.dtype(BASIC[kind]).itemsize * max(count, 1) if kind in BASIC else -1
        if width != len(raw) or (letter == "P" and (kind, count) not in (("int32_t", 0), ("float", 0))):
            raise LogError(f"the value of {name} has {len(raw)} bytes", self.where, RECOVER)
        if kind == "char":
            value: Any = raw.rstrip(b"\0").decode("utf-8", "replace")
        else:
            self.budget.record(max(count, 1))
            value = np.frombuffer(raw, BASIC[kind]).tolist()
            value = value if count else value[0]
        if letter == "I":
            self.found.info[name] = value
        elif not self.started:
            self.found.parameters[name] = value
        elif len(self.found.changes) < MAX_TEXTS:
            self.found.changes.append((self.now_us, name, value))

    def _added(self, body: bytes) -> None:
        if len(body) <= _ADD.size:
            raise LogError("a topic without a name", self.where, RECOVER)
        instance, number = _ADD.unpack_from(body)
        name = body[_ADD.size :].decode("ascii", "replace")
        layout = self.made.get(name)
        if layout is None:
            layout = self.made[name] = record_type(name, self.formats, self.where, self.budget)
        if number not in self.names and len(self.names) >= MAX_LOGGED:
            raise LogError(f"more than {MAX_LOGGED} topics", self.where, "this is not a flight log")
        if self.layouts.setdefault((name, instance), layout) != layout:
            raise LogError(f"topic {shown(name)} has two layouts", self.where, RECOVER)
        self.started = True
        self.names[number] = (name, instance, layout)

    def _text(self, body: bytes, at: int) -> None:
        if len(body) < at:
            raise LogError("a text without its time", self.where, RECOVER)
        if len(self.found.texts) < MAX_TEXTS:
            stamp = int.from_bytes(body[at - 8 : at], "little")
            self.found.texts.append((body[0], stamp, body[at:].decode("utf-8", "replace")))

    def _tables(self) -> None:
        for (name, instance), layout in self.layouts.items():
            parts = self.payloads.pop((name, instance), [])
            self.budget.take(len(parts) * layout.itemsize)
            rows = np.frombuffer(b"".join(parts), layout)
            self.found.topics.append(Logged(name, instance, rows))


def scan_ulog(data: bytes, where: str, salvage: bool = False, budget: MemoryBudget | None = None) -> ULog:
    """What a ULog file holds. A cut last message is named in `lost`, as on a flight controller it is the rule.

    Raises LogError for what is no ULog and, without `salvage`, for any other damage.
    """
    return _Walk(data, where, salvage, budget or MemoryBudget(len(data), where)).run()
