"""The cascade by structured H-infinity: Kp, Ki, Kd and the attitude's Kp that meet a specification best."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twodof.design.synthesis.cascade import cascade_design
from twodof.design.synthesis.specification import Specification
from twodof.design.synthesis.structured_hinf import System, structured_hinf
from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.pitch_loop import PitchLoop
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT, Gains
from twodof.models.plant import PitchRate
from twodof.signals import PERIOD

Array = NDArray[np.float64]

LOW, HIGH = np.array([0.0, 0.0, 0.0, 0.1]), np.array([0.12, 0.5, 0.003, 15.0])
"""What the drone takes for Kp, Ki, Kd and the attitude's Kp."""

BANDWIDTH, SENSITIVITY, MOMENT = 5.0, 2.0, 2.0
"""Where a specification does not say: [rad/s], the largest |S|, and the largest |M| per radian of a step."""

_CROSSOVERS = (14.0, 24.0)
_FLAT = 1e-3  # of |S| at low frequency, in the weight
_OVERSHOOT = 1.25  # the peak of theta - theta_0 that the weight allows at high frequency


@dataclass(frozen=True, eq=False)
class HinfCascade:
    """`gains` and the weighted `norm`: at most 1 where every weight is kept. `norms` are those of each start."""

    gains: Gains
    norm: float
    omega: float
    norms: tuple[float, ...]


def cascade_hinf(
    family: PitchFamily,
    specification: Specification,
    kept: Gains = DEFAULT,
    seed: int = 1,
    said: Callable[[float], None] = lambda share: None,
) -> HinfCascade:
    """Minimise the largest of three weighted responses of the family's estimate, sampled as it flies:

    the error theta_0 - theta over its weight of `bandwidth`; M per theta_0 over `peak_moment` of the step; and the
    sensitivity at M over `peak_sensitivity`. The starts are the course's rule at several crossovers. The outer gains
    are those of `kept`. Raises ParameterError where no gains that the drone takes stabilise the estimate.
    """
    closed = weighted_cascade(family, specification)
    v = family.values
    plant = PitchRate(v["w_n"], v["xi"], v["mu"], v["dead_time"])
    starts = []
    for crossover in _CROSSOVERS:
        try:
            gains = cascade_design(plant, crossover, lag=v["lag"], kept=kept).gains
        except ParameterError:
            continue
        starts.append(np.array([*gains.rate, gains.attitude]))
    found = structured_hinf(closed, starts, PERIOD, LOW, HIGH, seed, said)
    kp, ki, kd, attitude = (float(x) for x in found.gains)
    return HinfCascade(replace(kept, rate=(kp, ki, kd), attitude=attitude), found.norm, found.omega, found.norms)


def weighted_cascade(family: PitchFamily, specification: Specification) -> Callable[[Array], tuple[System, System]]:
    """The weighted closed loops, from theta_0 and from a moment added to M, at 250 Hz.

    They are functions of the gains (Kp, Ki, Kd, the attitude's Kp).
    """
    wanted = BANDWIDTH if specification.bandwidth is None else specification.bandwidth
    peak = SENSITIVITY if specification.peak_sensitivity is None else specification.peak_sensitivity
    step = math.radians(specification.step_deg)
    moment = MOMENT if specification.peak_moment is None else specification.peak_moment / step
    nominal = PitchLoop(family.nominal(), SampledController.of_cascade(*HIGH))
    aw, bw, cw, dw = _error_weight(wanted)

    def closed(x: Array) -> tuple[System, System]:
        a, b, c, d = nominal.under(SampledController.of_cascade(*x)).broken()
        m = len(a)
        # theta_0 -> (weighted error, M): the weight's state is the last one.
        wide = np.zeros((m + 1, m + 1))
        wide[:m, :m], wide[m, :m], wide[m, m] = a, -bw * c[0], aw
        drive = np.append(b[:, 0], bw * (1.0 - d[0, 0]))[:, None]
        out = np.array([[*(-dw * c[0]), cw], [*(c[1] / moment), 0.0]])
        through = np.array([[dw * (1.0 - d[0, 0])], [d[1, 0] / moment]])
        sensitivity = (a, b[:, 1:], c[1:] / peak, np.array([[(1.0 + d[1, 1]) / peak]]))
        return (wide, drive, out, through), sensitivity

    return closed


def _error_weight(bandwidth: float) -> tuple[float, float, float, float]:
    """(s / M + w) / (s + w flat) at 250 Hz by the bilinear map (Skogestad and Postlethwaite, equation 2.105)."""
    # The error of a loop with bandwidth w is about |s / (s + w)|: below w / 1.25 the weight is above 1.
    w = bandwidth / 1.25
    k = 2.0 / PERIOD
    pole = (k - w * _FLAT) / (k + w * _FLAT)
    first, last = (k / _OVERSHOOT + w) / (k + w * _FLAT), (w - k / _OVERSHOOT) / (k + w * _FLAT)
    return pole, 1.0, last + first * pole, first
