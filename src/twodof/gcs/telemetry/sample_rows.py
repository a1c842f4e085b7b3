"""Rows of samples as they came over the wire: in order, each tick once, and how many are missing."""

from __future__ import annotations

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from twodof.link.control_period import TICK_S

MOST_ROWS = 4_000_000
"""More than four hours; then the oldest half is let go and counted as lost."""

Kind = TypeVar("Kind", np.float32, np.float64)


class SampleRows(Generic[Kind]):
    """Rows of `columns`: `ticks` (n,) uint32 rising, `values` (n, columns) of the type `kind`.

    `lost` counts rows that are missing between the first and the last.
    """

    def __init__(self, columns: tuple[str, ...], kind: type[Kind]) -> None:
        self.columns = columns
        self.forgotten = 0
        self._kind: type[Kind] = kind
        self._ticks: list[NDArray[np.uint32]] = []
        self._values: list[NDArray[Kind]] = []
        self._count = 0

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
        """Rows that are missing."""
        ticks = self.ticks
        return self.forgotten + (int(ticks[-1]) - int(ticks[0]) + 1 - len(ticks) if len(ticks) else 0)

    def append(self, ticks: NDArray[np.uint32], values: NDArray[Kind]) -> None:
        """Further rows, in any order, also some that came before."""
        self._ticks.append(ticks)
        self._values.append(values)
        self._count += len(ticks)
        if self._count > MOST_ROWS:
            self._let_go()

    def _let_go(self) -> None:
        ticks, values = self._joined()
        half = len(ticks) // 2
        self.forgotten += half
        self._ticks, self._values, self._count = [ticks[half:]], [values[half:]], len(ticks) - half

    def _joined(self) -> tuple[NDArray[np.uint32], NDArray[Kind]]:
        """All in one piece, sorted, each tick once; kept so, so that asking again costs nothing."""
        if len(self._ticks) != 1:
            ticks = np.concatenate([np.empty(0, np.uint32), *self._ticks])
            values = np.concatenate([np.empty((0, len(self.columns)), self._kind), *self._values])
            ticks, first = np.unique(ticks, return_index=True)
            self._ticks, self._values, self._count = [ticks], [values[first]], len(ticks)
        return self._ticks[0], self._values[0]
