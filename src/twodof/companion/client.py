"""A client of the companion: its address, its identities, and the messages that it wants."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, reduce
from operator import or_
from types import MappingProxyType

from twodof.companion.frame_fields import BATCH, CommandFields, renumbered, time_us
from twodof.errors import LinkError, LinkLost, listed, shown
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import FIRST_OWN_ID, LAST_OWN_ID, RATES
from twodof.link.mavlink.dialect import PROFILES as VEHICLE_PROFILES
from twodof.link.mavlink.framing import Frame
from twodof.link.transport.base import Transport
from twodof.signals import TICK_US

Identity = tuple[int, int]
"""A MAVLink system and component."""
MOST_IDENTITIES = 16
MOST_REQUESTS = 256
MOST_SENDERS = 64
"""Senders whose frames to a client are numbered; one more takes the place of the oldest."""
SILENT_S = 30.0
"""A client that is silent for so long counts as gone; a ground station sends a heartbeat each second."""
EVERY, OFF = 0, -1
"""Intervals: each message as it comes, and no message."""

LONGEST_US = 2**31 - 1
MOST_EVERY = 255
# Sent to clients that asked for them only.
_ON_REQUEST = ("TWODOF_BATCH", "TWODOF_TRUTH")

PROFILES = (*VEHICLE_PROFILES, "none")
# Sent at each change too, which thinning would hold back.
_ON_CHANGE = frozenset(row.number for row in RATES if row.on_change)
_OWN = ("TWODOF_RIG", "TWODOF_LEASE", "TWODOF_SAFETY", "TWODOF_TIMING")
GROUPS: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        1: ("HIGHRES_IMU",),
        2: ("SYS_STATUS", "EXTENDED_SYS_STATE", "BATTERY_STATUS"),
        3: ("SERVO_OUTPUT_RAW",),
        6: ("LOCAL_POSITION_NED", "ODOMETRY"),
        10: ("ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET"),
        11: ("VFR_HUD", "POSITION_TARGET_LOCAL_NED"),
        12: ("DISTANCE_SENSOR",),
    }
)
"""Groups of REQUEST_DATA_STREAM (MAV_DATA_STREAM); group 0 is all of them."""


@cache
def profile(name: str) -> Mapping[int, int]:
    """Return the message intervals [us], by message id, of the set of rates `name`. Raises LinkError if unknown."""
    if name not in PROFILES:
        raise LinkError(f"no set of rates {shown(name)}", "companion", f"choose one of {listed(PROFILES)}")
    rates = {number: rate for number, rate in VEHICLE_PROFILES.get(name, {}).items() if number not in _ON_CHANGE}
    timed = {number: round(1e6 / rate) if rate > 0.0 else EVERY for number, rate in rates.items()}
    return dict.fromkeys(map(dialect.message_id, _OWN), EVERY) | timed


@cache
def timed() -> frozenset[int]:
    """Return the messages whose interval is sent to the vehicle even if no client wants one.

    These are the messages with a rate, and TWODOF_TOF, which comes so often that it should not cross the line unused.
    """
    timed = {number for name in PROFILES for number, interval in profile(name).items() if interval > EVERY}
    return frozenset(timed | {dialect.message_id("TWODOF_TOF")})


@cache
def streamed() -> frozenset[int]:
    """Return the messages that only go to clients that want them; all others go to every client."""
    unasked = {number for name in PROFILES for number in profile(name)}
    return frozenset(unasked | {dialect.message_id(name) for name in _ON_REQUEST})


def group(number: int) -> tuple[int, ...] | None:
    """Return the message ids of group `number` of REQUEST_DATA_STREAM; None for group 0, which is all messages."""
    return None if number == 0 else tuple(map(dialect.message_id, GROUPS.get(number, ())))


def is_ours(message_id: int) -> bool:
    """Return True for the id of one of twodof's own messages."""
    return FIRST_OWN_ID <= message_id <= LAST_OWN_ID


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """The interval [us] at which a message is wanted, and for a batch the mask of its channels."""

    interval: int
    mask: int = 0


