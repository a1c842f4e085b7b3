"""Streams of telemetry: the union of the clients' requests for the vehicle, and the clients that get each message."""

import math
from collections.abc import Sequence
from functools import cache

from twodof.companion.client import EVERY, OFF, PROFILES, CompanionClient, StreamRequest, profile
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
    """The clients and their requests. `asked` has the request last sent to the vehicle, by message id."""

    def __init__(self) -> None:
        self.clients: list[CompanionClient] = []
        self.asked: dict[int, StreamRequest] = {}

    def union(self, number: int) -> StreamRequest:
        """Return the request that serves all clients: the shortest interval, and of a batch all channels."""
        intervals = [client.interval(number) for client in self.clients]
        if number == BATCH:
            requests = [
                request
                for client in self.clients
                if (request := client.requests.get(BATCH)) and request.interval > EVERY
            ]
            mask = 0
            for request in requests:
                mask |= request.mask
            every = math.gcd(*(min(max(round(request.interval / TICK_US), 1), MOST_EVERY) for request in requests))
            return StreamRequest(every * TICK_US, mask) if mask else StreamRequest(OFF)
        timed = [one for one in intervals if one > EVERY]
        return StreamRequest(min(timed, default=EVERY if EVERY in intervals else OFF))

    def changes(self) -> list[tuple[int, StreamRequest]]:
        """Return id and request of each message whose request has changed, and count it as sent to the vehicle."""
        numbers = _timed().union(self.asked, *(client.requests for client in self.clients))
        before = dict(self.asked)
        return [
            (number, request) for number in sorted(numbers) if (request := self.announce(number)) != before.get(number)
        ]

    def announce(self, number: int) -> StreamRequest:
        """Return the union of requests for a message and count it as sent; forget an unused message."""
        request = self.union(number)
        self.asked[number] = request
        if request.interval == OFF and number not in _timed():
            del self.asked[number]
        return request

    def receivers(self, frame: Frame) -> Sequence[CompanionClient]:
        """Return the clients that get a message of the vehicle without an addressee."""
        number = frame.message_id
        default = OFF if number in _streamed() else EVERY
        asked = self.asked.get(number)
        interval = OFF if asked is None else asked.interval
        return [client for client in self.clients if client.wants(frame, interval, default)]


def stream_request(number: int, asked: CommandFields) -> StreamRequest | None:
    """Return the request in command 511; None for a return to the default, or for numbers that make no sense."""
    interval = asked.params[1]
    if not math.isfinite(interval) or (interval == 0.0 and number != BATCH):
        return None
    every = round(min(max(interval, -1.0), LONGEST_US))
    if number != BATCH or every == OFF:
        return StreamRequest(every)
    mask = max(whole(asked.params[2]), 0) & 0xFFFF | (max(whole(asked.params[3]), 0) & 0xFFFF) << 16
    return StreamRequest(every or TICK_US, mask)


def whole(value: float) -> int:
    """Return a parameter of a command as an integer, -1 if it is not finite or too large."""
    return round(value) if math.isfinite(value) and abs(value) < 2**31 else -1
