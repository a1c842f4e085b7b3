"""The rules by which frames pass between the vehicle and the clients: each to whom it concerns, nothing to the others.

Pure of sockets and of clocks but the one it is given. What arrives are whole frames whose checksum held.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from twodof.companion import frame_fields
from twodof.companion.client import SILENT_S, CompanionClient, Identity, Wish
from twodof.companion.reply_routing import ReplyRouting
from twodof.companion.streams.batch_repacking import BatchRepacker
from twodof.companion.streams.stream_thinning import ClientStreams
from twodof.companion.streams.subscriptions import Subscriptions
from twodof.companion.uplink_queue import UplinkQueue
from twodof.link.mavlink.enums import AUTOPILOT, COMPANION
from twodof.link.mavlink.framing import Frame, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Signing

MOST_IDENTITIES = 32
# Who has spoken from a new address for so long, and not from its old one, has moved: it beats once a second.
MOVED_S = 2.0
# Who is behind the line with a system of its own is believed to be there for so long after it spoke.
BESIDE_S = 10.0
# Frames that are known again, and for how long: a circle of links is passed in less, a program is not started anew.
MOST_PASSED, MOST_ROUNDS, ROUND_S = 256, 2, 0.5
_NOW_AND_THEN = 15
LATE_US = 500_000  # A frame that is older than the last one by less was late on the line: nothing has started anew.
_STRANGERS = "strangers"  # who on the line has no place among the clients
_HALF = 128  # of the range of a sequence number: what is further ahead is behind


@dataclass(slots=True)
class RouterCounts:
    """Frames of the vehicle, frames that ended here, by cause, and starts of the vehicle anew."""

    from_vehicle: int = 0
    nobody: int = 0
    impostors: int = 0
    echoes: int = 0
    restarts: int = 0


class Router:
    """Passes frames on for the vehicle `system`. `clock` gives seconds; `signing` signs what is sent in our own
    name; with it everything that arrives was signed with its key.

    `own` takes the frames that are for the companion itself: called with the client it came from, None for the vehicle.
    """

    def __init__(
        self, system: int, line: UplinkQueue, clock: Callable[[], float], signing: Signing | None = None
    ) -> None:
        self.system = system
        self.line = line
        self.streams = ClientStreams()
        self.answers = ReplyRouting()
        self.batches = BatchRepacker(self._as_vehicle, self._deliver)
        wires = (self._ask, self._as_vehicle, clock, signing is not None)
        self.subscriptions = Subscriptions(self.streams, self.batches, self.answers, *wires)
        self.counts = RouterCounts()
        self.own: Callable[[Frame, CompanionClient | None], None] = lambda frame, client: None
        self.clock = clock
        self.killed = False
        """Whether the vehicle has said that it was killed, and not yet that it was released."""
        self.pilot: Identity | None = None
        """Who has the lease, as the vehicle said last."""
        self.vehicle: dict[Identity, int] = {(system, AUTOPILOT): -1}  # who is behind the line -> its last sequence
        self.lost: dict[Identity, int] = {}
        self.signing = signing
        self._sequence = 0
        self._time = -1
        self._beside: dict[Identity, float] = {}  # of these who is of another system -> when last heard
        self._passed: dict[
            bytes, tuple[CompanionClient, float, int]
        ] = {}  # frames of clients: from whom and when first, how often since
        self._jumped = False  # its sequence had a gap since its time was last seen to go on

    @property
    def clients(self) -> list[CompanionClient]:
        """Those that are there."""
        return self.streams.clients

    def add(self, client: CompanionClient) -> None:
        """A client has come: from now on it gets what it wants."""
        self.clients.append(client)
        self.subscriptions.refresh()

    def remove(self, client: CompanionClient) -> None:
        """A client has gone: nobody asks the vehicle in its name any more."""
        self.clients.remove(client)
        self.answers.forget(client)
        self.batches.forget(client)
        self.subscriptions.refresh()

    def follow(self, now: float) -> None:
        """See which clients have moved to another address: another network, or a router that gave another port.

        What such a client had asked for moves with it, once its old address has been silent for MOVED_S.
        """
        for client in self.clients:
            if not client.identities or not MOVED_S < now - client.came < SILENT_S:
                continue
            for before in self.clients:
                same = before.transport is client.transport and before.identities.keys() & client.identities.keys()
                if same and before.wishes and before.heard < client.came:
                    client.follow(before)
                    before.forget()
                    self.subscriptions.refresh()
                    break

    def forget(self, client: CompanionClient) -> None:
        """A client whose place stays has fallen silent."""
        client.forget()
        self.subscriptions.refresh()

    def started(self) -> None:
        """The link to the vehicle stands anew: it is told again what to stream."""
        self._time = -1
        self.subscriptions.restart()

    def behind(self, system: int, component: int) -> list[CompanionClient]:
        """The clients behind which this system and component is, or, if that one is unknown, its system.

        Of our own system only the very component, as the vehicle's others are behind the line.
        """
        exact = [client for client in self.clients if (system, component) in client.identities]
        if exact or (system == self.system and component):
            return exact
        return [client for client in self.clients if any(one[0] == system for one in client.identities)]

    def behind_client(self, identity: Identity) -> bool:
        """Whether this very component has spoken through a client."""
        return any(identity in client.identities for client in self.clients)

    def from_client(self, client: CompanionClient, frame: Frame) -> None:
        """A frame that a client sent."""
        now = self.clock()
        identity = (frame.system, frame.component)
        if not self._may_say(frame, client.on_board):
            self.counts.impostors += 1
            return
        client.known_as(identity, now)
        if self._came_round(client, frame, now):
            self.counts.echoes += 1
            return
        system, component = frame_fields.target(frame)
        urgent = None
        asked = frame_fields.command(frame)
        if not client.knows_ours:
            self.subscriptions.notice(client, frame, asked)
        if (system, component) == (self.system, COMPANION):
            self.own(frame, client)
            return
        if asked is not None:
            urgent = frame_fields.stop(asked)
            to_vehicle = system in (0, self.system) and component in (0, AUTOPILOT)
            if to_vehicle and self.subscriptions.take(client, frame, asked, on_board=frame.system == self.system):
                return
        elif frame.message_id == frame_fields.REQUEST_DATA_STREAM and system in (0, self.system):
            self.subscriptions.take_group(client, frame)
            return
        if system:
            others = [one for one in self.behind(system, component) if one is not client]
            for other in others:
                self._deliver(other, frame)
            if others and (system != self.system or component):
                return
        elif frame.system == self.system:  # a program on board speaks to everybody
            for other in self.clients:
                if other is not client:
                    self._deliver(other, frame)
        self.answers.asked(client, frame, now)
        self.line.offer(client, frame.raw, now, urgent)

    def from_stranger(self, frame: Frame) -> None:
        """A frame of a sender that found no place among the clients: only what stops motors passes."""
        asked = frame_fields.command(frame)
        urgent = frame_fields.stop(asked) if asked is not None else None
        if asked is not None and urgent is not None and asked.system in (0, self.system) and self._may_say(frame):
            self.line.offer(_STRANGERS, frame.raw, self.clock(), urgent)

    def from_vehicle(self, frame: Frame) -> None:
        """A frame that came over the line."""
        self.counts.from_vehicle += 1
        system, component = frame_fields.target(frame)
        identity = (frame.system, frame.component)
        autopilot = identity == (self.system, AUTOPILOT)
        came_back = not autopilot and not system and self.behind_client(identity)
        if came_back or identity == (self.system, COMPANION):  # what a client or we have said
            self.counts.echoes += 1
            return
        self._account(frame)
        if frame.message_id == frame_fields.BATCH:
            self.batches.take(frame, self.clients, not frame.signed or self.signing is not None)
            return
        if autopilot and frame.message_id in (frame_fields.HEARTBEAT, frame_fields.LEASE):
            self._learn(decode(frame))
        if frame.message_id == frame_fields.TICK:
            self.batches.flush_all()
        if system:
            if system == self.system and component in (0, COMPANION):
                self._for_us(frame)
                if component:
                    return
            receivers: Sequence[CompanionClient] = self.behind(system, component)
            if not receivers:
                self.counts.nobody += 1
        else:
            receivers = self.answers.receivers(frame, self.clock()) or self.streams.receivers(frame)
        for client in receivers:
            self._deliver(client, frame)

    def _learn(self, got: Any) -> None:
        """A HEARTBEAT or TWODOF_LEASE of the vehicle's."""
        if got.get_type() == "HEARTBEAT":
            self.killed = got.system_status == frame_fields.TERMINATED
        else:
            self.pilot = (got.holder_system, got.holder_component) if got.holder_system else None

    def tell(self, sent: Any, vehicle: bool = True, clients: bool = True) -> None:
        """Say something in the companion's own name."""
        if clients:
            for client in self.clients:
                self.answer(client, sent)
        if vehicle:
            self._to_vehicle(sent)

    def answer(self, client: CompanionClient, sent: Any) -> None:
        """Say something to one client in the companion's own name."""
        client.write(self._encoded(sent, COMPANION, client.number((self.system, COMPANION))))

    def said(self, sent: Any) -> bytes:
        """A message of the companion for a peer that is not a client."""
        return self._encoded(sent, COMPANION, 0)

    def _came_round(self, client: CompanionClient, frame: Frame, now: float) -> bool:
        """Whether this very frame came from one client and then again and again from others.

        Then links make a circle, in which it would go for ever. Its first sender may repeat it as often as it likes.
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
        """Whether it may come from a client. No client speaks for the vehicle or for us.

        Only a program that is `on_board` speaks with the drone's own system. Otherwise anybody's ATTITUDE would look
        like the drone's to all others.
        """
        identity = (frame.system, frame.component)
        if frame.system == self.system:
            return on_board and identity not in self.vehicle and frame.component != COMPANION
        beside = self.clock() - self._beside.get(identity, -BESIDE_S) < BESIDE_S
        return not beside and bool(frame.system)

    def _deliver(self, client: CompanionClient, frame: Frame) -> None:
        client.deliver(frame, self.lost.get((frame.system, frame.component), 0))

    def _account(self, frame: Frame) -> None:
        """Note who is behind the line, what was lost on the way, and whether the vehicle has started anew."""
        identity = (frame.system, frame.component)
        last = self.vehicle.get(identity)
        if frame.system != self.system and last is not None:
            self._beside[identity] = self.clock()
        if last is None:
            if len(self.vehicle) >= MOST_IDENTITIES or self.behind_client(identity):
                return
            last = -1
            if frame.system != self.system:
                self._beside[identity] = self.clock()
        ahead = (frame.sequence - last - 1) % 256 if last >= 0 else 0
        self.vehicle[identity] = frame.sequence
        if 0 < ahead < _HALF:
            self.lost[identity] = self.lost.get(identity, 0) + ahead
        if identity != (self.system, AUTOPILOT):
            return
        self._jumped = self._jumped or ahead > 0
        if not self._jumped and frame.sequence & _NOW_AND_THEN:
            return
        time = frame_fields.time_us(frame)
        if time >= 0:
            if self._jumped and 0 < self._time - time < LATE_US:
                return
            # Time alone goes back in a reset of the rig too, which leaves the streams as they are.
            started, self._time, self._jumped = self._jumped and time < self._time, time, False
            if started:
                self.counts.restarts += 1
                self.started()

    def _encoded(self, sent: Any, component: int, sequence: int) -> bytes:
        signing = (self.signing.outgoing(),) if self.signing is not None else ()
        return encode(sent, self.system, component, sequence, *signing)

    def _to_vehicle(self, sent: Any) -> None:
        raw = self._encoded(sent, COMPANION, self._sequence)
        if self.line.offer(self, raw, self.clock()):
            self._sequence = (self._sequence + 1) & 0xFF

    def _ask(self, message_id: int, wish: Wish) -> None:
        fields = {"param1": message_id, "param2": wish.interval, "param3": wish.mask & 0xFFFF}
        fields |= {"param4": wish.mask >> 16, "command": frame_fields.SET_MESSAGE_INTERVAL}
        self._to_vehicle(message("COMMAND_LONG", target_system=self.system, target_component=AUTOPILOT, **fields))

    def _as_vehicle(self, client: CompanionClient, sent: Any) -> None:
        """Answer in the vehicle's name: it is whom the client asked."""
        identity = (self.system, AUTOPILOT)
        client.write(self._encoded(sent, AUTOPILOT, client.number(identity, self.lost.get(identity, 0))))

    def _for_us(self, frame: Frame) -> None:
        if frame.message_id == frame_fields.COMMAND_ACK:
            got: Any = decode(frame)
            if got.command == frame_fields.SET_MESSAGE_INTERVAL:
                self.subscriptions.asking.answered(got.result, self.clock())
            return
        self.own(frame, None)
