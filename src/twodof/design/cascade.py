"""The cascade of the pitch from the inside out, rate PID and attitude P: by crossover, or by weights."""

import cmath
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.design.closed_loop_poles import refined_roots
from twodof.design.loop_transfer import LoopTransfer
from twodof.design.margins import PhaseCrossing
from twodof.design.pid import PidGains, pid_at, shaped_pid
from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import PitchLoop
from twodof.design.sampled_controller import SampledController
from twodof.design.specification import Specification
from twodof.design.structured_hinf import System, structured_hinf
from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT, Gains
from twodof.models.lti import DelayedStateSpace
from twodof.models.plant import PitchRate
from twodof.signals import PERIOD

Array = NDArray[np.float64]

SEPARATION = 5.0
"""The attitude loop crosses over at this part of the rate loop's crossover."""

_THETA, _Q = 0, 1


@dataclass(frozen=True)
class CascadeDesign:
    """Gains of the cascade, with the crossover [rad/s] and the phase margin [rad] that each gives, by loop name.

    The figures are those of the sampled loops, each with the loops inside it closed.
    """

    gains: Gains
    crossovers: Mapping[str, float]
    phase_margins: Mapping[str, float]

    @classmethod
    def of(cls, pitch: PitchRate, gains: Gains, lag: float = 0.0, asked: Mapping[str, float] | None = None) -> Self:
        """Return `gains` with the figures of their rate and attitude loops, each where |L| falls through 1.

        Of several such frequencies the nearest to `asked` [rad/s] counts; by default that is a rough crossover by the
        gains. Both figures of a loop are NaN if |L| falls through 1 nowhere within a factor of 4. `lag` [s] is that of
        the rotors.
        """
        asked = asked or {"rate": max(1.0, gains.rate[0] * pitch.mu), "attitude": max(0.2, gains.attitude)}
        loops, rate = CascadeLoops(pitch, lag), PidGains(*gains.rate)
        found = {
            "rate": _crossing(lambda w: loops.rate(rate, w), asked["rate"]),
            "attitude": _crossing(lambda w: gains.attitude * loops.theta_by_q0(rate, w), asked["attitude"]),
        }
        phases = {name: one.phase for name, one in found.items()}
        return cls(gains, {name: one.omega for name, one in found.items()}, phases)

    def to_json(self) -> dict[str, Any]:
        """Return the gains and figures as plain data."""
        return {
            "gains": self.gains.to_json(),
            "crossovers": dict(self.crossovers),
            "phase_margins": dict(self.phase_margins),
        }


class CascadeLoops:
    """The loops of the cascade over `pitch` (a dead time is in it) behind the rotors' `lag` [s]."""

    def __init__(self, pitch: PitchRate, lag: float = 0.0) -> None:
        plant = _with_lag(pitch, lag).zero_order_hold(PERIOD)
        self.theta, self.q = LoopTransfer.of(plant, to=_THETA), LoopTransfer.of(plant, to=_Q)

    def rate(self, gains: PidGains, omega: float) -> complex:
        """Return L of the rate loop at `omega` [rad/s]."""
        return complex((gains.response(omega) * self.q.response(omega))[0])

    def theta_by_q0(self, gains: PidGains, omega: float) -> complex:
        """Return the response of the published theta, one sample old, to the set-point of q, the rate loop closed."""
        theta = complex((gains.response(omega) * self.theta.response(omega))[0])
        return theta / (1.0 + self.rate(gains, omega)) * cmath.exp(-1j * omega * PERIOD)


def cascade_design(
    pitch: PitchRate,
    crossover: float,
    *,
    phase_margin: float | None = None,
    lag: float = 0.0,
    separation: float = SEPARATION,
    kept: Gains = DEFAULT,
) -> CascadeDesign:
    """Return gains of the cascade for a `crossover` of the rate loop [rad/s].

    With `phase_margin` [rad] the rate PID meets both figures exactly. Without, it is `shaped_pid`: mu / s with its gain
    alone crosses over there, the loop some 15 % higher, and its margin follows. The attitude loop crosses over at
    `crossover` / `separation`. `lag` [s] is that of the rotors, in addition to the delay of `pitch`. The gains of the
    loops along the rail are those of `kept`. Raises ParameterError if no gains meet a figure, and for gains that the
    drone refuses.
    """
    if not 1.0 < separation < 1e3:
        raise ParameterError(f"a separation of {separation!r} is out of range", "cascade", "give 3 to 10; 5 is usual")
    loops = CascadeLoops(pitch, lag)
    if phase_margin is None:
        rate = shaped_pid(pitch.mu, crossover)
    else:
        rate = pid_at(complex(loops.q.response(crossover)[0]), crossover, phase_margin, "PID")
    first = crossover / separation
    attitude = pid_at(loops.theta_by_q0(rate, first), first, form="P").kp
    gains = replace(kept, rate=(rate.kp, rate.ki, rate.kd), attitude=attitude)
    return CascadeDesign.of(pitch, gains, lag, {"rate": crossover, "attitude": first})


