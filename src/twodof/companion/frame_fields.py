"""Fields of a frame that the router reads without decoding it: target, time, command.

A frame then passes in microseconds. The offsets of fields come from the dialect. MAVLink 2 cuts zeros from the end of a
payload, so a field beyond the end is zero.
"""

import re
import struct
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple

from fastcrc import crc16

from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import HEADER_1, HEADER_2, Frame, crc_extras, stops_motors

HEARTBEAT, REQUEST_DATA_STREAM, COMMAND_INT, COMMAND_LONG = 0, 66, 75, 76
BATCH, TRUTH, RIG, LEASE = 54203, 54205, 54206, 54209
FLIGHT_TERMINATION = 185
TERMINATED = 8  # MAV_STATE_FLIGHT_TERMINATION
FORCE = 21196.0  # param2 of a disarm that is meant in flight too
GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 510, 511, 512
# Fields with the sender's time, and the microseconds of their unit.
_TIMES = {"time_boot_ms": 1000, "time_usec": 1}
_COMMAND = struct.Struct("<7fHBB")


class FieldOffsets(NamedTuple):
    """Offsets [byte] of the target and of the time in a payload; -1 where the message lacks it."""

    system: int = -1
    component: int = -1
    time: int = -1
    time_end: int = -1
    microseconds: int = 0


class CommandFields(NamedTuple):
    """Fields of a COMMAND_LONG or COMMAND_INT; the integers param5 and param6 of the latter are not valid here."""

    params: tuple[float, ...]
    command: int
    system: int
    component: int


@cache
def places() -> dict[int, FieldOffsets]:
    """Return the offsets of each message of the dialect by its id."""
    return {number: _places(kind) for number, kind in dialect.load().mavlink_map.items()}


def _places(kind: Any) -> FieldOffsets:
    codes = re.findall(r"\d*[a-zA-Z]", kind.unpacker.format)
    ends = [*accumulate(struct.calcsize(f"<{code}") for code in codes)]
    starts: dict[str, int] = dict(zip(kind.ordered_fieldnames, [0, *ends], strict=False))
    time = next((name for name in _TIMES if name in starts), None)
    return FieldOffsets(
        starts.get("target_system", starts.get("target", -1)),
        starts.get("target_component", -1),
        *(() if time is None else (starts[time], ends[kind.ordered_fieldnames.index(time)], _TIMES[time])),
    )


def target(frame: Frame) -> tuple[int, int]:
    """Return the system and component that a frame is for, 0 for all; (0, 0) for an unknown message."""
    where = places().get(frame.message_id)
    if where is None or where.system < 0:
        return 0, 0
    raw = frame.raw
    start, length = HEADER_2 if frame.version == 2 else HEADER_1, raw[1]
    system = raw[start + where.system] if where.system < length else 0
    component = raw[start + where.component] if 0 <= where.component < length else 0
    return system, component


def time_us(frame: Frame) -> int:
    """Return the sender's time in a frame [us], -1 if its message lacks it."""
    where = places().get(frame.message_id)
    if where is None or where.time < 0:
        return -1
    start = HEADER_2 if frame.version == 2 else HEADER_1
    stop = start + min(where.time_end, frame.raw[1])  # cut bytes are zero; little endian
    return int.from_bytes(frame.raw[start + where.time : stop], "little") * where.microseconds


def command(frame: Frame) -> CommandFields | None:
    """Return the command in a frame, None if it carries none."""
    if frame.message_id not in (COMMAND_LONG, COMMAND_INT):
        return None
    *params, number, system, component = _COMMAND.unpack(frame.payload[: _COMMAND.size].ljust(_COMMAND.size, b"\0"))
    return CommandFields(tuple(params), number, system, component)


def stop(asked: CommandFields) -> tuple[int, bool] | None:
    """Return the kind of kill or disarm of a command, None for any other command.

    A kind is the command and whether it is forced. Kills and disarms go before all other frames, and a disarm that the
    vehicle refuses in flight must not replace a forced one.
    """
    if not stops_motors(asked.command, asked.params[0]):
        return None
    return asked.command, asked.command == FLIGHT_TERMINATION or asked.params[1] == FORCE


def renumbered(frame: Frame, sequence: int) -> bytes:
    """Return the frame's bytes with another sequence number; signed, unknown and MAVLink 1 frames stay unchanged."""
    if frame.sequence == sequence or frame.signed or frame.version != 2 or not frame.known:
        return frame.raw
    body = bytearray(frame.raw[:-2])
    body[4] = sequence
    return bytes(body) + crc16.mcrf4xx(bytes(body[1:]) + crc_extras()[frame.message_id]).to_bytes(2, "little")
