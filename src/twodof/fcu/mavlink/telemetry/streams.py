"""Streams: each client gets the messages it wants at the rates it wants, exactly, on ticks that depend on nothing else.

A stream is due in the ticks in which the number of its whole intervals since tick 0 rises, each message with an offset
of its own so that those of one rate do not come in one tick. So which tick carries what is the same in every run,
whenever a client came. What several clients get in one tick is encoded once.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from math import isfinite
from typing import Any, Protocol

from twodof.fcu.command.result import ACCEPTED, DENIED, FAILED, UNSUPPORTED, CommandResult
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.addressing import ConnectedClient, whole
from twodof.fcu.mavlink.clients import Clients
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.service import Link
from twodof.fcu.mavlink.telemetry.change_detector import ChangeDetector
from twodof.fcu.mavlink.telemetry.encoders import HEARTBEAT, TelemetryEncoders
from twodof.link.connection import Received
from twodof.link.control_period import TICK_NS
from twodof.link.mavlink.dialect import FIRST_OWN_ID
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.rates import ONBOARD

GET_INTERVAL, SET_INTERVAL = 510, 511
STOPPED, WITH_NEWS = -1, 0
"""Intervals that are none: not sent; sent with each news and at no other time."""
LONGEST_NS = 2**31 * 1000
MOST_OFFSET = 250


def next_due(tick: int, interval_ns: int, offset: int) -> int:
    """The first tick after `tick` in which a stream of that interval [ns] is due."""
    intervals = (tick + offset) * TICK_NS // interval_ns + 1
    return -(-intervals * interval_ns // TICK_NS) - offset


class MessageStream:
    """One message to one client: its interval [ns], the tick in which it is due, the one in which it was sent last."""

    __slots__ = ("due", "interval", "message_id", "peer", "sent")

    def __init__(self, peer: Hashable, message_id: int, interval: int) -> None:
        self.peer = peer
        self.message_id = message_id
        self.interval = interval
        self.due = -1
        self.sent = -1


class OtherSender(Protocol):
    """Who sends a message that is no stream of this kind."""

    def subscribe(self, command: ReceivedCommand) -> CommandResult:
        """Command 511 for it."""

    def interval(self, peer: Hashable) -> int:
        """A client's interval of it [us], -1: none."""


