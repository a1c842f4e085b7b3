"""The true state of a virtual rig, for the ground alone: one subscription of the drone for all that want it."""

from __future__ import annotations

from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.commands import Commands
from twodof.gcs.deadline import Deadline
from twodof.gcs.session import Session
from twodof.link import dialect
from twodof.link.tick import TICK_S, TICK_US

MESSAGE = "TWODOF_TRUTH"
TIMEOUT_S = 5.0
LEAVING_S = 1.0
MOST_ROWS = 4_000_000
"""More than four hours; then the oldest are let go."""


class TruthRows:
    """True states as they came: `ticks` (n,) uint32 rising, `values` (n, 4) float64, of theta, q, x, v in SI units.

    The state of a tick is that which the sensors measure in it, before its command acts.
    """

    columns = ("truth.theta", "truth.q", "truth.x", "truth.v")

    def __init__(self) -> None:
        self._rows: deque[tuple[int, float, float, float, float]] = deque(maxlen=MOST_ROWS)

    def __len__(self) -> int:
        return len(self.ticks)

    @property
    def ticks(self) -> NDArray[np.uint32]:
        """Tick of each row."""
        return self._sorted()[0]

    @property
    def values(self) -> NDArray[np.float64]:
        """The states, a column for each of `columns`."""
        return self._sorted()[1]

    @property
    def time(self) -> NDArray[np.float64]:
        """The drone's time of each row [s]."""
        return self.ticks.astype(np.float64) * TICK_S

    @property
    def lost(self) -> int:
        """Rows that are missing between the first and the last."""
        ticks = self.ticks
        return int(ticks[-1]) - int(ticks[0]) + 1 - len(ticks) if len(ticks) else 0

    def take(self, got: Any) -> None:
        """A TWODOF_TRUTH."""
        self._rows.append((got.step, got.theta, got.q, got.x, got.v))

    def _sorted(self) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        rows = np.array(self._rows, dtype=np.float64).reshape(-1, 1 + len(self.columns))
        ticks, first = np.unique(rows[:, 0].astype(np.uint32), return_index=True)
        return ticks, rows[first, 1:]


class Truth:
    """Subscribes the drone to its rig's true state while somebody wants it."""

    def __init__(self, session: Session, commands: Commands) -> None:
        self._session, self._commands = session, commands
        self._takers: list[Callable[[Any], None]] = []
        session.on(self._take, MESSAGE)

    @asynccontextmanager
    async def to(self, taker: Callable[[Any], None]) -> AsyncIterator[None]:
        """Hands every TWODOF_TRUTH to `taker` meanwhile; where time is granted, that of the present tick first.

        Raises Rejected by a real drone, whose truth nobody knows, LinkLost, Timeout.
        """
        deadline = Deadline(TIMEOUT_S, "subscribing to the rig's true state", f"drone {self._session.system}")
        number = dialect.message_id(MESSAGE)
        self._takers.append(taker)
        try:
            if self._session.lockstep:  # a stream begins with the tick after
                await self._commands.run("REQUEST_MESSAGE", [number], deadline.left, deadline.doing)
            await self._interval(TICK_US, deadline.left)
            yield
        finally:
            self._takers.remove(taker)
            if not self._takers:
                with suppress(LinkLost, Rejected, Timeout):  # what is not wanted any more harms nobody
                    await self._interval(-1, LEAVING_S)

    @asynccontextmanager
    async def rows(self) -> AsyncIterator[TruthRows]:
        """Every state that comes meanwhile."""
        rows = TruthRows()
        async with self.to(rows.take):
            yield rows

    async def _interval(self, interval: int, timeout: float) -> None:
        values = [dialect.message_id(MESSAGE), interval]
        await self._commands.run("SET_MESSAGE_INTERVAL", values, timeout, "subscribing to the rig's true state")

    def _take(self, got: Any) -> None:
        for taker in [*self._takers]:
            taker(got)
