"""Kills and disarmings in what has arrived: found before their turn comes, so that they wait behind nothing.

Whoever can put such a frame into a stream, inside of another even, could have sent it as it is.
"""

import re

from twodof.link.mavlink.framing import CHECKSUM, HEADER_1, HEADER_2, MARKER_2, SIGNATURE, SIGNED, Parser
from twodof.link.transport.flood_filter import looks_like_a_stop

# COMMAND_INT and COMMAND_LONG in either MAVLink.
_COMMAND = re.compile(rb"\xfd.[\x00\x01]....[\x4b\x4c]\x00\x00|\xfe.{4}[\x4b\x4c]", re.DOTALL)
# The longest of these frames: a signed one with all its 33 bytes.
LONGEST = HEADER_2 + 33 + CHECKSUM + SIGNATURE
# Who sends more that looks so and does not hold has the rest looked at in its turn.
MOST_FALSE = 4


def find_stop_frames(data: bytes, since: int = 0) -> list[bytes]:
    """The frames in `data` that stop motors and whose checksum holds, of those that end after the first `since`."""
    found, left = [], MOST_FALSE
    for match in _COMMAND.finditer(data):
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
