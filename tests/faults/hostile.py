"""Hostile MAVLink: recorded traffic and messages of every kind with fields that nobody would send, checksums right."""

import random
import struct
from collections.abc import Callable
from functools import cache

from tests.link.mavlink.test_framing import random_message, repaired
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import encode

HEADER, CHECKSUM = 10, 2
FLOATS = [struct.pack("<f", value) for value in (0.0, -0.0, 1.0, -1.0, 3e38, 1e-42, float("inf"), float("nan"))]
WHOLES = [struct.pack("<i", value) for value in (-1, 0, 1, 2**31 - 1, -(2**31), 0x00FF00FF)]
# Commands that are carried out, and some that are not.
COMMANDS = (176, 178, 179, 183, 185, 203, 241, 245, 246, 262, 300, 400, 401, 410, 500, 510, 511, 512, 519, 520, 521)
COMMANDS += (1000, 2500, 2510, 2511, 31010, 31011, 42600, 65535)
VALUES = (0.0, 1.0, 2.0, -1.0, 21196.0, 6.0, 4.0, 3.0, 54203.0, 54206.0, 253.0, 1e30, float("nan"), float("inf"))


@cache
def _places(number: int) -> dict[str, tuple[int, int]]:
    """Offset and size of each plain field in the payload of a message."""
    kind = dialect.load().mavlink_map[number]
    sizes = {"c": 1, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "q": 8, "Q": 8, "d": 8}
    places, at = {}, 0
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    formats = kind.native_format.decode().lstrip("<")
    for field, letter in zip(kind.ordered_fieldnames, formats, strict=True):
        size = sizes[letter]
        places[field] = (at, size)
        at += size * max(1, lengths[field])
    return places


class Hostile:
    """Frames without end, by a seed. `recorded` are frames of sound traffic, `source` draws who sends, `avoid` are
    messages that are not sent, `commands` those of COMMAND_LONG and COMMAND_INT."""

    def __init__(
        self,
        seed: int,
        recorded: list[bytes],
        source: Callable[[random.Random], tuple[int, int]],
        avoid: frozenset[int] = frozenset(),
        commands: tuple[int, ...] = COMMANDS,
    ) -> None:
        self.commands = commands
        self.chance = random.Random(seed)
        self.recorded = [raw for raw in recorded if int.from_bytes(raw[7:10], "little") not in avoid]
        self.source = source
        names = [name for name, kind in dialect.classes().items() if kind.id not in avoid]
        made = [encode(random_message(name, self.chance), 250, 190, 0) for name in names for _ in range(8)]
        own = [encode(random_message(name, self.chance), 250, 190, 0) for name in names if name.startswith("TWODOF")]
        self.pool = [*made, *own * 16]

    def next(self) -> bytes:
        """One more."""
        chance = self.chance
        draw = chance.random()
        if draw < 0.05:
            return chance.randbytes(chance.randrange(1, 300))
        raw = bytearray(chance.choice(self.recorded) if draw < 0.5 else chance.choice(self.pool))
        raw[5], raw[6] = self.source(chance)
        if raw[2] & 1:  # a signature that fits no more
            raw[2] = 0
            del raw[HEADER + raw[1] + CHECKSUM :]
        if draw < 0.15:
            return self._damaged(bytearray(repaired(bytes(raw))))
        self._addressed(raw)
        if chance.random() < 0.9:
            self._fields(raw)
        raw[4] = chance.randrange(256)
        return repaired(bytes(raw))

    def _damaged(self, raw: bytearray) -> bytes:
        chance = self.chance
        for _ in range(chance.randint(1, 4)):
            raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
        if chance.random() < 0.3:
            del raw[chance.randrange(1, len(raw)) :]
        return bytes(raw)

    def _addressed(self, raw: bytearray) -> None:
        """Mostly for us, so that it is not simply passed by."""
        number = int.from_bytes(raw[7:10], "little")
        for field in ("target_system", "target_component", "target"):
            place = _places(number).get(field)
            if place is not None and self.chance.random() < 0.8:
                self._put(
                    raw, place[0], bytes([self.chance.choice((1, 1, 1, 0)) if field != "target_component" else 1])
                )
        if number in (75, 76) and self.chance.random() < 0.8:
            at, _ = _places(number)["command"]
            self._put(raw, at, struct.pack("<H", self.chance.choice(self.commands)))
            for field in ("param1", "param2", "param3", "param4"):
                if self.chance.random() < 0.8:
                    self._put(raw, _places(number)[field][0], struct.pack("<f", self.chance.choice(VALUES)))

    def _fields(self, raw: bytearray) -> None:
        """One field or two hold what nobody would send; sometimes the payload is cut or longer."""
        chance = self.chance
        number = int.from_bytes(raw[7:10], "little")
        places = [*_places(number).items()]
        for _ in range(chance.randint(0, 2)):
            field, (at, size) = chance.choice(places)
            if field.startswith("target"):
                continue
            value = {
                1: lambda: bytes([chance.choice((0, 1, 2, 3, 4, 127, 128, 254, 255, chance.randrange(256)))]),
                2: lambda: struct.pack("<H", chance.choice((0, 1, 0x7FFF, 0x8000, 0xFFFF, chance.randrange(65536)))),
                4: lambda: chance.choice((*FLOATS, *WHOLES, chance.randbytes(4))),
                8: lambda: chance.choice(
                    (b"\xff" * 8, b"\0" * 8, struct.pack("<d", float("nan")), chance.randbytes(8))
                ),
            }[size]()
            self._put(raw, at, value)
        if chance.random() < 0.1:
            del raw[HEADER + chance.randrange(len(raw) - HEADER) :]
            raw += b"\0\0"
        elif chance.random() < 0.05:
            raw[-2:-2] = chance.randbytes(chance.randrange(1, 40))

    @staticmethod
    def _put(raw: bytearray, at: int, value: bytes) -> None:
        """Into the payload, whose trailing zeros a sender leaves out."""
        end = HEADER + at + len(value)
        payload_end = len(raw) - CHECKSUM
        if end > payload_end:
            raw[payload_end:payload_end] = bytes(end - payload_end)
        raw[HEADER + at : end] = value
