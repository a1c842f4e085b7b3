"""The Bode plot of a loop: gain and phase, the phase counted as the phase margin counts it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.design.margins import LoopMargins

Array = NDArray[np.float64]

FROM, TO, LEAST = 0.05, 30.0, 100.0
"""The span of frequencies, in crossovers, and the least end [rad/s]."""


class Bode(NamedTuple):
    """At the frequencies `omega` [rad/s] the gain [dB] and the unwrapped phase [rad] of a loop, all (n,)."""

    omega: Array
    gain: Array
    phase: Array


def bode(of: LoopMargins, points: int = 300) -> Bode:
    """The Bode plot around the loop's crossover, up to half the sampling frequency."""
    place = of.crossover if of.phases else 1.0
    end = max(TO * place, LEAST)
    return bode_at(
        of, np.geomspace(FROM * place, end if of.loop.dt is None else min(end, math.pi / of.loop.dt), points)
    )


def bode_at(of: LoopMargins, omega: Array) -> Bode:
    """The Bode plot at the frequencies `omega` [rad/s], rising, (n,).

    The phase at the crossover is -pi plus the phase margin, so that the margin can be read from the plot.
    """
    response = of.loop.response(omega)
    gain = 20.0 * np.log10(np.maximum(np.abs(response), 1e-9))
    phase = np.unwrap(np.angle(response))
    if of.phases:
        there = float(np.interp(of.crossover, omega, phase))
        phase = phase + 2.0 * math.pi * round((of.phase_margin - math.pi - there) / (2.0 * math.pi))
    return Bode(omega, gain, phase)
