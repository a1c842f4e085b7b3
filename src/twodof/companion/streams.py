"""Streams of telemetry: the union of the clients' wishes for the vehicle, and the clients that get each message."""

import math
from collections.abc import Sequence
from functools import cache

from twodof.companion.client import EVERY, OFF, PROFILES, CompanionClient, Wish, profile
from twodof.companion.frame_fields import BATCH, CommandFields
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Frame
from twodof.signals import TICK_US

LONGEST_US = 2**31 - 1
MOST_EVERY = 255
# Sent to clients that asked for them only.
_ON_REQUEST = ("TWODOF_BATCH", "TWODOF_TRUTH")


@cache
def _timed() -> frozenset[int]:
    """Return the messages whose interval is sent to the vehicle even if no client wants one.

    These are the messages with a rate, and TWODOF_TOF, which comes so often that it should not cross the line unused.
    """
    timed = {number for name in PROFILES for number, interval in profile(name).items() if interval > EVERY}
    return frozenset(timed | {dialect.message_id("TWODOF_TOF")})


@cache
def _streamed() -> frozenset[int]:
    """Return the messages that only go to clients that want them; all others go to every client."""
    unasked = {number for name in PROFILES for number in profile(name)}
    return frozenset(unasked | {dialect.message_id(name) for name in _ON_REQUEST})


class Streams:
    """The clients and their wishes. `asked` has the wish last sent to the vehicle, by message id."""

    def __init__(self) -> None:
        self.clients: list[CompanionClient] = []
        self.asked: dict[int, Wish] = {}

    def union(self, number: int) -> Wish:
        """Return the wish that serves all clients: the shortest interval, and of a batch all channels."""
        intervals = [client.interval(number) for client in self.clients]
        if number == BATCH:
            wishes = [wish for client in self.clients if (wish := client.wishes.get(BATCH)) and wish.interval > EVERY]
            mask = 0
            for wish in wishes:
                mask |= wish.mask
            every = math.gcd(*(min(max(round(wish.interval / TICK_US), 1), MOST_EVERY) for wish in wishes))
            return Wish(every * TICK_US, mask) if mask else Wish(OFF)
        timed = [one for one in intervals if one > EVERY]
        return Wish(min(timed, default=EVERY if EVERY in intervals else OFF))

    def changes(self) -> list[tuple[int, Wish]]:
        """Return id and wish of each message whose wish has changed, and count it as sent to the vehicle."""
        numbers = _timed().union(self.asked, *(client.wishes for client in self.clients))
        before = dict(self.asked)
        return [(number, wish) for number in sorted(numbers) if (wish := self.announce(number)) != before.get(number)]

    def announce(self, number: int) -> Wish:
        """Return the union of wishes for a message, and count it as sent to the vehicle; forget an unused message."""
        wish = self.union(number)
        self.asked[number] = wish
        if wish.interval == OFF and number not in _timed():
            del self.asked[number]
        return wish

    def receivers(self, frame: Frame) -> Sequence[CompanionClient]:
        """Return the clients that get a message of the vehicle without an addressee."""
        number = frame.message_id
        default = OFF if number in _streamed() else EVERY
        asked = self.asked.get(number)
        interval = OFF if asked is None else asked.interval
        return [client for client in self.clients if client.wants(frame, interval, default)]


def wish_of(number: int, asked: CommandFields) -> Wish | None:
    """Return the wish in command 511; None for a return to the default, or for numbers that make no sense."""
    interval = asked.params[1]
    if not math.isfinite(interval) or (interval == 0.0 and number != BATCH):
        return None
    every = round(min(max(interval, -1.0), LONGEST_US))
    if number != BATCH or every == OFF:
        return Wish(every)
    mask = max(whole(asked.params[2]), 0) & 0xFFFF | (max(whole(asked.params[3]), 0) & 0xFFFF) << 16
    return Wish(every or TICK_US, mask)


def whole(value: float) -> int:
    """Return a parameter of a command as an integer, -1 if it is not finite or too large."""
    return round(value) if math.isfinite(value) and abs(value) < 2**31 else -1
