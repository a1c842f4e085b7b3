"""Streams and batches: each client gets the messages it wants at the rates it wants, and samples of every tick.

A stream is due in each tick in which the number of its whole intervals since tick 0 rises. Each message has its own
offset, so that messages of one rate do not come in one tick. Therefore a tick carries the same messages in every run,
also when clients come at other times. What several clients get in one tick is encoded once. HEARTBEAT has a
service of its own. A batch (TWODOF_BATCH) carries every sample of chosen channels, several ticks in a message.
"""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from math import isfinite, nan
from operator import attrgetter
from typing import Any

from twodof.fcu.command.command_lease import DONE, CommandResult, denied, failed, unsupported
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import SensorSample
from twodof.fcu.mavlink.clients import ClientJoined, ClientLeft, ClientRecognised
from twodof.fcu.mavlink.command_service import CommandHandled, CommandService, ReceivedCommand
from twodof.fcu.mavlink.encoders import HEARTBEAT, LEASE, OPENLOOP, RIG, SAFETY, TOF, TelemetryEncoders
from twodof.fcu.mavlink.service import MASK_32, Service, Vehicle, whole
from twodof.link.mavlink.dialect import FIRST_OWN_ID, ONBOARD, MavCmd
from twodof.link.mavlink.messages import BATCH_VALUES, Packer, channel_bits, message
from twodof.signals import TICK_NS, TICK_US, TOPICS, Topic

BATCH = 54203
LATEST_TICKS = 25
"""A batch waits at most .1 s for its last row."""
LARGEST_HALF = 0xFFFF


def published(tick: int) -> bool:
    """Return whether the estimates of position and velocity are new at this tick: at 100 of 250 ticks a second."""
    return 2 * tick % 5 < 2


def channel_readers(commander: Commander) -> dict[str, Callable[[ControlStep], float]]:
    """Return a function by channel that reads its value from a step; NaN without a new sample."""

    def value(row: Topic, name: str) -> Callable[[ControlStep], float]:
        if row.name == "openloop":
            return lambda _step: float(getattr(commander.openloop, name))
        if name == "-|T|":
            return lambda s: -abs(s.T)
        if name == "mode":
            return lambda s: float(s.asked.mode)
        read: Callable[[Any], float] = attrgetter(f"sample.{name}" if name in SensorSample._fields else name)
        if row.when == "published":
            return lambda s: read(s) if published(s.tick) else nan
        if not row.when:
            return read
        new = attrgetter(f"sample.{row.when}")
        return lambda s: read(s) if new(s) else nan

    return {
        column.replace(".", "_").upper(): value(row, name)
        for row in TOPICS
        for column, name in zip(row.columns, row.source, strict=bool(row.source))
    }


