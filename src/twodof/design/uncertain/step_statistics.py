"""The figures of many step responses at once: rise, overshoot, peaks, as `step_figures` reads them off one."""

import numpy as np
from numpy.typing import NDArray

from twodof.signals import PERIOD

Array = NDArray[np.float64]

FIGURES = ("rise_time", "overshoot", "settled_error", "peak_q", "peak_M")
"""Rise from 10 to 90 % [s]; overshoot, as a share of the step; the mean error of the last fifth, as a share; the
largest |q| [rad/s]; the largest |M| from its mean before the step.
"""

TRIM = 125
"""Samples before the step over which the moment that holds the drone is averaged: .5 s."""


def step_statistics(theta: Array, q: Array, moment: Array, goal: float) -> dict[str, Array]:
    """Each of `FIGURES`, (n,), of responses (steps, n) from 0 to `goal` [rad] that begin at the first row.

    `moment` is about its trim already. A rise that does not come to 90 % is infinite.
    """
    z = theta / goal
    tail = max(1, len(z) // 5)
    return {
        "rise_time": _first(z, 0.9) - _first(z, 0.1),
        "overshoot": np.maximum(0.0, z.max(axis=0) - 1.0),
        "settled_error": 1.0 - z[-tail:].mean(axis=0),
        "peak_q": np.abs(q).max(axis=0),
        "peak_M": np.abs(moment).max(axis=0),
    }


def interval(values: Array, level: float) -> tuple[float, float, float]:
    """(low, middle, high): a share `level` of `values` (n,) is from low to high, as much out on each side.

    Where more than that side's share has the same least value, as an overshoot of 0, nothing can be below it: then all
    that is out is above.
    """
    out = 1.0 - level
    least = float(values.min())
    bounded = float(np.mean(values == least)) > 0.5 * out
    tails = (0.0 if bounded else 0.5 * out, 0.5, level if bounded else 1.0 - 0.5 * out)
    low, middle, high = (float(v) for v in np.quantile(values, tails, method="nearest"))
    return low, middle, high


def _first(z: Array, level: float) -> Array:
    """The time [s] at which each column first reaches `level`, between samples; infinite where it never does."""
    reached = z >= level
    k = reached.argmax(axis=0)
    there = np.where(reached.any(axis=0), k, 0)
    column = np.arange(z.shape[1])
    above, below = z[there, column], z[np.maximum(there - 1, 0), column]
    rise = np.where(above > below, above - below, 1.0)
    time = (there - np.where(there > 0, (above - level) / rise, 0.0)) * PERIOD
    return np.where(reached.any(axis=0), time, np.inf)
