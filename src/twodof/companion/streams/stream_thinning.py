"""Who gets which message how often: the wishes of all clients, the fastest of them for the vehicle, the rest thinned.

Thinning goes by the time in the message, or by counting where a message has no time. It never goes by our clock, so
the same flight gives a client the same messages in lockstep and in real time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from twodof.companion.client import MOST_WISHES, CompanionClient, Wish
from twodof.companion.frame_fields import BATCH, time_us
from twodof.companion.streams.batch_repacking import together
from twodof.companion.streams.rate_profiles import EVERY, OFF, PROFILES, profile
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Frame

# What comes when it must: no rate can be asked for it.
_EVENTS = (
    *("HEARTBEAT", "PING", "PARAM_VALUE", "COMMAND_ACK", "TIMESYNC", "LOG_ENTRY", "LOG_DATA", "MESSAGE_INTERVAL"),
    *("STATUSTEXT", "LOGGING_DATA", "LOGGING_DATA_ACKED", "PARAM_ERROR", "EVENT", "CURRENT_EVENT_SEQUENCE"),
    *(
        "RESPONSE_EVENT_ERROR",
        "MISSION_ACK",
        "MISSION_COUNT",
        "TWODOF_OPENLOOP",
        "TWODOF_EXCITE",
        "TWODOF_EXCITE_STATUS",
    ),
    *("TWODOF_TICK", "TWODOF_GRANT", "TWODOF_LEASE", "TWODOF_PARAM_TRANSACTION"),
)
# More kinds of messages than any vehicle sends.
MOST_TAPS = 1024
# Nobody gets these who has not asked.
_ON_REQUEST = ("TWODOF_BATCH", "TWODOF_TRUTH")


@cache
def events() -> frozenset[int]:
    """Ids of the messages that no rate can be asked for."""
    return frozenset(dialect.message_id(name) for name in _EVENTS)


@cache
def settled() -> tuple[int, ...]:
    """Ids of the messages whose rates the vehicle is told even if no client has asked for them.

    These are the messages with a rate, and TWODOF_TOF, which comes so often that it should not cross the line unused.
    """
    timed = {number for name in PROFILES for number, one in profile(name).items() if one > EVERY}
    return tuple(sorted(timed | {dialect.message_id("TWODOF_TOF")}))


@cache
def _streamed() -> frozenset[int]:
    """Ids of the messages that only go to those who want them."""
    unasked = {number for name in PROFILES for number in profile(name)}
    return frozenset(unasked | {dialect.message_id(name) for name in _ON_REQUEST})


@dataclass(slots=True)
class _Tap:
    """One client's share of one message."""

    client: CompanionClient
    interval: int
    slot: int = -1
    credit: int = 0

    def passes(self, time: int, vehicle_interval: int) -> bool:
        """Whether the client gets the message of `time` [us], -1 if it tells none."""
        if self.interval <= max(vehicle_interval, EVERY):
            return True
        if time >= 0:
            if time // self.interval == self.slot:
                return False
            self.slot = time // self.interval
            return True
        self.credit += vehicle_interval if vehicle_interval > 0 else self.interval
        if self.credit < self.interval:
            return False
        self.credit %= self.interval
        return True


class ClientStreams:
    """Who wants what; `granted` is what the vehicle has been told, by message id."""

    def __init__(self) -> None:
        self.clients: list[CompanionClient] = []
        self.granted: dict[int, Wish] = {}
        self._taps: dict[int, list[_Tap]] = {}

    def changed(self) -> None:
        """A client came, went or forgot."""
        self._prune()
        for number in self._taps:
            self._renew(number)

    def set(self, client: CompanionClient, message_id: int, wish: Wish | None) -> bool:
        """A client's wish, None for its default again; False if it has too many."""
        if wish is None:
            client.wishes.pop(message_id, None)
        elif message_id in client.wishes or len(client.wishes) < MOST_WISHES:
            client.wishes[message_id] = wish
        else:
            return False
        self._renew(message_id)
        return True

    def chosen(self, message_id: int) -> bool:
        """Whether a message goes only to those who want it, as often as they do; else to all, as it comes."""
        if message_id in events():
            return False
        return message_id in _streamed() or any(message_id in client.wishes for client in self.clients)

    def wanted(self, message_id: int) -> Wish:
        """What the vehicle must send so that everybody has enough: EVERY means at its own rate."""
        if message_id == BATCH:
            return together([client.wishes[BATCH] for client in self.clients if BATCH in client.wishes])
        intervals = [client.wish(message_id) for client in self.clients]
        timed = [one for one in intervals if one > EVERY]
        return Wish(min(timed, default=EVERY if EVERY in intervals else OFF))

    def receivers(self, frame: Frame) -> Sequence[CompanionClient]:
        """Who gets a message of the vehicle that is addressed to nobody."""
        number = frame.message_id
        taps = self._taps.get(number)
        if taps is None:
            if len(self._taps) >= MOST_TAPS:
                self._prune()
            taps = self._renew(number)
        at = self.granted.get(number, Wish(OFF)).interval
        time = -1 if all(tap.interval <= max(at, EVERY) for tap in taps) else time_us(frame)
        found = []
        for tap in taps:
            if (tap.interval != OFF and tap.passes(time, at)) or number in tap.client.due_once:
                found.append(tap.client)
                tap.client.due_once.pop(number, None)
        return found

    def _prune(self) -> None:
        """Forget who gets what all get alike: it is found out again when it comes."""
        self._taps = {number: taps for number, taps in self._taps.items() if self.chosen(number)}

    def _renew(self, number: int) -> list[_Tap]:
        """Find out anew who gets a message, what was thinned out so far kept in mind."""
        before = {(tap.client, tap.interval): tap for tap in self._taps.get(number, ())}
        chosen, taps = self.chosen(number), []
        for client in self.clients:
            untouched = EVERY if client.understands(number) else OFF
            interval = client.wish(number) if chosen else untouched
            taps.append(before.get((client, interval)) or _Tap(client, interval))
        self._taps[number] = taps
        return taps