@dataclass(slots=True)
class BatchSubscription:
    """The channels of one client, and the rows that wait to be sent."""

    peer: Hashable
    mask: int
    every: int
    read: list[Callable[[ControlStep], float]]
    values: list[float] = field(default_factory=list)
    rows: int = 0
    begun: int = 0

    @property
    def full(self) -> bool:
        """Return whether the batch must be sent: no more rows fit, or the first has waited long enough."""
        return self.rows >= min(BATCH_VALUES // len(self.read), LATEST_TICKS // self.every + 1)


class BatchService(Service):
    """Subscriptions to batches, one a client, made and ended by command 511 for TWODOF_BATCH.

    Its parameter 2 is the interval of the samples [us] (0: each tick, -1: end), 3 and 4 are the low and the high 16
    bits of the mask of channels. Every sample is sent: a batch that the link drops shows as a gap in `tick`.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._pack = Packer("TWODOF_BATCH")
        read = channel_readers(vehicle.commander)
        self._readers = sorted((bit, read[name]) for name, bit in channel_bits().items())
        self._all = sum(bit for bit, _ in self._readers)
        self._subscriptions: dict[Hashable, BatchSubscription] = {}
        vehicle.bus.subscribe(ClientLeft, lambda left: self._subscriptions.pop(left.peer, None))

    def after(self, step: ControlStep) -> None:
        for subscription in self._subscriptions.values():
            if step.tick % subscription.every:
                continue
            if not subscription.rows:
                subscription.begun = step.tick & MASK_32
            subscription.values += [read(step) for read in subscription.read]
            subscription.rows += 1
            if subscription.full:
                self._flush(subscription)

    def restart(self) -> None:
        for subscription in self._subscriptions.values():
            self._flush(subscription)

    def subscribe(self, command: ReceivedCommand) -> CommandResult:
        """Carry out command 511 for TWODOF_BATCH."""
        interval, low, high = command.params[1], whole(command.params[2], -1), whole(command.params[3], -1)
        old = self._subscriptions.pop(command.peer, None)
        if old is not None:
            self._flush(old)
        if interval < 0.0:
            return DONE
        every = max(1, round(interval / TICK_US)) if isfinite(interval) else 0
        if not 0 <= low <= LARGEST_HALF or not 0 <= high <= LARGEST_HALF or not 1 <= every <= 0xFF:
            return denied("a batch needs an interval of at most 255 ticks and two halves of a mask")
        mask = low | high << 16
        if not mask or mask & ~self._all:
            return denied("a batch needs channels, all of them known")
        read = [one for bit, one in self._readers if mask & bit]
        self._subscriptions[command.peer] = BatchSubscription(command.peer, mask, every, read)
        return DONE

    def interval(self, peer: Hashable) -> int:
        """Return the interval [us] of a client's samples, -1 without a subscription."""
        subscription = self._subscriptions.get(peer)
        return subscription.every * TICK_US if subscription is not None else -1

    def _flush(self, subscription: BatchSubscription) -> None:
        if not subscription.rows:
            return
        values = subscription.values
        values += [0.0] * (BATCH_VALUES - len(values))
        sent = self._pack(subscription.mask, subscription.begun, *values, subscription.rows, subscription.every)
        subscription.values = []
        subscription.rows = 0
        self._vehicle.send(sent, subscription.peer)


STOPPED, WITH_NEWS = -1, 0
"""Special intervals: not sent, and sent at each change or new sample only."""
LONGEST_US = 2.0**31
MOST_OFFSET = 250


def due_ticks(tick: int, interval_ns: int, offset: int) -> tuple[int, int]:
    """Return the last tick up to `tick` at which a stream of this interval [ns] is due, and the first one after."""
    intervals = (tick + offset) * TICK_NS // interval_ns
    last, following = (-(-count * interval_ns // TICK_NS) - offset for count in (intervals, intervals + 1))
    return last, following


@dataclass(slots=True)
class MessageStream:
    """One message at one interval [ns] to `peers`: the tick at which it was due `last`, and the next one, `due`."""

    number: int
    interval: int
    peers: list[Hashable]
    last: int
    due: int


FLAG_TICKS = 25
"""Ticks between two messages about the failsafe's flags alone, which noise may flip."""


class ChangeDetector:
    """Detector of changes from step to step that must be sent at once."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._controller = vehicle.controller
        self._commander = vehicle.commander
        self._safety: tuple[Any, ...] = ()
        self._causes = 0
        self._told = -FLAG_TICKS
        self._before: dict[int, tuple[Any, ...]] = {}

    def changed_by(self, step: ControlStep) -> list[int]:
        """Return the ids of the messages whose content changes in this step."""
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

    `profile` gives the default rates of a client (`link.mavlink.dialect.PROFILES`); twodof's own messages are sent only
    to clients that know them. A sensor's message is left out without a new sample since the stream was due last.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandService,
        telemetry: TelemetryEncoders,
        batches: BatchService,
        profile: Mapping[int, float] = ONBOARD,
    ) -> None:
        # REQUEST_DATA_STREAM does nothing here as in PX4: its groups of messages are ArduPilot's.
        super().__init__(vehicle, {"REQUEST_DATA_STREAM": None})
        self._telemetry = telemetry
        self._changes = ChangeDetector(vehicle)
        self._batches = batches
        self._defaults = {
            number: round(1e9 / rate) if rate > 0.0 else WITH_NEWS
            for number, rate in profile.items()
            if number in telemetry.messages
        }
        self._intervals: dict[Hashable, dict[int, int]] = {}  # of each client's messages
        self._streams: dict[tuple[int, int], MessageStream] = {}  # by message and interval
        self._tick = -1
        vehicle.bus.subscribe(ClientJoined, lambda joined: self._begin(joined.peer, ours=False))
        vehicle.bus.subscribe(ClientRecognised, lambda known: self._begin(known.peer, ours=True))
        vehicle.bus.subscribe(ClientLeft, self._leave)
        commands.on(MavCmd.SET_MESSAGE_INTERVAL, self._set)
        commands.on(MavCmd.GET_MESSAGE_INTERVAL, self._get)

    def after(self, step: ControlStep) -> None:
        tick = step.tick
        if tick <= self._tick:
            self.restart()
        if tick != self._tick + 1:
            self._plan(tick - 1)
        self._tick = tick
        telemetry, packed = self._telemetry, dict[int, Any]()
        telemetry.observe(step)
        due = [stream for stream in self._streams.values() if stream.due == tick]
        for number in self._changes.changed_by(step):
            served = {peer for stream in due if stream.number == number for peer in stream.peers}
            for peer, intervals in self._intervals.items():
                interval = intervals.get(number, STOPPED)
                if peer not in served and (interval == WITH_NEWS or (interval > 0 and number not in telemetry.news)):
                    self._send(number, peer, packed)
        for stream in due:
            news = telemetry.news.get(stream.number)
            if news is None or news > stream.last:
                for peer in stream.peers:
                    self._send(stream.number, peer, packed)
            stream.last, stream.due = due_ticks(tick, stream.interval, stream.number % MOST_OFFSET)

    def restart(self) -> None:
        self._plan(-1)
        self._telemetry.restart()

    def _begin(self, peer: Hashable, ours: bool) -> None:
        """Start the default streams of a client: twodof's own messages if `ours`, else the others."""
        self._intervals.setdefault(peer, {})
        for number, interval in self._defaults.items():
            if (number >= FIRST_OWN_ID) is ours:
                self._stream(peer, number, interval)

    def _leave(self, left: ClientLeft) -> None:
        for number in self._intervals.get(left.peer, {}):
            self._stream(left.peer, number, STOPPED)
        self._intervals.pop(left.peer, None)

    def _plan(self, tick: int) -> None:
        """Plan the next due tick of all streams after `tick`."""
        self._tick = tick
        for (number, interval), stream in self._streams.items():
            stream.last, stream.due = due_ticks(tick, interval, number % MOST_OFFSET)

    def _stream(self, peer: Hashable, number: int, interval: int) -> None:
        """Send a message to a client at an interval from now on."""
        before = number, self._intervals[peer].get(number, STOPPED)
        if before in self._streams:
            self._streams[before].peers.remove(peer)
            if not self._streams[before].peers:
                del self._streams[before]
        self._intervals[peer][number] = interval
        if interval > 0:
            key = number, interval
            if key not in self._streams:
                self._streams[key] = MessageStream(*key, [], *due_ticks(self._tick, interval, number % MOST_OFFSET))
            self._streams[key].peers.append(peer)

    def _send(self, number: int, peer: Hashable, packed: dict[int, Any]) -> None:
        if number not in packed:
            packed[number] = self._telemetry.message(number)
        if packed[number] is not None:
            self._vehicle.send(packed[number], peer)

    def _set(self, command: ReceivedCommand) -> CommandResult:
        number, interval = whole(command.params[0], -1), command.params[1]
        if number == HEARTBEAT:
            return failed("HEARTBEAT comes once a second")
        if number == BATCH:
            return self._batches.subscribe(command)
        if number not in self._telemetry.messages:
            return unsupported()
        if not isfinite(interval):
            return denied("an interval is a number of microseconds, 0 or -1")
        if command.peer not in self._intervals:
            return failed()
        wanted = round(min(interval, LONGEST_US) * 1000.0)
        if interval < 0.0:
            wanted = STOPPED
        elif wanted == 0:
            wanted = self._defaults.get(number, STOPPED)
        else:
            wanted = max(wanted, TICK_NS)
        self._stream(command.peer, number, wanted)
        return DONE

    def _get(self, command: ReceivedCommand) -> CommandResult:
        message_id = whole(command.params[0], -1)
        if not 0 <= message_id <= 0xFFFF:
            return denied()
        interval_us = self._interval_us(command.peer, message_id)
        self._vehicle.send(message("MESSAGE_INTERVAL", message_id=message_id, interval_us=interval_us), command.peer)
        return DONE

    def _interval_us(self, peer: Hashable, number: int) -> int:
        """Return MESSAGE_INTERVAL's number [us]: -1 for a message that is not streamed, 0 for an unknown one."""
        if number == HEARTBEAT:
            return 10**6
        if number == BATCH:
            return self._batches.interval(peer)
        if number not in self._telemetry.messages:
            return 0
        interval = self._intervals.get(peer, {}).get(number, STOPPED)
        return max(1, round(interval / 1000)) if interval > 0 else -1


PERIOD_TICKS = 250


class Heartbeat(Service):
    """Service that sends the heartbeat, also to peers that were silent so far: many clients wait for it first."""

    def __init__(self, vehicle: Vehicle, telemetry: TelemetryEncoders) -> None:
        super().__init__(vehicle, {"HEARTBEAT": None})
        self._telemetry = telemetry
        self._said: tuple[int, int, int] | None = None
        vehicle.bus.subscribe(ClientJoined, lambda joined: self._send(joined.peer))
        vehicle.bus.subscribe(CommandHandled, lambda _: self._send_if_changed())

    def after(self, step: ControlStep) -> None:
        if step.tick % PERIOD_TICKS == 0:
            self._said = None
        self._send_if_changed()

    def idle(self) -> None:
        self._send()

    def _send_if_changed(self) -> None:
        c = self._vehicle.commander
        says = (c.base_mode, c.custom_mode, c.system_status)
        if says != self._said:
            self._said = says
            self._send()

    def _send(self, peer: Hashable | None = None) -> None:
        self._vehicle.send(self._telemetry.message(HEARTBEAT), peer)
