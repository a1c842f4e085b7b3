"""Statistics of many step responses at once: rise, overshoot, intervals of figures, and bands of channels."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.models.lti import rise_times
from twodof.signals import PERIOD

Array = NDArray[np.float64]

TRIM = 125
"""Samples before a step over which a channel's rest is averaged: .5 s."""


def step_statistics(response: Array, goal: float) -> dict[str, Array]:
    """Return the figures, (n,) each, of responses (steps, n) from 0 to `goal` that begin at the first row.

    They are the rise from 10 to 90 % [s] (infinite if a response does not come to 90 %), the overshoot as a share of
    the step, and the mean error of the last fifth as a share.
    """
    z = response / goal
    tail = max(1, len(z) // 5)
    return {
        "rise_time": rise_times(np.asarray(np.arange(len(z)) * PERIOD, dtype=np.float64), z),
        "overshoot": np.maximum(0.0, z.max(axis=0) - 1.0),
        "settled_error": 1.0 - z[-tail:].mean(axis=0),
    }


def interval(values: Array, level: float) -> tuple[float, float, float]:
    """Return (low, middle, high): a share `level` of `values` (n,) is from low to high, with as many below as above.

    If many values equal the least one, such as an overshoot of 0, low is that value, and all others outside are above.
    """
    out = 1.0 - level
    least = float(values.min())
    bounded = float(np.mean(values == least)) > 0.5 * out
    tails = (0.0 if bounded else 0.5 * out, 0.5, level if bounded else 1.0 - 0.5 * out)
    low, middle, high = (float(v) for v in np.quantile(values, tails, method="nearest"))
    return low, middle, high


def step_bands(flown: Mapping[str, Array], level: float) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Return the bands (low, middle, high), each by channel (steps,), of the responses `flown`, by channel (steps, n).

    Half of the responses give the width of the band at each time, the other half the factor on it that holds them. A
    factor from the same half would be too small for any other response: split conformal, Lei et al., JASA 113-523
    (2018).
    """
    low, middle, high = {}, {}, {}
    for channel, y in flown.items():
        half = y.shape[1] // 2
        centre, spread = y[:, :half].mean(axis=1), y[:, :half].std(axis=1)
        # While all members agree, the band is as wide as the numbers are rounded.
        spread = np.maximum(spread, 1e-4 * float(np.abs(y).max()) + 1e-12)
        most = np.sort((np.abs(y[:, half:] - centre[:, None]) / spread[:, None]).max(axis=0))
        factor = float(most[min(len(most), math.ceil(level * (len(most) + 1))) - 1])
        low[channel], middle[channel], high[channel] = centre - factor * spread, centre, centre + factor * spread
    return low, middle, high
