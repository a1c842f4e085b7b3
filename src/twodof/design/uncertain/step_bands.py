"""Bands that hold a share of responses for their whole time."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def step_bands(flown: Mapping[str, Array], level: float) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """(low, middle, high) by channel, each (steps,), of the responses `flown`, (steps, n) of each channel.

    Half of the responses say how wide the band is at each time, the others how many times that holds them. Of the same
    responses the band would be too narrow for any other. See Lei et al., JASA 113-523 (2018): split conformal.
    """
    low, middle, high = {}, {}, {}
    for channel, y in flown.items():
        half = y.shape[1] // 2
        centre, spread = y[:, :half].mean(axis=1), y[:, :half].std(axis=1)
        # Where all members still agree the band is as wide as the numbers are rounded.
        spread = np.maximum(spread, 1e-4 * float(np.abs(y).max()) + 1e-12)
        most = np.sort((np.abs(y[:, half:] - centre[:, None]) / spread[:, None]).max(axis=0))
        factor = float(most[min(len(most), math.ceil(level * (len(most) + 1))) - 1])
        low[channel], middle[channel], high[channel] = centre - factor * spread, centre, centre + factor * spread
    return low, middle, high
