"""TickRows: the rows of one drone in the order of its ticks, put together of the messages that carry them."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twodof.link.mavlink.messages import channel_bits
from twodof.signals import TOPICS

_SENT = frozenset(channel_bits())
ONBOARD = tuple(column for row in TOPICS for column in row.columns if column.replace(".", "_").upper() in _SENT)
TRUTH = tuple(column for row in TOPICS if not row.onboard for column in row.columns)
COLUMNS = (*ONBOARD, *TRUTH)
"""What may be subscribed to: every column that a drone sends at the full rate, and the truth of a virtual rig."""
PLACES = MappingProxyType({column: place for place, column in enumerate(COLUMNS)})
_TRUTH_PLACES = np.arange(len(ONBOARD), len(COLUMNS), dtype=np.intp)
BACK_TICKS = 250
"""A tick that is so much older than the newest is of a drone that began anew; of less it came too late."""
PATIENCE_TICKS = 12
"""So long a row waits for what comes in other messages, the truth for instance."""


class TickRows:
    """Rows that wait, by tick; `take` gives those that are whole. `late` counts what came after its row was given."""

    def __init__(self) -> None:
        self.late = 0
        self._waiting: dict[int, NDArray[np.float32]] = {}
        self._given = -1
        self._newest = [-1, -1]  # tick on board, of the truth

    def onboard(self, ticks: NDArray[np.uint32], values: NDArray[np.float32], places: NDArray[np.intp]) -> None:
        """Rows of a batch, whose columns stand at `places` of COLUMNS."""
        for tick, row in zip(ticks.tolist(), values, strict=True):
            self._put(tick, places, row, 0)

    def truth(self, tick: int, values: tuple[float, float, float, float]) -> None:
        """The true state of a tick."""
        self._put(tick, _TRUTH_PLACES, np.array(values, dtype=np.float32), 1)

    def _put(self, tick: int, places: NDArray[np.intp], values: NDArray[np.float32], source: int) -> None:
        if tick <= self._given:
            if tick > self._given - BACK_TICKS:
                self.late += source == 0
                return
            self._waiting.clear()
            self._given, self._newest = tick - 1, [-1, -1]
        self._newest[source] = max(self._newest[source], tick)
        row = self._waiting.get(tick)
        if row is None:
            row = self._waiting[tick] = np.full(len(COLUMNS), np.nan, dtype=np.float32)
        row[places] = values

    def take(self) -> tuple[NDArray[np.int64], NDArray[np.float32]] | None:
        """Ticks (n,), rising, and values (n, COLUMNS) of the rows that are whole; None where there are none."""
        newest = max(self._newest)
        heard = [tick for tick in self._newest if tick > max(-1, newest - PATIENCE_TICKS)]
        whole = sorted(tick for tick in self._waiting if tick <= min(heard, default=-1))
        if not whole:
            return None
        values = np.stack([self._waiting.pop(tick) for tick in whole])
        self._given = whole[-1]
        return np.array(whole, dtype=np.int64), values
