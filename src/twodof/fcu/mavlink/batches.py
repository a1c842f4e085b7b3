"""Batches: TWODOF_BATCH carries every sample of chosen channels to a client that asks, several ticks in a message."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from math import isfinite, nan
from operator import attrgetter
from typing import Any

from twodof.fcu.command.command_lease import DONE, CommandResult, denied
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import SensorSample
from twodof.fcu.mavlink.clients import ClientLeft
from twodof.fcu.mavlink.command_service import ReceivedCommand
from twodof.fcu.mavlink.service import MASK_32, Service, Vehicle, whole
from twodof.link.mavlink.messages import BATCH_VALUES, Packer, channel_bits
from twodof.signals import TICK_US, TOPICS, Topic

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
