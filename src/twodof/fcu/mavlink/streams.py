"""Streams: each client gets the messages it wants at the rates it wants, exactly, on ticks that depend on nothing else.

A stream is due in each tick in which the number of its whole intervals since tick 0 rises. Each message has its own
offset, so that messages of one rate do not come in one tick. Therefore a tick carries the same messages in every run,
also when clients come at other times. What several clients get in one tick is encoded once. HEARTBEAT has a
service of its own.
"""

from collections.abc import Hashable, Mapping
from math import isfinite
from typing import Any

from twodof.fcu.command.command_lease import DONE, CommandResult, denied, failed, unsupported
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController, OnboardEventBus
from twodof.fcu.mavlink.batches import BATCH, BatchService
from twodof.fcu.mavlink.clients import ClientJoined, ClientLeft, ClientRecognised
from twodof.fcu.mavlink.command_service import CommandHandled, CommandService, ReceivedCommand
from twodof.fcu.mavlink.encoders import HEARTBEAT, LEASE, OPENLOOP, RIG, SAFETY, TOF, TelemetryEncoders
from twodof.fcu.mavlink.service import Link, Service, whole
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import FIRST_OWN_ID, ONBOARD, MavCmd
from twodof.link.mavlink.messages import message
from twodof.signals import TICK_NS

STOPPED, WITH_NEWS = -1, 0
"""Intervals that are none: not sent; sent with each news and at no other time."""
LONGEST_NS = 2**31 * 1000
MOST_OFFSET = 250


def next_due(tick: int, interval_ns: int, offset: int) -> int:
    """Return the first tick after `tick` in which a stream of that interval [ns] is due."""
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


FLAG_TICKS = 25
"""The failsafe's flags alone, which noise may flip, are told at most ten times a second."""


class ChangeDetector:
    """Compares each step with the one before."""

    def __init__(self, controller: FlightController, commander: Commander) -> None:
        self._controller = controller
        self._commander = commander
        self._safety: tuple[Any, ...] = ()
        self._causes = 0
        self._told = -FLAG_TICKS
        self._before: dict[int, tuple[Any, ...]] = {}

    def seen(self, step: ControlStep) -> list[int]:
        """Return the ids of the messages that have news in this step."""
        found = [TOF] if step.sample.dist_new else []
        safety = (step.action, step.state, step.armed, step.reason, self._commander.arming.killed_by)
        if safety != self._safety or (step.causes != self._causes and abs(step.tick - self._told) >= FLAG_TICKS):
            self._safety, self._causes, self._told = safety, step.causes, step.tick
            found.append(SAFETY)
        hardware, commander = self._controller.hardware, self._commander
        now = {
            RIG: (hardware.rings, hardware.safety_off, hardware.seed),
            LEASE: (commander.lease.holder, commander.lease.tuning_withheld),
            OPENLOOP: (commander.openloop.revision,),
        }
        if now != self._before:
            found += [number for number, facts in now.items() if facts != self._before.get(number)]
            self._before = now
        return found


