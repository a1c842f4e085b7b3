"""The rules by which frames pass between the vehicle and the clients, without sockets and without a clock of its own.

All incoming frames are complete, and their checksums are right.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from twodof.companion import frame_fields
from twodof.companion.client import (
    EVERY,
    MOST_IDENTITIES,
    OFF,
    SILENT_S,
    CompanionClient,
    Identity,
    StreamRequest,
    group,
    is_ours,
    stream_request,
    streamed,
    timed,
    union,
    whole,
)
from twodof.companion.frame_fields import CommandFields
from twodof.companion.uplink_queue import UplinkQueue
from twodof.link.mavlink.dialect import AUTOPILOT, COMPANION, MavResult
from twodof.link.mavlink.framing import Frame, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Signing

MOST_BEHIND = 32
"""Identities behind the line that are remembered."""
BEHIND_S = 10.0
"""For so long after its last frame an identity behind the line is taken, so that no client can use it."""
MOST_PASSED, MOST_ROUNDS, ROUND_S = 256, 2, 0.5
"""Frames that are recognised again, how often one may come from other clients, and for how long [s]."""
_UNPLACED = "unplaced"  # the queue of senders without a place among the clients
_HALF = 128  # of the range of a sequence number: more than that ahead is behind
_ABOUT_MESSAGES = (frame_fields.SET_MESSAGE_INTERVAL, frame_fields.GET_MESSAGE_INTERVAL, frame_fields.REQUEST_MESSAGE)


@dataclass(slots=True)
class _Behind:
    """An identity behind the line: its last sequence number, when it spoke [s], and its frames that were lost."""

    sequence: int
    heard: float
    lost: int = 0


class Router:
    """Routes frames for the vehicle `system`. `clock` gives seconds.

    `signing` signs messages in the companion's own name; all incoming frames then carry a signature by the same key.
    `handle_own` takes frames for the companion itself, each with its client, None for the vehicle.
    """

    def __init__(
        self, system: int, line: UplinkQueue, clock: Callable[[], float], signing: Signing | None = None
    ) -> None:
        self.system = system
        self.line = line
        self.clock = clock
        self.signing = signing
        self.clients: list[CompanionClient] = []
        """The connected clients."""
        self.asked: dict[int, StreamRequest] = {}
        """The request for each message that was last sent to the vehicle, by message id."""
        self.handle_own: Callable[[Frame, CompanionClient | None], None] = lambda frame, client: None
        self.killed = False
        """Whether the vehicle said that it was killed, and not yet that it was released."""
        self.pilot: Identity | None = None
        """Holder of the lease, as the vehicle said last."""
        self._behind: dict[Identity, _Behind] = {}
        # Frames of clients: the first sender, when it sent it first [s], and how often others sent it since.
        self._passed: dict[bytes, tuple[CompanionClient, float, int]] = {}
        self._sequence = 0
        self._start = 0  # number of the start of the vehicle's program

    def add(self, client: CompanionClient) -> None:
        """Add a client and have the vehicle stream what it wants."""
        self.clients.append(client)
        self.refresh()

    def remove(self, client: CompanionClient) -> None:
        """Remove a client and its streams."""
        self.clients.remove(client)
        self.refresh()

    def forget(self, client: CompanionClient) -> None:
        """Forget a default address that fell silent; it keeps its place."""
        client.forget()
        self.refresh()

    def started(self) -> None:
        """Request all streams again from a vehicle that has reconnected or restarted."""
        self.asked.clear()
        self.refresh()

    def refresh(self) -> None:
        """Request the streams that have changed from the vehicle."""
        before = dict(self.asked)
        for number in sorted(timed().union(before, *(client.requests for client in self.clients))):
            request = self._announce(number)
            if request != before.get(number):
                self._to_vehicle(message("COMMAND_LONG", **self._interval_fields(number, request)))

    def _announce(self, number: int) -> StreamRequest:
        """Return the union of requests for a message and count it as sent; forget an unused message."""
        request = union(self.clients, number)
        self.asked[number] = request
        if request.interval == OFF and number not in timed():
            del self.asked[number]
        return request

    def receivers(self, frame: Frame) -> Sequence[CompanionClient]:
        """Return the clients that get a message of the vehicle without an addressee."""
        number = frame.message_id
        default = OFF if number in streamed() else EVERY
        asked = self.asked.get(number)
        interval = OFF if asked is None else asked.interval
        return [client for client in self.clients if client.wants(frame, interval, default)]

    def clients_with(self, system: int, component: int) -> list[CompanionClient]:
        """Return the clients with this system and component or, if none has it, with this system.

        In the drone's own system only the exact component counts, as the others are behind the line.
        """
        exact = [client for client in self.clients if (system, component) in client.identities]
        if exact or (system == self.system and component):
            return exact
        return [client for client in self.clients if any(one[0] == system for one in client.identities)]

    def from_client(self, client: CompanionClient, frame: Frame) -> None:
        """Route a frame that a client sent."""
        now = self.clock()
        if not self._may_say(frame, client.on_board):
            return
        self._meet(client, (frame.system, frame.component), now)
        if self._came_round(client, frame, now):
            return
        system, component = frame_fields.target(frame)
        asked = frame_fields.command(frame)
        if not client.knows_ours and _knows_ours(frame, asked):
            client.knows_ours = True
            self.refresh()
        if (system, component) == (self.system, COMPANION):
            self.handle_own(frame, client)
            return
        raw: bytes | None = frame.raw
        to_vehicle = system in (0, self.system) and component in (0, AUTOPILOT)
        if asked is not None and asked.command in _ABOUT_MESSAGES and to_vehicle:
            raw = self._about_message(client, frame, asked)
        elif frame.message_id == frame_fields.REQUEST_DATA_STREAM and system in (0, self.system):
            self._set_group(client, decode(frame))
            return
        if system:
            others = [one for one in self.clients_with(system, component) if one is not client]
            for other in others:
                self._deliver(other, frame)
            if others and (system != self.system or component):
                return
        elif frame.system == self.system:  # a program on board speaks to all clients
            for other in self.clients:
                if other is not client:
                    self._deliver(other, frame)
        if raw is not None:
            self.line.offer(client, raw, now, frame_fields.stop(asked) if asked is not None else None)

    def from_unplaced(self, frame: Frame) -> None:
        """Pass a kill or a disarm of a sender without a place among the clients; drop all else."""
        asked = frame_fields.command(frame)
        urgent = frame_fields.stop(asked) if asked is not None else None
        if asked is not None and urgent is not None and asked.system in (0, self.system) and self._may_say(frame):
            self.line.offer(_UNPLACED, frame.raw, self.clock(), urgent)

    def from_vehicle(self, frame: Frame) -> None:
        """Route a frame that came over the line."""
        system, component = frame_fields.target(frame)
        identity = (frame.system, frame.component)
        autopilot = identity == (self.system, AUTOPILOT)
        of_client = not system and any(identity in client.identities for client in self.clients)
        if identity == (self.system, COMPANION) or (of_client and not autopilot):
            return
        self._account(frame, identity)
        if autopilot and frame.message_id in (frame_fields.HEARTBEAT, frame_fields.LEASE, frame_fields.RIG):
            self._learn(decode(frame))
        if system:
            if system == self.system and component in (0, COMPANION):
                self.handle_own(frame, None)
                if component:
                    return
            receivers: Sequence[CompanionClient] = self.clients_with(system, component)
        else:
            receivers = self.receivers(frame)
        for client in receivers:
            self._deliver(client, frame)

    def tell(self, sent: Any, vehicle: bool = True, clients: bool = True) -> None:
        """Send a message in the companion's own name."""
        if clients:
            for client in self.clients:
                self.answer(client, sent)
        if vehicle:
            self._to_vehicle(sent)

    def answer(self, client: CompanionClient, sent: Any, component: int = COMPANION) -> None:
        """Send a message to one client as the companion, or in the name of another `component` of the drone."""
        identity = (self.system, component)
        client.write(self.encoded(sent, component, client.number(identity, self._lost(identity))))

    def encoded(self, sent: Any, component: int = COMPANION, sequence: int = 0, system: int | None = None) -> bytes:
        """Encode a message of the drone's system, or of another, signed if there is a key."""
        signing = (self.signing.outgoing(),) if self.signing is not None else ()
        return encode(sent, self.system if system is None else system, component, sequence, *signing)

    def _meet(self, client: CompanionClient, identity: Identity, now: float) -> None:
        """Note the identity of a client. It gets what this identity asked for from another address before."""
        client.heard = now
        if identity in client.identities:
            return
        if len(client.identities) < MOST_IDENTITIES:
            client.identities.add(identity)
        for before in self.clients:
            moved = before is not client and before.transport is client.transport and identity in before.identities
            if moved and now - before.heard < SILENT_S:
                client.requests = before.requests | client.requests
                client.knows_ours |= before.knows_ours

    def _came_round(self, client: CompanionClient, frame: Frame, now: float) -> bool:
        """Return whether a frame came from one client and then again and again from others.

        Links then make a circle, in which it would go for ever. Its first sender may repeat it without limit.
        """
        first, since, rounds = self._passed.pop(frame.raw, (client, now, 0))
        if now - since > ROUND_S:
            first, since, rounds = client, now, 0
        rounds += first is not client
        self._passed[frame.raw] = (first, since, rounds)
        if len(self._passed) > MOST_PASSED:
            del self._passed[next(iter(self._passed))]
        return first is not client and rounds > MOST_ROUNDS

    def _may_say(self, frame: Frame, on_board: bool = False) -> bool:
        """Return whether a client may use the identity of a frame.

        The drone's own system belongs to the line and to programs `on_board`; otherwise the ATTITUDE of any client
        would look like the drone's to all others.
        """
        if frame.system == self.system:
            return on_board and frame.component not in (AUTOPILOT, COMPANION) and not self._on_line(frame)
        return bool(frame.system) and not self._on_line(frame)

    def _on_line(self, frame: Frame) -> bool:
        """Return whether the identity of a frame was heard on the line lately."""
        there = self._behind.get((frame.system, frame.component))
        return there is not None and self.clock() - there.heard < BEHIND_S

    def _about_message(self, client: CompanionClient, frame: Frame, asked: CommandFields) -> bytes | None:
        """Note what a client wants by command 510, 511 or 512; return the frame for the vehicle, None if denied.

        The vehicle is asked for the union of all requests. Its answer goes to the client, whose numbers the frame
        keeps. A frame that was signed with a key that is not here stays as it is.
        """
        number = whole(asked.params[0])
        sets = asked.command == frame_fields.SET_MESSAGE_INTERVAL
        request = stream_request(number, asked) if sets else None
        of_truth = client.on_board and number == frame_fields.TRUTH  # nothing on board knows the truth
        if of_truth or (sets and not client.set(number, request)):
            result = MavResult.DENIED if of_truth else MavResult.TEMPORARILY_REJECTED
            to = {"target_system": frame.system, "target_component": frame.component}
            self.answer(client, message("COMMAND_ACK", command=asked.command, result=result, **to), AUTOPILOT)
            return None
        if asked.command == frame_fields.REQUEST_MESSAGE and number in frame_fields.places():
            client.due_once.add(number)
        if not sets:
            return frame.raw
        shared = self._announce(number)
        if shared == request or (frame.signed and self.signing is None):
            return frame.raw
        sent: Any = decode(frame)
        for name, value in self._interval_fields(number, shared).items():
            if name.startswith("param"):
                setattr(sent, name, value)
        return self.encoded(sent, frame.component, frame.sequence, frame.system)

    def _interval_fields(self, number: int, request: StreamRequest) -> dict[str, float]:
        """Return the fields of command 511 for a request."""
        fields = {
            "param1": number,
            "param2": request.interval,
            "param3": request.mask & 0xFFFF,
            "param4": request.mask >> 16,
        }
        to = {"target_system": self.system, "target_component": AUTOPILOT}
        return {"command": frame_fields.SET_MESSAGE_INTERVAL, **to, **fields}

    def _set_group(self, client: CompanionClient, got: Any) -> None:
        """Set the rates of a group by REQUEST_DATA_STREAM, as clients of ArduPilot ask for them; it has no answer."""
        if got.start_stop and not got.req_message_rate:
            return
        chosen = group(got.req_stream_id)
        interval = round(1e6 / got.req_message_rate) if got.start_stop else -1
        for number, default in client.defaults.items():
            if default > 0 and (chosen is None or number in chosen):
                client.set(number, StreamRequest(interval))
        self.refresh()

    def _account(self, frame: Frame, identity: Identity) -> None:
        """Note an identity behind the line, and how many of its frames were lost on the way."""
        there = self._behind.get(identity)
        if there is None:
            if len(self._behind) < MOST_BEHIND:
                self._behind[identity] = _Behind(frame.sequence, self.clock())
            return
        missing = (frame.sequence - there.sequence - 1) % 256
        there.lost += missing if missing < _HALF else 0
        there.sequence, there.heard = frame.sequence, self.clock()

    def _learn(self, got: Any) -> None:
        """Read the state of the drone from its HEARTBEAT, TWODOF_LEASE or TWODOF_RIG."""
        if got.get_type() == "HEARTBEAT":
            self.killed = got.system_status == frame_fields.TERMINATED
        elif got.get_type() == "TWODOF_LEASE":
            self.pilot = (got.holder_system, got.holder_component) if got.holder_system else None
        elif got.start:
            before, self._start = self._start, got.start
            if before not in (0, got.start):
                self.started()

    def _lost(self, identity: Identity) -> int:
        there = self._behind.get(identity)
        return 0 if there is None else there.lost

    def _deliver(self, client: CompanionClient, frame: Frame) -> None:
        client.deliver(frame, self._lost((frame.system, frame.component)))

    def _to_vehicle(self, sent: Any) -> None:
        raw = self.encoded(sent, sequence=self._sequence)
        if self.line.offer(self, raw, self.clock(), stale_s=inf):
            self._sequence = (self._sequence + 1) & 0xFF


def _knows_ours(frame: Frame, asked: CommandFields | None) -> bool:
    """Return whether a frame shows that its sender knows twodof's own messages: it is one, or asks for one."""
    about = asked is not None and asked.command in _ABOUT_MESSAGES and is_ours(whole(asked.params[0]))
    return about or is_ours(frame.message_id)
