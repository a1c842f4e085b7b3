"""Kills and disarmings in what has arrived: found before their turn comes, so that they wait behind nothing.

Whoever can put such a frame into a stream, inside of another even, could have sent it as it is.
"""

import re
from types import MappingProxyType
from typing import NamedTuple

from twodof.link.mavlink.framing import CHECKSUM, HEADER_1, HEADER_2, MARKER_1, MARKER_2, SIGNATURE, SIGNED, Parser

# COMMAND_INT and COMMAND_LONG, and behind their first 7 parameters the command.
_COMMANDS, _COMMAND, _LOW_ARM_DISARM, _TERMINATE = (75, 76), 28, 400 & 0xFF, 185

# COMMAND_INT and COMMAND_LONG in either MAVLink.
_HEAD = re.compile(rb"\xfd.[\x00\x01]....[\x4b\x4c]\x00\x00|\xfe.{4}[\x4b\x4c]", re.DOTALL)
# The longest of these frames: a signed one with all its 33 bytes.
LONGEST = HEADER_2 + 33 + CHECKSUM + SIGNATURE
# Who sends more that looks so and does not hold has the rest looked at in its turn.
MOST_FALSE = 4


class _Form(NamedTuple):
    """Where a frame has its message's number and its parameters; the number has all bytes between."""

    number: int
    params: int


_FORMS = MappingProxyType({MARKER_2: _Form(7, HEADER_2), MARKER_1: _Form(5, HEADER_1)})


def looks_like_a_stop(data: bytes) -> bool:
    """Whether a packet begins as a kill or a disarming does, in either MAVLink, be its checksum right or wrong."""
    form = _FORMS.get(data[0]) if data else None
    if form is None or len(data) <= form.params + _COMMAND or data[form.number] not in _COMMANDS:
        return False
    if any(data[form.number + 1 : form.params]):
        return False
    low = data[form.params + _COMMAND]
    return low == (_TERMINATE if any(data[form.params : form.params + 4]) else _LOW_ARM_DISARM)


def find_stop_frames(data: bytes, since: int = 0) -> list[bytes]:
    """The frames in `data` that stop motors and whose checksum holds, of those that end after the first `since`."""
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
