"""FittedNoise: gust and gyro noise that have the spectrum of the noise that a fit found."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.signals import PERIOD

Array = NDArray[np.float64]

_LOWEST_HZ = 1.0
"""A noise model of .24 s says nothing of slower noise, and the loop takes it away."""

_TURN = 2.0 * math.pi * PERIOD * np.arange(_LOWEST_HZ, 0.5 / PERIOD, 0.5)
_DELAY = np.exp(-1j * _TURN)
_USUAL_S, _FACTOR, _SAMPLES = 0.15, 2.0, 2000
"""Prior of the gust's correlation time, as in `identify.disturbance.gust`, beside a record of so many samples."""


@dataclass(frozen=True)
class FittedNoise:
    """A gust [rad/s2] of the correlation time `gust_time` [s], and the gyro's noise `q_noise` [rad/s].

    `q_band` is the middle [Hz] of the band of the gyro's noise and the squared radius of its poles, as those of the
    rig's vibration; (0, 0) is white noise.
    """

    gust: float
    gust_time: float
    q_noise: float
    q_band: tuple[float, float]

    @classmethod
    def of_rows(cls, rows: Iterable[Mapping[str, Any]], w_n: float, xi: float) -> Self:
        """Return the noise by autoregressions of q, each with `coefficients` and `sigma`, seen through the pitch.

        Gust, white noise and a band are fitted to the mean spectrum by Whittle's likelihood (1953).
        """
        from scipy.optimize import minimize  # imported late: most commands start without it

        spectra = [
            row["sigma"] ** 2 / np.abs(np.polynomial.polynomial.polyval(_DELAY, row["coefficients"])) ** 2
            for row in rows
        ]
        seen = np.mean(spectra, axis=0)
        size = float(seen.mean())
        omega = _TURN / PERIOD
        through = omega**2 / ((w_n**2 - omega**2) ** 2 + (2.0 * xi * w_n * omega) ** 2)

        def parts(theta: Array) -> tuple[Array, Array, Array]:
            time = math.exp(theta[1])
            gust = np.exp(theta[0]) * through * 2.0 * time / (1.0 + (omega * time) ** 2) / PERIOD
            return gust, np.full_like(omega, math.exp(theta[2])), math.exp(theta[3]) * _band(theta[4], theta[5])

        def cost(theta: Array) -> float:
            spectrum = sum(parts(theta)) * size
            prior = ((theta[1] - math.log(_USUAL_S)) / math.log(_FACTOR)) ** 2 / _SAMPLES
            return float(np.mean(np.log(spectrum) + seen / spectrum) + prior)

        fast = _TURN > 0.3
        peak = float(_TURN[fast][seen[fast].argmax()])
        floor = math.log(float(seen[fast].mean()) / size)
        bounds = ((-30.0, 30.0), (math.log(0.01), math.log(3.0)), (-15.0, 5.0), (-15.0, 5.0), (0.3, 2.8), (0.1, 0.98))
        guesses = [
            np.array([math.log(gust / size), math.log(_USUAL_S), floor - 2.0, floor, peak, 0.6])
            for gust in (1e-4, 0.1, 2.0)
        ]
        found = min((minimize(cost, x, method="L-BFGS-B", bounds=bounds) for x in guesses), key=lambda one: one.fun)
        push, white, narrow = np.sqrt(np.exp(found.x[[0, 2, 3]]) * size).tolist()
        time, hertz = math.exp(found.x[1]), float(found.x[4]) / (2.0 * math.pi * PERIOD)
        return cls.of_parts(push, time, white, narrow, hertz, float(found.x[5]))

    @classmethod
    def of_parts(
        cls, gust: float, gust_time: float, white: float, narrow: float, frequency: float, radius2: float
    ) -> Self:
        """Return the noise with the gyro's `white` and `narrow` parts taken together, in the colour of the larger."""
        band = (frequency, radius2) if narrow > white and radius2 > 0.0 else (0.0, 0.0)
        return cls(gust, gust_time, math.hypot(white, narrow), band)


def _band(turn: float, radius2: float) -> Array:
    """Return the spectrum of noise of variance 1 through the band-pass of the rig's vibration (`rig.sensors`)."""
    poles = 1.0 - (1.0 + radius2) * math.cos(turn) * _DELAY + radius2 * _DELAY**2
    return np.asarray(0.5 * (1.0 - radius2) * np.abs(1.0 - _DELAY**2) ** 2 / np.abs(poles) ** 2)
