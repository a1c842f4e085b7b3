"""Samples at the full rate of control: one subscription of the drone serves all who want some of them."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from functools import reduce
from operator import or_
from typing import Any

import numpy as np

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.mavlink.commands import CommandSender
from twodof.gcs.mavlink.session import DroneSession
from twodof.gcs.telemetry.decoding import columns_of
from twodof.gcs.telemetry.sample_rows import SampleRows
from twodof.link.control_period import TICK_S
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import batch_rows, channel_mask

MESSAGE = "TWODOF_BATCH"
TIMEOUT_S = 5.0
LEAVING_S = 3.0
"""What waits on board is sent before the answer to this, so it is waited for until the drone would count as lost."""
_IN_DOUBT = -1


class BatchRows(SampleRows[np.float32]):
    """Rows of the columns that were asked for; NaN: no new sample."""

    def __init__(self, columns: tuple[str, ...]) -> None:
        super().__init__(columns, np.float32)

    def take(self, got: Any) -> None:
        """A TWODOF_BATCH."""
        ticks, values = batch_rows(got)
        places = columns_of(got.channels)
        if len(ticks) and all(column in places for column in self.columns):
            self.append(ticks, values[:, [places[column] for column in self.columns]])


class FullRateSubscription:
    """Subscribes the drone to the union of the columns that are wanted now."""

    def __init__(self, session: DroneSession, commands: CommandSender) -> None:
        self._session, self._commands = session, commands
        self._wanted: list[int] = []  # masks of channels
        self._mask = 0

    @asynccontextmanager
    async def to(self, columns: Iterable[str], taker: Callable[[Any], None]) -> AsyncIterator[None]:
        """Hands every TWODOF_BATCH with these columns (`imu.gyro_y`) to `taker` until the end of the block.

        Raises LinkError for a column that is none, Rejected, LinkLost, Timeout.
        """
        mask = channel_mask(list(columns))
        self._wanted.append(mask)
        with self._session.handling(taker, MESSAGE):
            try:
                await self._subscribe(TIMEOUT_S)
                yield
            finally:
                self._wanted.remove(mask)
                with suppress(LinkLost, Rejected, Timeout):  # what is not wanted any more harms nobody
                    await self._subscribe(LEAVING_S)

    @asynccontextmanager
    async def rows(self, columns: Iterable[str]) -> AsyncIterator[BatchRows]:
        """Every row of these columns that comes during the block."""
        rows = BatchRows(tuple(columns))
        async with self.to(rows.columns, rows.take):
            yield rows

    async def _subscribe(self, timeout: float) -> None:
        mask = reduce(or_, self._wanted, 0)
        if mask == self._mask:
            return
        period = round(TICK_S * 1e6) if mask else -1
        values = [dialect.message_id(MESSAGE), period, mask & 0xFFFF, mask >> 16]
        self._mask = _IN_DOUBT  # until it is acknowledged: a call that is cancelled does not know
        await self._commands.run("SET_MESSAGE_INTERVAL", values, timeout, "subscribing to full-rate samples")
        self._mask = mask
