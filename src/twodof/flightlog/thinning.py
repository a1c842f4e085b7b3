"""Fewer points that look like the same line: the lowest and the highest of each part stay."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def thinned(time: Array, value: Array, most: int) -> tuple[Array, Array]:
    """At most about `most` of the points `time` (n,), `value` (n,): of each part the lowest, the highest and a hole.

    A hole is a NaN: the line is interrupted there. The first and the last point stay. `most` is 2 or more.
    """
    count = len(time)
    if count <= most:
        return time, value
    size = -(-count // max(1, most // 2))
    low, high = np.where(np.isnan(value), np.inf, value), np.where(np.isnan(value), -np.inf, value)
    kept = [0, count - 1]
    for start in range(0, count, size):
        part = slice(start, start + size)
        kept += [start + int(np.argmin(low[part])), start + int(np.argmax(high[part]))]
        kept += [start + int(hole) for hole in np.flatnonzero(np.isnan(value[part]))[:1]]
    index = np.unique(kept)
    return time[index], value[index]
