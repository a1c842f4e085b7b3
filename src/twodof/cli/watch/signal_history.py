"""What one signal was in the last seconds: every sample, and its smallest and largest in each column of a chart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.signals import PERIOD

Column = NDArray[np.float64]


class SignalHistory:
    """The samples of the last `seconds` of a signal of at most 250 Hz, by the drone's time [s]."""

    def __init__(self, seconds: float) -> None:
        self._keep = round(seconds / PERIOD) + 1
        self._time = np.empty(2 * self._keep)
        self._value = np.empty(2 * self._keep)
        self._count = 0

    @property
    def latest(self) -> float | None:
        """The newest value; None if none has come."""
        return float(self._value[self._count - 1]) if self._count else None

    @property
    def newest(self) -> float:
        """When that was [s]; NaN if none has come."""
        return float(self._time[self._count - 1]) if self._count else float("nan")

    def add(self, time: ArrayLike, value: ArrayLike) -> None:
        """Further samples, both (n,), in order of time; what is not finite is no sample.

        A time before the newest is that of a drone that began anew: what was before is forgotten.
        """
        times, values = np.atleast_1d(np.asarray(time, float)), np.atleast_1d(np.asarray(value, float))
        known = np.isfinite(values)
        times, values = times[known][-self._keep :], values[known][-self._keep :]
        if not times.size:
            return
        if self._count and times[0] < self.newest:
            self._count = 0
        if self._count + times.size > len(self._time):
            kept = min(self._count, self._keep)
            for ring in (self._time, self._value):
                ring[:kept] = ring[self._count - kept : self._count].copy()
            self._count = kept
        end = self._count + times.size
        self._time[self._count : end], self._value[self._count : end] = times, values
        self._count = end

    def columns(self, count: int, end: float, seconds: float) -> tuple[Column, Column]:
        """Smallest and largest value, each (count,), in `count` equal parts of the `seconds` before `end`.

        A part without a sample has the last value before it, as far as the newest sample; NaN where nothing is known.
        """
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        time, value = self._time[: self._count], self._value[: self._count]
        place = np.floor((time - (end - seconds)) / seconds * count).astype(np.int64)
        # What is stamped at the end itself belongs to the last part.
        place[time == end] = count - 1
        inside = (place >= 0) & (place < count)
        np.minimum.at(low, place[inside], value[inside])
        np.maximum.at(high, place[inside], value[inside])
        newest_before = np.searchsorted(place, np.arange(count), side="right") - 1
        empty = low > high
        held = empty & (newest_before >= 0) & (np.arange(count) <= (place[-1] if self._count else -1))
        low[empty] = high[empty] = np.nan
        low[held] = high[held] = value[newest_before[held]]
        return low, high
