"""Samples at the full rate of control, in order and each tick once; one subscription serves all readers."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import reduce
from operator import or_
from threading import Lock
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.commands import CommandSender
from twodof.gcs.session import DroneSession
from twodof.gcs.telemetry import columns_of
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import batch_rows
from twodof.signals import TICK_S, TICK_US

BATCH, TRUTH = "TWODOF_BATCH", "TWODOF_TRUTH"
TIMEOUT_S = 5.0
LEAVING_S = 3.0
"""Longest wait for the answer at the end of a subscription: rows that wait on board are sent before it."""
_PARTS = 1024

Kind = TypeVar("Kind", np.float32, np.float64)


class SampleRows(Generic[Kind]):
    """Rows of `columns`, readable from any thread: `ticks` (n,) uint32 rising, `values` (n, columns) of type `kind`.

    All rows are kept in memory: 50 MB an hour for all channels. `lost` counts the rows missing between the first and
    the last.
    """

    def __init__(self, columns: tuple[str, ...], kind: type[Kind]) -> None:
        self.columns = columns
        self._ticks: list[NDArray[np.uint32]] = [np.empty(0, np.uint32)]
        self._values: list[NDArray[Kind]] = [np.empty((0, len(columns)), kind)]
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self.ticks)

    @property
    def ticks(self) -> NDArray[np.uint32]:
        """Tick of each row."""
        return self._joined()[0]

    @property
    def values(self) -> NDArray[Kind]:
        """The samples, a column for each of `columns`, in their units."""
        return self._joined()[1]

    @property
    def time(self) -> NDArray[np.float64]:
        """The drone's time of each row [s]."""
        return self.ticks.astype(np.float64) * TICK_S

    @property
    def lost(self) -> int:
        """Number of rows missing between the first and the last."""
        ticks = self.ticks
        return int(ticks[-1]) - int(ticks[0]) + 1 - len(ticks) if len(ticks) else 0

    def append(self, ticks: NDArray[np.uint32], values: NDArray[Kind]) -> None:
        """Add rows, in any order; a tick may come again."""
        with self._lock:
            self._ticks.append(ticks)
            self._values.append(values)
            if len(self._ticks) > _PARTS:  # small arrays take ten times the memory of a large one
                self._join()

    def _join(self) -> None:
        ticks, first = np.unique(np.concatenate(self._ticks), return_index=True)
        self._ticks, self._values = [ticks], [np.concatenate(self._values)[first]]

    def _joined(self) -> tuple[NDArray[np.uint32], NDArray[Kind]]:
        """Return all rows sorted, each tick once, and keep them so."""
        with self._lock:
            if len(self._ticks) > 1:
                self._join()
            return self._ticks[0], self._values[0]


class BatchRows(SampleRows[np.float32]):
    """Rows of the requested columns; NaN without a new sample."""

    def __init__(self, columns: tuple[str, ...]) -> None:
        super().__init__(columns, np.float32)

    def take(self, got: Any) -> None:
        """Add a TWODOF_BATCH."""
        ticks, values = batch_rows(got)
        places = columns_of(got.channels)
        if len(ticks) and all(column in places for column in self.columns):
            self.append(ticks, values[:, [places[column] for column in self.columns]])


class TruthRows(SampleRows[np.float64]):
    """True state of each tick, as the sensors measure it before the command acts."""

    def __init__(self) -> None:
        super().__init__(("truth.theta", "truth.q", "truth.x", "truth.v"), np.float64)

    def take(self, got: Any) -> None:
        """Add a TWODOF_TRUTH."""
        self.append(np.array([got.step], np.uint32), np.array([[got.theta, got.q, got.x, got.v]]))


Rows = TypeVar("Rows", BatchRows, TruthRows)


class FullRateSubscription:
    """Subscription to the message `name` (BATCH, TRUTH) at each tick, while there is a reader.

    A batch has the union of all readers' channels.
    """

    def __init__(self, session: DroneSession, commands: CommandSender, name: str) -> None:
        self._session, self._commands, self._name = session, commands, name
        self._number = dialect.message_id(name)
        self._wanted: list[int] = []  # masks of channels
        self._asked: list[float] | None = [self._number, -1]

    @asynccontextmanager
    async def to(self, taker: Callable[[Any], None], mask: int = 1) -> AsyncIterator[None]:
        """Hand every message to `taker` during the block, with the channels of `mask` at least.

        In lockstep the present true state comes first. Raises Rejected, LinkLost, Timeout.
        """
        deadline = self._session.deadline(TIMEOUT_S, f"subscribing to {self._name}")
        self._wanted.append(mask)
        with self._session.handling(taker, self._name):
            try:
                if self._session.lockstep and self._name != BATCH:  # the stream begins with the next tick
                    await self._commands.run("REQUEST_MESSAGE", [self._number], deadline.left, deadline.doing)
                await self._subscribe(deadline.left)
                yield
            finally:
                self._wanted.remove(mask)
                with suppress(LinkLost, Rejected, Timeout):  # rows without a reader do no harm
                    await self._subscribe(LEAVING_S)

    @asynccontextmanager
    async def rows(self, rows: Rows, mask: int = 1) -> AsyncIterator[Rows]:
        """Add every message during the block to `rows`."""
        async with self.to(rows.take, mask):
            yield rows

    async def _subscribe(self, timeout: float) -> None:
        mask = reduce(or_, self._wanted, 0)
        values: list[float] = [self._number, TICK_US if mask else -1]
        if mask and self._name == BATCH:
            values += [mask & 0xFFFF, mask >> 16]
        if values != self._asked:
            self._asked = None  # unknown until it is acknowledged: the call may be cancelled
            await self._commands.run("SET_MESSAGE_INTERVAL", values, timeout, f"subscribing to {self._name}")
            self._asked = values
