"""The true state of a virtual rig, for the ground alone: one subscription serves all who want it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.mavlink.commands import CommandSender
from twodof.gcs.mavlink.session import DroneSession
from twodof.gcs.telemetry.sample_rows import SampleRows
from twodof.link.control_period import TICK_US
from twodof.link.mavlink import dialect

MESSAGE = "TWODOF_TRUTH"
TIMEOUT_S = 5.0
LEAVING_S = 1.0
_PIECE = 1024


class TruthRows(SampleRows[np.float64]):
    """The true state of each tick, as the sensors measure it before the command acts."""

    def __init__(self) -> None:
        super().__init__(("truth.theta", "truth.q", "truth.x", "truth.v"), np.float64)
        self._new: list[tuple[int, float, float, float, float]] = []

    def take(self, got: Any) -> None:
        """A TWODOF_TRUTH."""
        self._new.append((got.step, got.theta, got.q, got.x, got.v))
        if len(self._new) == _PIECE:  # a state alone would take ten times its room
            self._put_away()

    def _put_away(self) -> None:
        rows = np.array(self._new, dtype=np.float64)
        self._new = []
        self.append(rows[:, 0].astype(np.uint32), rows[:, 1:])

    def _joined(self) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        if self._new:
            self._put_away()
        return super()._joined()


class TruthSubscription:
    """Subscribes the drone to its rig's true state while somebody wants it."""

    def __init__(self, session: DroneSession, commands: CommandSender) -> None:
        self._session, self._commands = session, commands
        self._wanted = 0  # by how many

    @asynccontextmanager
    async def to(self, taker: Callable[[Any], None]) -> AsyncIterator[None]:
        """Hands every TWODOF_TRUTH to `taker` until the end of the block; where time is granted, the present one first.

        Raises Rejected by a real drone, whose truth nobody knows, LinkLost, Timeout.
        """
        deadline = self._session.deadline(TIMEOUT_S, "subscribing to the rig's true state")
        number = dialect.message_id(MESSAGE)
        self._wanted += 1
        with self._session.handling(taker, MESSAGE):
            try:
                if self._session.lockstep:  # a stream begins with the tick after
                    await self._commands.run("REQUEST_MESSAGE", [number], deadline.left, deadline.doing)
                await self._interval(TICK_US, deadline.left)
                yield
            finally:
                self._wanted -= 1
                if not self._wanted:
                    with suppress(LinkLost, Rejected, Timeout):  # what is not wanted any more harms nobody
                        await self._interval(-1, LEAVING_S)

    @asynccontextmanager
    async def rows(self) -> AsyncIterator[TruthRows]:
        """Every state that comes during the block."""
        rows = TruthRows()
        async with self.to(rows.take):
            yield rows

    async def _interval(self, interval: int, timeout: float) -> None:
        values = [dialect.message_id(MESSAGE), interval]
        await self._commands.run("SET_MESSAGE_INTERVAL", values, timeout, "subscribing to the rig's true state")
