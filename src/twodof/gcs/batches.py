"""Samples at the full rate of control: one subscription of the drone for all that want some of them."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.commands import Commands
from twodof.gcs.decoding import columns_of
from twodof.gcs.session import Session
from twodof.link import dialect
from twodof.link.messages import batch_rows, channel_mask
from twodof.link.tick import TICK_S

MESSAGE = "TWODOF_BATCH"
TIMEOUT_S = 5.0
LEAVING_S = 1.0
_IN_DOUBT = -1
MOST_ROWS = 4_000_000
"""More than four hours; then the oldest half is let go and counted as lost."""


class Rows:
    """Rows of `columns` as they came: `ticks` (n,) uint32 rising, `values` (n, columns) float32, NaN: no new sample.

    `lost` counts rows that are missing between the first and the last.
    """

    def __init__(self, columns: tuple[str, ...]) -> None:
        self.columns = columns
        self.forgotten = 0
        self._ticks: list[NDArray[np.uint32]] = []
        self._values: list[NDArray[np.float32]] = []
        self._count = 0

    def __len__(self) -> int:
        return len(self.ticks)

    @property
    def ticks(self) -> NDArray[np.uint32]:
        """Tick of each row."""
        return self._joined()[0]

    @property
    def values(self) -> NDArray[np.float32]:
        """The samples, a column for each of `columns`, in their units."""
        return self._joined()[1]

    @property
    def time(self) -> NDArray[np.float64]:
        """The drone's time of each row [s]."""
        return self.ticks.astype(np.float64) * TICK_S

    @property
    def lost(self) -> int:
        """Rows that are missing."""
        ticks = self.ticks
        return self.forgotten + (int(ticks[-1]) - int(ticks[0]) + 1 - len(ticks) if len(ticks) else 0)

    def take(self, got: Any) -> None:
        """A TWODOF_BATCH."""
        ticks, values = batch_rows(got)
        places = columns_of(got.channels)
        if len(ticks) and all(column in places for column in self.columns):
            self._ticks.append(ticks)
            self._values.append(values[:, [places[column] for column in self.columns]])
            self._count += len(ticks)
            if self._count > MOST_ROWS:
                self._let_go()

    def _let_go(self) -> None:
        ticks, values = self._joined()
        half = len(ticks) // 2
        self.forgotten += half
        self._ticks, self._values, self._count = [ticks[half:]], [values[half:]], len(ticks) - half

    def _joined(self) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
        """All in one piece, sorted, each tick once; kept so, so that asking again costs nothing."""
        if len(self._ticks) != 1:
            ticks = np.concatenate([np.empty(0, np.uint32), *self._ticks])
            values = np.concatenate([np.empty((0, len(self.columns)), np.float32), *self._values])
            ticks, first = np.unique(ticks, return_index=True)
            self._ticks, self._values, self._count = [ticks], [values[first]], len(ticks)
        return self._ticks[0], self._values[0]


class Batches:
    """Subscribes the drone to the union of the columns that are wanted now."""

    def __init__(self, session: Session, commands: Commands) -> None:
        self._session, self._commands = session, commands
        self._wanted: dict[object, int] = {}
        self._takers: dict[object, Callable[[Any], None]] = {}
        self._mask = 0
        session.on(self._take, MESSAGE)

    @asynccontextmanager
    async def to(self, columns: Iterable[str], taker: Callable[[Any], None]) -> AsyncIterator[None]:
        """Hands every TWODOF_BATCH with these columns (`imu.gyro_y`) to `taker` meanwhile.

        Raises LinkError for a column that is none, Rejected, LinkLost, Timeout.
        """
        key = object()
        self._wanted[key] = channel_mask(list(columns))
        self._takers[key] = taker
        try:
            await self._subscribe(TIMEOUT_S)
            yield
        finally:
            del self._wanted[key]
            try:
                with suppress(LinkLost, Rejected, Timeout):  # what is not wanted any more harms nobody
                    await self._subscribe(LEAVING_S)
            finally:
                del self._takers[key]

    @asynccontextmanager
    async def rows(self, columns: Iterable[str]) -> AsyncIterator[Rows]:
        """Every row of these columns that comes meanwhile."""
        rows = Rows(tuple(columns))
        async with self.to(rows.columns, rows.take):
            yield rows

    async def _subscribe(self, timeout: float) -> None:
        mask = 0
        for one in self._wanted.values():
            mask |= one
        if mask == self._mask:
            return
        period = round(TICK_S * 1e6) if mask else -1
        values = [dialect.message_id(MESSAGE), period, mask & 0xFFFF, mask >> 16]
        self._mask = _IN_DOUBT  # until it is acknowledged: a call that is cancelled does not know
        await self._commands.run("SET_MESSAGE_INTERVAL", values, timeout, "subscribing to full-rate samples")
        self._mask = mask

    def _take(self, got: Any) -> None:
        for taker in [*self._takers.values()]:
            taker(got)