class StreamService:
    """All streams of all clients, and the commands 510 and 511 that read and change a client's own.

    `profile` gives the rates of a client that says nothing (`link.mavlink.rates.PROFILES`); twodof's own messages
    go to those only that know them. A sensor's message is left out where the sensor has given nothing since the last
    one. Messages in `changes` come at each change, too.
    """

    def __init__(
        self,
        link: Link,
        clients: Clients,
        commands: CommandService,
        telemetry: TelemetryEncoders,
        changes: ChangeDetector,
        profile: Mapping[int, float] = ONBOARD,
    ) -> None:
        self._link = link
        self._telemetry = telemetry
        self._changes = changes
        self._profile = profile
        self._streams: dict[Hashable, dict[int, MessageStream]] = {}
        self.elsewhere: dict[int, OtherSender] = {}
        self._calendar: dict[int, list[MessageStream]] = {}
        self._tick = -1
        clients.joined.append(self._join)
        clients.recognised.append(self._recognise)
        clients.left.append(self._leave)
        commands.on(SET_INTERVAL, self._set)
        commands.on(GET_INTERVAL, self._get)

    def handle(self, received: Received) -> bool:
        """Takes REQUEST_DATA_STREAM, which does nothing here as in PX4: its groups of messages are ArduPilot's."""
        return bool(received.message.get_type() == "REQUEST_DATA_STREAM")

    def after(self, step: ControlStep) -> None:
        """Sends what is due."""
        tick = step.tick
        if tick <= self._tick:
            self.restart()
        if tick != self._tick + 1:
            self._plan_all(tick - 1)
        self._tick = tick
        telemetry = self._telemetry
        telemetry.observe(step)
        due = self._calendar.pop(tick, None)
        changed = self._changes.seen(step)
        if due is None and not changed:
            return
        packed: dict[int, Any] = {}
        for number in changed:
            sensor = number in telemetry.news
            for streams in self._streams.values():
                stream = streams.get(number)
                if stream is None or stream.interval == STOPPED or stream.due == tick:
                    continue
                if stream.interval == WITH_NEWS or not sensor:
                    self._send(stream, tick, packed)
        for stream in due or ():
            if stream.due == tick:
                self._send(stream, tick, packed)
                self._plan(stream, tick)

    def restart(self) -> None:
        """Time begins anew at tick 0."""
        self._tick = -1
        self._telemetry.restart()
        for streams in self._streams.values():
            for stream in streams.values():
                stream.sent = -1
        self._plan_all(-1)

    def set(self, peer: Hashable, message_id: int, interval: int | None) -> bool:
        """Sets a client's interval [ns] of a message, None: the profile's. False if there is no such stream."""
        streams = self._streams.get(peer)
        if streams is None or message_id == HEARTBEAT or message_id not in self._telemetry.messages:
            return False
        if interval is None:
            interval = self._default(message_id)
        elif interval > 0:
            interval = min(max(interval, TICK_NS), LONGEST_NS)
        stream = streams.get(message_id)
        if stream is None:
            stream = streams[message_id] = MessageStream(peer, message_id, interval)
        stream.interval, stream.due = interval, -1
        self._plan(stream, self._tick)
        return True

    def interval(self, peer: Hashable, message_id: int) -> int:
        """A client's interval [ns] of a message, STOPPED if it does not get it."""
        stream = self._streams.get(peer, {}).get(message_id)
        return stream.interval if stream is not None else STOPPED

    def _default(self, message_id: int) -> int:
        rate = self._profile.get(message_id)
        return STOPPED if rate is None else round(1e9 / rate) if rate > 0.0 else WITH_NEWS

    def _join(self, client: ConnectedClient) -> None:
        self._streams[client.peer] = {}
        self._begin(client, [number for number in self._profile if number < FIRST_OWN_ID])

    def _recognise(self, client: ConnectedClient) -> None:
        self._begin(client, [number for number in self._profile if number >= FIRST_OWN_ID])

    def _begin(self, client: ConnectedClient, numbers: list[int]) -> None:
        streams = self._streams[client.peer]
        for number in numbers:
            if number in self._telemetry.messages:
                stream = streams[number] = MessageStream(client.peer, number, self._default(number))
                self._plan(stream, self._tick)

    def _leave(self, client: ConnectedClient) -> None:
        for stream in self._streams.pop(client.peer, {}).values():
            stream.due = -1

    def _plan(self, stream: MessageStream, tick: int) -> None:
        if stream.interval > 0:
            stream.due = next_due(tick, stream.interval, stream.message_id % MOST_OFFSET)
            self._calendar.setdefault(stream.due, []).append(stream)

    def _send(self, stream: MessageStream, tick: int, packed: dict[int, Any]) -> None:
        number = stream.message_id
        news = self._telemetry.news.get(number)
        if news is not None and news <= stream.sent:
            return
        message = packed.get(number)
        if message is None:
            found = self._telemetry.message(number)
            if found is None:
                return
            message = packed[number] = found
        stream.sent = tick
        self._link.send(message, stream.peer)

    def _plan_all(self, tick: int) -> None:
        """Plans all streams anew, after `tick`."""
        self._calendar.clear()
        for streams in self._streams.values():
            for stream in streams.values():
                self._plan(stream, tick)

    def _set(self, command: ReceivedCommand) -> CommandResult:
        message_id, interval = whole(command.params[0], -1), command.params[1]
        if message_id == HEARTBEAT:
            return CommandResult(FAILED, "HEARTBEAT comes once a second")
        if message_id in self.elsewhere:
            return self.elsewhere[message_id].subscribe(command)
        if message_id not in self._telemetry.messages:
            return CommandResult(UNSUPPORTED)
        if not isfinite(interval):
            return CommandResult(DENIED, "an interval is a number of microseconds, 0 or -1")
        wanted = STOPPED if interval < 0.0 else round(min(interval, 2.0**31) * 1000.0) or None
        return CommandResult(ACCEPTED if self.set(command.peer, message_id, wanted) else FAILED)

    def _get(self, command: ReceivedCommand) -> CommandResult:
        message_id = whole(command.params[0], -1)
        if not 0 <= message_id <= 0xFFFF:
            return CommandResult(DENIED)
        self._link.send(
            message("MESSAGE_INTERVAL", message_id=message_id, interval_us=self._told(command.peer, message_id)),
            command.peer,
        )
        return CommandResult(ACCEPTED)

    def _told(self, peer: Hashable, message_id: int) -> int:
        """MESSAGE_INTERVAL's number [us]: -1 for a message that is not sent at any interval, 0 for one there is not."""
        if message_id == HEARTBEAT:
            return 10**6
        if message_id in self.elsewhere:
            return self.elsewhere[message_id].interval(peer)
        if message_id not in self._telemetry.messages:
            return 0
        interval = self.interval(peer, message_id)
        return max(1, round(interval / 1000)) if interval > 0 else -1
