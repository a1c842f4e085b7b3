"""The rules by which frames pass between the vehicle and the clients: each to whom it concerns, nothing to the others.

Pure of sockets and of clocks but the one it is given. What arrives are whole frames whose checksum held.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from twodof.fcc import wire
from twodof.fcc.answers import Answers
from twodof.fcc.asking import Asking
from twodof.fcc.batches import TICK_US, Batches
from twodof.fcc.client import Client, Identity, Wish, is_ours
from twodof.fcc.line import Line
from twodof.fcc.rates import EVERY, OFF, group
from twodof.fcc.streams import Streams, events, settled
from twodof.link.framing import Frame, encode
from twodof.link.messages import BATCH_VALUES, message
from twodof.link.signing import Signing, Verdict

AUTOPILOT, COMPANION = 1, 191
_ABOUT_MESSAGES = (wire.SET_MESSAGE_INTERVAL, wire.GET_MESSAGE_INTERVAL, wire.REQUEST_MESSAGE)
DENIED, TEMPORARILY_REJECTED = 2, 1
MOST_IDENTITIES = 32
_NOW_AND_THEN = 15
_HALF = 128  # of the range of a sequence number: what is further ahead is behind


@dataclass(slots=True)
class RouterCounts:
    """Frames that ended here, by cause, and frames of the vehicle that were lost on the way to us."""

    from_vehicle: int = 0
    from_clients: int = 0
    nobody: int = 0
    impostors: int = 0
    lost: int = 0
    restarts: int = 0


class Router:
    """Passes frames on for the vehicle `system`. `clock` gives seconds; `signing` signs what is sent in our own name.

    `own` takes the frames that are for the companion itself: called with the client it came from, None for the vehicle.
    """

    def __init__(self, system: int, line: Line, clock: Callable[[], float], signing: Signing | None = None) -> None:
        self.system = system
        self.line = line
        self.streams = Streams()
        self.asking = Asking(self._ask, self._settled)
        self.answers = Answers()
        self.batches = Batches(self._as_vehicle, self._deliver)
        self.counts = RouterCounts()
        self.own: Callable[[Frame, Client | None], None] = lambda frame, client: None
        self.clock = clock
        self.vehicle: dict[Identity, int] = {(system, AUTOPILOT): -1}  # who is behind the line -> its last sequence
        self.lost: dict[Identity, int] = {}
        self._signing = signing
        self._sequence = 0
        self._time = -1
        self._jumped = False  # its sequence had a gap since its time was last seen to go on

    @property
    def clients(self) -> list[Client]:
        """Those that are there."""
        return self.streams.clients

    def add(self, client: Client) -> None:
        """A client has come: from now on it gets what it wants."""
        self.clients.append(client)
        self._refresh()

    def remove(self, client: Client) -> None:
        """A client has gone: nobody asks the vehicle in its name any more."""
        self.clients.remove(client)
        self.answers.forget(client)
        self.batches.forget(client)
        self._refresh()

    def forget(self, client: Client) -> None:
        """A client whose place stays has fallen silent."""
        client.forget()
        self._refresh()

    def started(self) -> None:
        """The link to the vehicle stands anew: it is told again what to stream."""
        self.asking.restart()
        self.streams.at.clear()
        self._time = -1
        self._refresh()

    def behind(self, system: int, component: int) -> list[Client]:
        """The clients behind which this system and component is, or, if that one is unknown, its system.

        Of our own system only the very component, as the vehicle's others are behind the line.
        """
        exact = [client for client in self.clients if (system, component) in client.identities]
        if exact or (system == self.system and component):
            return exact
        return [client for client in self.clients if any(one[0] == system for one in client.identities)]

    def from_client(self, client: Client, frame: Frame) -> None:
        """A frame that a client sent."""
        now = self.clock()
        self.counts.from_clients += 1
        client.counts.received += 1
        identity = (frame.system, frame.component)
        if identity in self.vehicle or identity == (self.system, COMPANION) or not frame.system:
            client.counts.impostors += 1
            self.counts.impostors += 1
            return
        client.known_as(identity, now)
        system, component = wire.target(frame)
        urgent = None
        asked = wire.command(frame)
        if not client.knows_ours and (is_ours(frame.message_id) or (asked is not None and _asks_ours(asked))):
            client.knows_ours = True
            self._refresh()
        if (system, component) == (self.system, COMPANION):
            self.own(frame, client)
            return
        if asked is not None:
            urgent = wire.stop(asked)
            if system in (0, self.system) and component in (0, AUTOPILOT) and self._intercepts(client, frame, asked):
                return
        elif frame.message_id == wire.REQUEST_DATA_STREAM and system in (0, self.system):
            self._stream_group(client, frame)
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
        if not self.line.offer(client, frame.raw, now, urgent):
            client.counts.crowded_out += 1

    def from_vehicle(self, frame: Frame) -> None:
        """A frame that came over the line."""
        self.counts.from_vehicle += 1
        self._account(frame)
        if frame.message_id == wire.BATCH:
            self.batches.take(frame, self.clients, not frame.signed or self._signing is not None)
            return
        if frame.message_id == wire.TICK:
            self.batches.flush_all()
        system, component = wire.target(frame)
        if system:
            if system == self.system and component in (0, COMPANION):
                self._for_us(frame)
                if component:
                    return
            receivers: Sequence[Client] = self.behind(system, component)
            if not receivers:
                self.counts.nobody += 1
        else:
            receivers = self.answers.receivers(frame, self.clock()) or self.streams.receivers(frame)
        for client in receivers:
            self._deliver(client, frame)

    def tell(self, sent: Any, vehicle: bool = True, clients: bool = True) -> None:
        """Say something in the companion's own name."""
        identity = (self.system, COMPANION)
        if clients:
            for client in self.clients:
                client.write(self._encoded(sent, COMPANION, client.number(identity)))
        if vehicle:
            self._to_vehicle(sent)

    def answer(self, client: Client, sent: Any) -> None:
        """Say something to one client in the companion's own name."""
        client.write(self._encoded(sent, COMPANION, client.number((self.system, COMPANION))))

    def _deliver(self, client: Client, frame: Frame) -> None:
        client.deliver(frame, self.lost.get((frame.system, frame.component), 0))

    def _account(self, frame: Frame) -> None:
        """Note who is behind the line, what was lost on the way, and whether the vehicle has started anew."""
        identity = (frame.system, frame.component)
        last = self.vehicle.get(identity)
        if last is None:
            if len(self.vehicle) >= MOST_IDENTITIES or any(identity in one.identities for one in self.clients):
                return
            last = -1
        ahead = (frame.sequence - last - 1) % 256 if last >= 0 else 0
        self.vehicle[identity] = frame.sequence
        if 0 < ahead < _HALF:
            self.lost[identity] = self.lost.get(identity, 0) + ahead
            self.counts.lost += ahead
        if identity != (self.system, AUTOPILOT):
            return
        self._jumped = self._jumped or ahead > 0
        if not self._jumped and frame.sequence & _NOW_AND_THEN:
            return
        time = wire.time_us(frame)
        if time >= 0:
            # Time alone goes back in a reset of the rig too, which leaves the streams as they are.
            started, self._time, self._jumped = self._jumped and time < self._time, time, False
            if started:
                self.counts.restarts += 1
                self.started()

    def _encoded(self, sent: Any, component: int, sequence: int) -> bytes:
        signing = (self._signing.outgoing(),) if self._signing is not None else ()
        return encode(sent, self.system, component, sequence, *signing)

    def _to_vehicle(self, sent: Any) -> None:
        raw = self._encoded(sent, COMPANION, self._sequence)
        if self.line.offer(self, raw, self.clock()):
            self._sequence = (self._sequence + 1) & 0xFF

    # Streams.

    def _ask(self, message_id: int, wish: Wish) -> None:
        fields = {"param1": message_id, "param2": wish.interval, "param3": wish.mask & 0xFFFF}
        fields |= {"param4": wish.mask >> 16, "command": wire.SET_MESSAGE_INTERVAL}
        self._to_vehicle(message("COMMAND_LONG", target_system=self.system, target_component=AUTOPILOT, **fields))

    def _settled(self, message_id: int, wish: Wish) -> None:
        self.streams.at[message_id] = wish.interval

    def _refresh(self) -> None:
        """Ask the vehicle anew for whatever the clients that are there want together."""
        self.streams.changed()
        now = self.clock()
        asked = {number for client in self.clients for number in client.wishes} | set(self.asking.granted)
        for number in sorted(asked.union(settled())):
            self.asking.want(number, self.streams.wanted(number), now)

    def _intercepts(self, client: Client, frame: Frame, asked: wire.Command) -> bool:
        """Whether a command is about what a client gets, which is our affair."""
        if asked.command not in _ABOUT_MESSAGES:
            return False
        number = _whole(asked.params[0])
        source = (frame.system, frame.component)
        if asked.command == wire.REQUEST_MESSAGE:
            if number != wire.MESSAGE_INTERVAL:
                if number in wire.places():
                    client.due_once[number] = 1
                return False
            number = _whole(asked.params[1])
        if not self._ours(frame):
            return False
        if asked.command != wire.SET_MESSAGE_INTERVAL:
            if not self.streams.chosen(number) or client.wish(number) == EVERY:
                self.answers.interval(client, self.clock())
                return False
            self._acknowledge(client, asked.command, source, 0)
            self._as_vehicle(client, message("MESSAGE_INTERVAL", message_id=number, interval_us=client.wish(number)))
            return True
        if number in events() or not isfinite(asked.params[1]):
            self._acknowledge(client, asked.command, source, DENIED)
            return True
        every = round(min(max(asked.params[1], -1.0), 1e9))
        if number == wire.BATCH and every == 0:  # of samples: each tick
            every = TICK_US
        before = client.wishes.get(number)
        mask = max(_whole(asked.params[2]), 0) & 0xFFFF | max(_whole(asked.params[3]), 0) << 16
        wish = None if every == 0 else Wish(every, mask if number == wire.BATCH else 0)
        if number == wire.BATCH:
            self.batches.flush(client)
            if wish is not None and wish.interval != OFF and not 1 <= wish.mask.bit_count() <= BATCH_VALUES:
                self._acknowledge(client, asked.command, source, DENIED)
                return True
        if not self.streams.set(client, number, wish):
            self._acknowledge(client, asked.command, source, TEMPORARILY_REJECTED)
            return True

        def then(result: int) -> None:
            if result and client.wishes.get(number) == wish:
                self.streams.set(client, number, before)
            self._acknowledge(client, asked.command, source, result)

        self.asking.want(number, self.streams.wanted(number), self.clock(), then)
        return True

    def _ours(self, frame: Frame) -> bool:
        """Whether a command on streams is ours to answer: unsigned, or signed with our key."""
        if self._signing is None:
            return not frame.signed
        return self._signing.check(frame) is Verdict.ACCEPTED

    def _acknowledge(self, client: Client, number: int, to: Identity, result: int) -> None:
        there = {"target_system": to[0], "target_component": to[1]}
        self._as_vehicle(client, message("COMMAND_ACK", command=number, result=result, **there))

    def _as_vehicle(self, client: Client, sent: Any) -> None:
        """Answer in the vehicle's name: it is whom the client asked."""
        identity = (self.system, AUTOPILOT)
        client.write(self._encoded(sent, AUTOPILOT, client.number(identity, self.lost.get(identity, 0))))

    def _stream_group(self, client: Client, frame: Frame) -> None:
        rate, _, _, number, start = struct.unpack("<HBBBB", frame.payload.ljust(6, b"\0")[:6])
        chosen = group(number)
        for each, default in client.defaults.items():
            if default > EVERY and each != wire.HEARTBEAT and (chosen is None or each in chosen):
                if not start or rate:
                    self.streams.set(client, each, Wish(round(1e6 / rate)) if start else Wish(OFF))
                    self.asking.want(each, self.streams.wanted(each), self.clock())

    def _for_us(self, frame: Frame) -> None:
        if frame.message_id == wire.COMMAND_ACK:
            number, result = struct.unpack("<HB", frame.payload.ljust(3, b"\0")[:3])
            if number == wire.SET_MESSAGE_INTERVAL:
                self.asking.answered(result, self.clock())
            return
        self.own(frame, None)


def _asks_ours(asked: wire.Command) -> bool:
    """Whether a command is about one of twodof's own messages."""
    return asked.command in _ABOUT_MESSAGES and is_ours(_whole(asked.params[0]))


def _whole(value: float) -> int:
    return round(value) if isfinite(value) and abs(value) < 2**31 else -1
