"""Search for kills and disarms in received data, so that they can be taken before everything that waits."""

import re
from types import MappingProxyType
from typing import NamedTuple

from twodof.link.mavlink.framing import (
    CHECKSUM,
    HEADER_1,
    HEADER_2,
    MARKER_1,
    MARKER_2,
    SIGNATURE,
    SIGNED,
    Parser,
)

# COMMAND_INT and COMMAND_LONG; the command stands behind their first 7 parameters.
_COMMANDS, _COMMAND, _LOW_ARM_DISARM, _TERMINATE = (75, 76), 28, 400 & 0xFF, 185
_HEAD = re.compile(rb"\xfd.[\x00\x01]....[\x4b\x4c]\x00\x00|\xfe.{4}[\x4b\x4c]", re.DOTALL)
LONGEST = HEADER_2 + 33 + CHECKSUM + SIGNATURE
"""Bytes of the longest of these frames: a signed one with all its 33 bytes of payload."""
# After so many frames that only look like a stop, the rest of the data is left to the ordinary parser.
MOST_FALSE = 4


class _Layout(NamedTuple):
    """Offsets of the message id and of the payload in a frame; the bytes between them belong to the id."""

    message_id: int
    payload: int


_LAYOUTS = MappingProxyType({MARKER_2: _Layout(7, HEADER_2), MARKER_1: _Layout(5, HEADER_1)})


def looks_like_a_stop(data: bytes) -> bool:
    """Return True if data begins like a kill or a disarm, in MAVLink 1 or 2; the checksum is not verified."""
    layout = _LAYOUTS.get(data[0]) if data else None
    if layout is None or len(data) <= layout.payload + _COMMAND or data[layout.message_id] not in _COMMANDS:
        return False
    if any(data[layout.message_id + 1 : layout.payload]):
        return False
    low = data[layout.payload + _COMMAND]
    return low == (_TERMINATE if any(data[layout.payload : layout.payload + 4]) else _LOW_ARM_DISARM)


def find_stop_frames(data: bytes, since: int = 0) -> list[bytes]:
    """Return the kills and disarms in `data` with a valid checksum that end after the first `since` bytes.

    A frame inside another one counts: a sender that can write it there could have sent it by itself.
    """
    found, left = [], MOST_FALSE
    for match in _HEAD.finditer(data):
        start = match.start()
        if data[start] == MARKER_2:
            length = HEADER_2 + data[start + 1] + CHECKSUM + (SIGNATURE if data[start + 2] == SIGNED else 0)
        else:
            length = HEADER_1 + data[start + 1] + CHECKSUM
        raw = data[start : start + length]
        if start + length <= since or len(raw) < length or not looks_like_a_stop(raw):
            continue
        if any(frame.raw == raw for frame in Parser().feed(raw, whole=True)):
            found.append(raw)
        else:
            left -= 1
            if not left:
                break
    return found