class StreamService(Service):
    """All streams of all clients, and the commands 510 and 511 that read and change a client's own.

    `profile` gives the rates of a client that says nothing (`link.mavlink.rates.PROFILES`); twodof's own messages
    go to those only that know them. A sensor's message is left out where the sensor has given nothing since the last
    one. Messages in `changes` come at each change, too.
    """

    def __init__(
        self,
        link: Link,
        bus: OnboardEventBus,
        commands: CommandService,
        telemetry: TelemetryEncoders,
        changes: ChangeDetector,
        batches: BatchService,
        profile: Mapping[int, float] = ONBOARD,
    ) -> None:
        self._link = link
        self._telemetry = telemetry
        self._changes = changes
        self._batches = batches
        self._profile = profile
        self._streams: dict[Hashable, dict[int, MessageStream]] = {}
        self._calendar: dict[int, list[MessageStream]] = {}
        self._tick = -1
        bus.subscribe(ClientJoined, self._join)
        bus.subscribe(ClientRecognised, self._recognise)
        bus.subscribe(ClientLeft, self._leave)
        commands.on(MavCmd.SET_MESSAGE_INTERVAL, self._set)
        commands.on(MavCmd.GET_MESSAGE_INTERVAL, self._get)

    def handle(self, received: Received) -> bool:
        """Take REQUEST_DATA_STREAM, which does nothing here as in PX4: its groups of messages are ArduPilot's."""
        return bool(received.message.get_type() == "REQUEST_DATA_STREAM")

    def after(self, step: ControlStep) -> None:
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
        self._tick = -1
        self._telemetry.restart()
        for streams in self._streams.values():
            for stream in streams.values():
                stream.sent = -1
        self._plan_all(-1)

    def _change(self, peer: Hashable, message_id: int, interval: int | None) -> bool:
        """Set a client's interval [ns] of a message, None: the profile's; return False if the client is unknown."""
        streams = self._streams.get(peer)
        if streams is None:
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

    def _default(self, message_id: int) -> int:
        rate = self._profile.get(message_id)
        return STOPPED if rate is None else round(1e9 / rate) if rate > 0.0 else WITH_NEWS

    def _join(self, joined: ClientJoined) -> None:
        self._streams[joined.client.peer] = {}
        self._begin(joined.client.peer, [number for number in self._profile if number < FIRST_OWN_ID])

    def _recognise(self, recognised: ClientRecognised) -> None:
        self._begin(recognised.client.peer, [number for number in self._profile if number >= FIRST_OWN_ID])

    def _begin(self, peer: Hashable, numbers: list[int]) -> None:
        streams = self._streams[peer]
        for number in numbers:
            if number in self._telemetry.messages:
                stream = streams[number] = MessageStream(peer, number, self._default(number))
                self._plan(stream, self._tick)

    def _leave(self, left: ClientLeft) -> None:
        for stream in self._streams.pop(left.client.peer, {}).values():
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
        """Plan all streams from `tick` on."""
        self._calendar.clear()
        for streams in self._streams.values():
            for stream in streams.values():
                self._plan(stream, tick)

    def _set(self, command: ReceivedCommand) -> CommandResult:
        message_id, interval = whole(command.params[0], -1), command.params[1]
        if message_id == HEARTBEAT:
            return failed("HEARTBEAT comes once a second")
        if message_id == BATCH:
            return self._batches.subscribe(command)
        if message_id not in self._telemetry.messages:
            return unsupported()
        if not isfinite(interval):
            return denied("an interval is a number of microseconds, 0 or -1")
        wanted = STOPPED if interval < 0.0 else round(min(interval, 2.0**31) * 1000.0) or None
        return DONE if self._change(command.peer, message_id, wanted) else failed()

    def _get(self, command: ReceivedCommand) -> CommandResult:
        message_id = whole(command.params[0], -1)
        if not 0 <= message_id <= 0xFFFF:
            return denied()
        interval_us = self._interval_us(command.peer, message_id)
        self._link.send(message("MESSAGE_INTERVAL", message_id=message_id, interval_us=interval_us), command.peer)
        return DONE

    def _interval_us(self, peer: Hashable, message_id: int) -> int:
        """Return MESSAGE_INTERVAL's number [us]: -1 for a message that is not streamed, 0 for an unknown one."""
        if message_id == HEARTBEAT:
            return 10**6
        if message_id == BATCH:
            return self._batches.interval(peer)
        if message_id not in self._telemetry.messages:
            return 0
        stream = self._streams.get(peer, {}).get(message_id)
        return max(1, round(stream.interval / 1000)) if stream is not None and stream.interval > 0 else -1


PERIOD_TICKS = 250


class Heartbeat(Service):
    """Says that the vehicle is there, also to peers that were silent so far: many clients wait for it first."""

    def __init__(self, link: Link, bus: OnboardEventBus, telemetry: TelemetryEncoders, commander: Commander) -> None:
        self._link = link
        self._telemetry = telemetry
        self._commander = commander
        self._said: tuple[int, int, int] | None = None
        bus.subscribe(ClientJoined, lambda joined: self._send(joined.client.peer))
        bus.subscribe(CommandHandled, lambda _: self._send_if_changed())

    def handle(self, received: Received) -> bool:
        """Take other components' heartbeats, which need no answer."""
        return bool(received.message.get_type() == "HEARTBEAT")

    def after(self, step: ControlStep) -> None:
        if step.tick % PERIOD_TICKS == 0:
            self._said = None
        self._send_if_changed()

    def idle(self) -> None:
        self._send()

    def _send_if_changed(self) -> None:
        c = self._commander
        says = (c.base_mode, c.custom_mode, c.system_status)
        if says != self._said:
            self._said = says
            self._send()

    def _send(self, peer: Hashable | None = None) -> None:
        self._link.send(self._telemetry.message(HEARTBEAT), peer)
