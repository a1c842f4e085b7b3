"""Fewer rows for who asked for fewer: of each bucket of ticks, column by column, minimum and maximum are kept."""

from __future__ import annotations

from itertools import pairwise
from math import ceil

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.steps import BOOT
from twodof.signals import PERIOD

FULL_RATE = round(1.0 / PERIOD)
"""Rows a second at which nothing is left out."""


class Decimation:
    """Rows at no more than `rate` a second; a bucket gives two, in the order in which its extremes came.

    A column of a bucket in which it has no sample is NaN. A peak of one tick is in the picture at any rate.
    """

    def __init__(self, rate: float) -> None:
        self.ticks = 1 if rate >= FULL_RATE else max(2, ceil(2 * FULL_RATE / rate))
        self._times: list[NDArray[np.float64]] = []
        self._values: list[NDArray[np.float32]] = []
        self._bucket = -1

    def take(
        self, ticks: NDArray[np.int64], values: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Further rows, ticks rising; returns what is whole by now: times (n,) [s] and values (n, columns).

        The times are those of the drone's logs: what is seen in flight is found there at the same second.
        """
        times: NDArray[np.float64] = np.asarray(BOOT + ticks * PERIOD, dtype=np.float64)
        if self.ticks == 1:
            return times, values
        buckets = ticks // self.ticks
        given_times: list[float] = []
        given: list[NDArray[np.float32]] = []
        edges = [0, *(np.flatnonzero(np.diff(buckets)) + 1).tolist(), len(ticks)]
        for start, end in pairwise(edges):
            if end == start:
                continue
            if self._values and int(buckets[start]) != self._bucket:
                self._close(given_times, given)
            self._bucket = int(buckets[start])
            self._times.append(times[start:end])
            self._values.append(values[start:end])
        width = values.shape[1]
        rows = np.array(given, dtype=np.float32).reshape(len(given_times), width)
        return np.array(given_times, dtype=np.float64), rows

    def _close(self, given_times: list[float], given: list[NDArray[np.float32]]) -> None:
        """Put the extremes of the bucket that is whole behind what is given."""
        times, values = np.concatenate(self._times), np.concatenate(self._values)
        self._times, self._values = [], []
        absent = np.isnan(values)
        columns = np.arange(values.shape[1])
        least = np.where(absent, np.inf, values).argmin(axis=0)
        most = np.where(absent, -np.inf, values).argmax(axis=0)
        first, last = np.minimum(least, most), np.maximum(least, most)
        given_times += [float(times[0]), float(times[-1])]
        given += [values[first, columns], values[last, columns]]