def _crossing(around: Callable[[float], complex], near: float) -> PhaseCrossing:
    """Return where |L| falls through 1, nearest to `near` [rad/s] and within a factor of 4; NaN if it does not."""

    def above(omega: float) -> float:
        return math.log(abs(around(omega)) or 1e-300)

    grid = np.geomspace(near / 4.0, min(4.0 * near, 0.999 * math.pi / PERIOD), 200)
    roots = refined_roots(above, grid, np.array([above(omega) for omega in grid]))
    falling = [omega for omega in roots if above(1.0001 * omega) < 0.0]
    if not falling:
        return PhaseCrossing(math.nan, math.nan)
    omega = min(falling, key=lambda one: abs(math.log(one / near)))
    return PhaseCrossing(math.remainder(math.pi + cmath.phase(around(omega)), 2.0 * math.pi), omega)


def _with_lag(pitch: PitchRate, lag: float) -> DelayedStateSpace:
    """Return the pitch behind the rotors' first-order lag; outputs theta and q."""
    plain = pitch.state_space()
    if lag == 0.0:
        return plain
    if not 0.0 < lag < 10.0:
        raise ParameterError(f"a lag of {lag!r} s is out of range", "cascade", "give 0 to 10 s")
    a = np.zeros((3, 3))
    a[:2, :2], a[:2, 2], a[2, 2] = plain.a, plain.b[:, 0], -1.0 / lag
    return DelayedStateSpace.of(a, [0.0, 0.0, 1.0 / lag], np.eye(2, 3), [[0.0], [0.0]], pitch.tau)


LOW, HIGH = np.array([0.0, 0.0, 0.0, 0.1]), np.array([0.12, 0.5, 0.003, 15.0])
"""Bounds of the drone on Kp, Ki, Kd and the attitude's Kp."""

BANDWIDTH, SENSITIVITY, MOMENT = 5.0, 2.0, 2.0
"""Defaults of a specification: bandwidth [rad/s], the largest |S|, and the largest |M| per radian of a step."""

_CROSSOVERS = (14.0, 24.0)
_FLAT = 1e-3  # of |S| at low frequency, in the weight
_OVERSHOOT = 1.25  # the peak of theta - theta_0 that the weight allows at high frequency


@dataclass(frozen=True, eq=False)
class HinfCascade:
    """Gains and their weighted H-infinity `norm`, with its peak at `omega` [rad/s]; up to 1 it keeps every weight."""

    gains: Gains
    norm: float
    omega: float


def cascade_hinf(
    family: PitchFamily,
    specification: Specification,
    kept: Gains = DEFAULT,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> HinfCascade:
    """Minimise the largest of three weighted responses of the family's estimate, sampled as it flies.

    The responses are the error theta_0 - theta over its weight of `bandwidth`, M per theta_0 over `peak_moment` of the
    step, and the sensitivity at M over `peak_sensitivity`. The starts are the course's rule at several crossovers. The
    outer gains are those of `kept`. Raises ParameterError where no gains that the drone takes stabilise the estimate.
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
    found = structured_hinf(closed, starts, PERIOD, LOW, HIGH, seed, progress)
    kp, ki, kd, attitude = (float(x) for x in found.gains)
    return HinfCascade(replace(kept, rate=(kp, ki, kd), attitude=attitude), found.norm, found.omega)


def weighted_cascade(family: PitchFamily, specification: Specification) -> Callable[[Array], tuple[System, System]]:
    """Return a function from the gains (Kp, Ki, Kd, the attitude's Kp) to two weighted closed loops at 250 Hz.

    The input of the first loop is theta_0, that of the second a moment added to M.
    """
    wanted = BANDWIDTH if specification.bandwidth is None else specification.bandwidth
    peak = SENSITIVITY if specification.peak_sensitivity is None else specification.peak_sensitivity
    step = math.radians(specification.step_deg)
    moment = MOMENT if specification.peak_moment is None else specification.peak_moment / step
    nominal = PitchLoop(family.nominal(), SampledController.of_cascade(*HIGH))
    aw, bw, cw, dw = _error_weight(wanted)

    def closed(x: Array) -> tuple[System, System]:
        a, b, c, d = nominal.under(SampledController.of_cascade(*x)).closed_with_moment_input()
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
