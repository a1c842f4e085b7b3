"""What a router reads of a frame without decoding it: whom it is for, which time it tells, whether it stops motors.

A frame passes in microseconds only if nothing is made of it that nobody asks for. Where fields stand is taken from the
dialect; MAVLink 2 cuts zeros from a payload's end, so that a field beyond its end is zero.
"""

import struct
from functools import cache
from typing import Any, NamedTuple

from fastcrc import crc16

from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import HEADER_1, HEADER_2, Frame, crc_extras

HEARTBEAT = 0
PARAM_REQUEST_READ, PARAM_REQUEST_LIST, PARAM_VALUE, PARAM_SET = 20, 21, 22, 23
REQUEST_DATA_STREAM, COMMAND_INT, COMMAND_LONG, COMMAND_ACK = 66, 75, 76, 77
LOG_REQUEST_LIST, LOG_ENTRY, LOG_REQUEST_DATA, LOG_DATA, LOG_ERASE, LOG_REQUEST_END = 117, 118, 119, 120, 121, 122
ATTITUDE, MESSAGE_INTERVAL, BATCH, TRUTH, TICK, LEASE, PARAM_TRANSACTION = 30, 244, 54203, 54205, 54208, 54209, 54212
ARM_DISARM, FLIGHT_TERMINATION = 400, 185
TERMINATED = 8  # MAV_STATE_FLIGHT_TERMINATION
FORCE = 21196.0  # param2 of a disarm that is meant in flight too
GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 510, 511, 512
# Fields that tell the sender's time, and how many microseconds their unit has.
_TIMES = {"time_boot_ms": 1000, "time_usec": 1}
_SIZES = {"char": 1, "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4, "float": 4}
_COMMAND = struct.Struct("<7fHBB")


class FieldOffsets(NamedTuple):
    """Where in a payload the target's system and component stand, and the time [bytes]; -1: nowhere."""

    system: int = -1
    component: int = -1
    time: int = -1
    time_end: int = -1
    microseconds: int = 0


class CommandFields(NamedTuple):
    """A COMMAND_LONG, or what a COMMAND_INT has in the same places (its param5 and param6 are integers: not read)."""

    params: tuple[float, ...]
    command: int
    system: int
    component: int


@cache
def places() -> dict[int, FieldOffsets]:
    """By message id, of each message that the dialect has."""
    return {number: _places(kind) for number, kind in dialect.load().mavlink_map.items()}


def _places(kind: Any) -> FieldOffsets:
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    at, starts = 0, {}  # where each field begins
    for name, count in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
        starts[name] = at
        at += _SIZES.get(types[name], 8) * count
    time = next((name for name in _TIMES if name in starts), None)
    return FieldOffsets(
        starts.get("target_system", starts.get("target", -1)),
        starts.get("target_component", -1),
        *(() if time is None else (starts[time], starts[time] + _SIZES.get(types[time], 8), _TIMES[time])),
    )


def target(frame: Frame) -> tuple[int, int]:
    """System and component that a frame is for, 0 for all; (0, 0) of a message that has no target or is unknown."""
    where = places().get(frame.message_id)
    if where is None or where.system < 0:
        return 0, 0
    raw = frame.raw
    start, length = HEADER_2 if frame.version == 2 else HEADER_1, raw[1]
    system = raw[start + where.system] if where.system < length else 0
    component = raw[start + where.component] if 0 <= where.component < length else 0
    return system, component


def time_us(frame: Frame) -> int:
    """The time [us] that a frame's sender wrote into it, -1 if its message does not have one."""
    where = places().get(frame.message_id)
    if where is None or where.time < 0:
        return -1
    start = HEADER_2 if frame.version == 2 else HEADER_1
    stop = start + min(where.time_end, frame.raw[1])  # bytes that were cut are zero, and little end first
    return int.from_bytes(frame.raw[start + where.time : stop], "little") * where.microseconds


def command(frame: Frame) -> CommandFields | None:
    """The command in a frame; None if it carries none."""
    if frame.message_id not in (COMMAND_LONG, COMMAND_INT):
        return None
    *params, number, system, component = _COMMAND.unpack(frame.payload[: _COMMAND.size].ljust(_COMMAND.size, b"\0"))
    return CommandFields(tuple(params), number, system, component)


def stop(asked: CommandFields) -> tuple[int, bool] | None:
    """Which kind of kill or disarm a command is (these never wait their turn), None if it is none.

    The kinds are the command and whether it is forced. A disarm that the vehicle refuses in flight must not hold up one
    that it obeys.
    """
    if asked.command == ARM_DISARM and asked.params[0] == 0.0:
        return ARM_DISARM, asked.params[1] == FORCE
    if asked.command == FLIGHT_TERMINATION and asked.params[0] > 0.5:
        return FLIGHT_TERMINATION, True
    return None


def renumbered(frame: Frame, sequence: int) -> bytes:
    """The frame's bytes under another sequence number, as they are if it is signed, unknown or of MAVLink 1."""
    if frame.sequence == sequence or frame.signed or frame.version != 2 or not frame.known:
        return frame.raw
    body = bytearray(frame.raw[:-2])
    body[4] = sequence
    return bytes(body) + crc16.mcrf4xx(bytes(body[1:]) + crc_extras()[frame.message_id]).to_bytes(2, "little")