@dataclass(eq=False)
class CompanionClient:
    """Client of the companion: one peer of one transport.

    `defaults` are the message intervals [us] that the client gets unasked, by message id; `heard` is the time of its
    last frame [s]. `on_board`: the client is a program of the drone itself. `stays`: the client is a default address,
    which gets messages even if it never sends any.
    """

    transport: Transport
    peer: Hashable
    defaults: Mapping[int, int]
    heard: float
    stays: bool = False
    on_board: bool = False
    identities: set[Identity] = field(default_factory=set)
    requests: dict[int, StreamRequest] = field(default_factory=dict)
    due_once: set[int] = field(default_factory=set)
    """Messages that were requested once by command 512."""
    knows_ours: bool = False
    """Whether it has shown that it knows twodof's own messages; to other clients they would count as losses."""
    _slots: dict[int, int] = field(default_factory=dict)
    _sequences: dict[Identity, int] = field(default_factory=dict)

    def forget(self) -> None:
        """Forget a client that fell silent; the next one at this address may be another."""
        self.identities.clear()
        self.requests.clear()
        self.due_once.clear()
        self.knows_ours = False

    def set(self, message_id: int, request: StreamRequest | None) -> bool:
        """Store the client's request for a message, None for the default. Return False if the client has too many."""
        if request is None:
            self.requests.pop(message_id, None)
        elif message_id in self.requests or len(self.requests) < MOST_REQUESTS:
            self.requests[message_id] = request
        else:
            return False
        return True

    def interval(self, message_id: int, default: int = OFF) -> int:
        """Return the interval [us] at which the client wants a message: that of its request, `defaults`, `default`."""
        asked = self.requests.get(message_id)
        if asked is not None:
            return asked.interval
        if is_ours(message_id) and not self.knows_ours:
            return OFF
        return self.defaults.get(message_id, default)

    def wants(self, frame: Frame, vehicle_interval: int, default: int) -> bool:
        """Return whether the client gets this frame of a message that the vehicle sends at `vehicle_interval` [us].

        A message that comes too fast is thinned by the time stamp in it, never by this computer's clock. The same
        flight then gives the same messages in lockstep and in real time. Messages without a time are not thinned.
        """
        number = frame.message_id
        if number in self.due_once:
            self.due_once.discard(number)
            return True
        interval = self.interval(number, default)
        if interval <= max(vehicle_interval, EVERY):
            return interval != OFF
        time = time_us(frame)
        if time < 0:
            return True
        slot = time // interval
        due = self._slots.get(number) != slot
        self._slots[number] = slot
        return due

    def deliver(self, frame: Frame, lost: int = 0) -> None:
        """Send a frame under the client's own numbering: thinned frames do not count as lost, only `lost` frames do."""
        self.write(renumbered(frame, self.number((frame.system, frame.component), lost)))

    def number(self, identity: Identity, lost: int = 0) -> int:
        """Return the sequence number of the next frame from `identity` to this client, after `lost` lost frames."""
        number = self._sequences.pop(identity, 0)
        self._sequences[identity] = number + 1
        if len(self._sequences) > MOST_SENDERS:
            del self._sequences[next(iter(self._sequences))]
        return (number + lost) & 0xFF

    def write(self, raw: bytes) -> None:
        """Send bytes to the client. The transport drops and counts them if the client does not read."""
        try:  # noqa: SIM105 (`suppress` takes half a microsecond, for each frame and client)
            self.transport.send(raw, self.peer)
        except LinkLost:
            pass


def union(clients: Sequence[CompanionClient], number: int) -> StreamRequest:
    """Return the request that serves all clients: the shortest interval, and of a batch all channels."""
    if number == BATCH:
        asked = (client.requests.get(BATCH) for client in clients)
        requests = [request for request in asked if request is not None and request.interval > EVERY]
        mask = reduce(or_, (request.mask for request in requests), 0)
        every = math.gcd(*(min(max(round(request.interval / TICK_US), 1), MOST_EVERY) for request in requests))
        return StreamRequest(every * TICK_US, mask) if mask else StreamRequest(OFF)
    intervals = [client.interval(number) for client in clients]
    timed_ones = [one for one in intervals if one > EVERY]
    return StreamRequest(min(timed_ones, default=EVERY if EVERY in intervals else OFF))


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
