"""Poles of a closed loop, the roots of 1 + L = 0, also with a continuous delay; the motion of the worst pole."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.design.loop_transfer import LoopTransfer
from twodof.errors import ParameterError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_ROUNDING, _HIDDEN = 1e-11, 1e-6
"""How near to the border of stability, as a share of the sample rate or of the fastest pole, a pole is on it: one that
the feedback moves, and one that it may not. A double pole at z = 1 is found to half of the digits only."""

_NODES = 24
_MOST_NODES = 250


@dataclass(frozen=True)
class Motion:
    """Motion of a pole: it swings at `omega` [rad/s] (0: it does not swing) and grows as exp(`growth` t) [1/s]."""

    omega: float
    growth: float

    @property
    def text(self) -> str:
        """Description in words: "swings at 31 rad/s, growing"."""
        way = "growing" if self.growth > 0.0 else "dying out" if self.growth < 0.0 else "for ever"
        if self.omega == 0.0:
            return f"runs away, {way} by a factor e in {1.0 / self.growth:.2g} s" if self.growth > 0.0 else way
        return f"swings at {self.omega:.3g} rad/s, {way}"


def closed_loop_poles(loop: LoopTransfer) -> Complex:
    """Return the poles of the closed loop in the z plane or in rad/s: shape (k,), the least stable first.

    A continuous loop with a delay has infinitely many poles, of which the rightmost ones are returned. They come from
    Chebyshev collocation of the delay line, refined by Newton's method. Source: Breda, Maset and Vermiglio, Stability
    of Linear Delay Differential Equations, 2015, ch. 5. Raises ParameterError if 1 + D is 0: an ill-posed loop.
    """
    k = feedback_gain(loop)
    if not loop.delay:
        poles = np.linalg.eigvals(loop.a - k * loop.b @ loop.c)
        key = poles.real if loop.dt is None else np.abs(poles)
        return np.asarray(poles[np.argsort(-key)], dtype=np.complex128)
    return _delayed(loop)


def feedback_gain(loop: LoopTransfer) -> float:
    """Return 1 / (1 + D) of a loop with the direct path D. Raises ParameterError if D is -1."""
    if abs(1.0 + loop.d) < 1e-12:
        raise ParameterError(
            "its direct path is -1: the loop is not well posed", "closed loop", "put a delay or a lag into the loop"
        )
    return 1.0 / (1.0 + loop.d)


def worst_motion(loop: LoopTransfer, poles: Complex) -> Motion | None:
    """Return the motion of the least stable pole among those that the feedback moves; None if it moves none.

    The feedback does not move a pole on the border of stability that the open loop has too, such as that of an
    estimator's bias: the loop does not observe its state, or does not reach it. Each pole of the open loop accounts
    for one such pole.
    """
    s = logarithms(poles, loop.dt)
    fast = 1.0 / loop.dt if loop.dt else max(1.0, float(np.abs(poles).max(initial=0.0)))
    fixed = loop.poles()
    for growth, place, pole in sorted(zip(s.real, s, poles, strict=True), key=lambda row: -row[0]):
        if abs(growth) <= _HIDDEN * fast and fixed.size:
            nearest = int(np.abs(fixed - pole).argmin())
            if abs(fixed[nearest] - pole) < _HIDDEN * max(1.0, abs(pole)):
                fixed = np.delete(fixed, nearest)
                continue
        swing = abs(float(place.imag))
        swing = swing if swing > _HIDDEN * fast else 0.0
        return Motion(swing, float(growth) if abs(growth) > _ROUNDING * fast else 0.0)
    return None


def logarithms(poles: Complex, dt: float | None) -> Complex:
    """Return poles in rad/s: log(z) / dt for a sample time `dt` [s], where z = 0 gives -inf; unchanged for None."""
    if dt is None:
        return poles
    found = np.full(poles.shape, -np.inf, np.complex128)
    slow = np.abs(poles) > 0.0
    found[slow] = np.log(poles[slow].astype(np.complex128)) / dt
    return found


def _delayed(loop: LoopTransfer) -> Complex:
    """Of x' = A x - B w, w the value that y = C x had `delay` ago: the delay line's values at Chebyshev nodes."""
    n = len(loop.a)
    # Poles right of the axis are where |L| > 1: no faster than this bound.
    fast = np.linalg.norm(loop.a, 2) + np.linalg.norm(loop.b) * np.linalg.norm(loop.c)
    nodes = min(_MOST_NODES, int(_NODES + 1.5 * loop.delay * float(fast)))
    x = np.cos(np.pi * np.arange(nodes + 1) / nodes)  # 1: now; -1: `delay` ago
    weight = np.hstack([2.0, np.ones(nodes - 1), 2.0]) * (-1.0) ** np.arange(nodes + 1)
    apart = x[:, None] - x[None, :] + np.eye(nodes + 1)
    slope = np.outer(weight, 1.0 / weight) / apart
    slope -= np.diag(slope.sum(axis=1))
    slope *= 2.0 / loop.delay
    whole = np.zeros((n + nodes, n + nodes))
    whole[:n, :n] = loop.a
    whole[:n, -1:] = -loop.b
    whole[n:, :n] = slope[1:, :1] @ loop.c
    whole[n:, n:] = slope[1:, 1:]
    poles = np.linalg.eigvals(whole).astype(np.complex128)
    right = -4.0 / loop.delay  # those further to the left are not resolved, nor do they matter
    close = poles[poles.real > max(right, float(np.sort(poles.real)[-min(poles.size, n + 8)]))]
    refined = np.array([_newton(loop, s) for s in close], dtype=np.complex128)
    return np.asarray(refined[np.argsort(-refined.real)])


def _newton(loop: LoopTransfer, s: complex) -> complex:
    """Return the root of det(s - A + B C exp(-s delay)) near `s`; `s` itself if the search comes no nearer."""
    at = s
    for _ in range(12):
        decay = np.exp(-at * loop.delay)
        matrix = at * np.eye(len(loop.a)) - loop.a + loop.b @ loop.c * decay
        change = np.eye(len(loop.a)) - loop.delay * decay * loop.b @ loop.c
        try:
            trace = complex(np.trace(np.linalg.solve(matrix, change)))
        except np.linalg.LinAlgError:
            return at
        if not math.isfinite(abs(trace)) or trace == 0.0:
            return at
        step = 1.0 / trace
        at = at - step
        if abs(at - s) > 1e-2 * max(1.0, abs(s)):
            return s
        if abs(step) < 1e-14 * max(1.0, abs(at)):
            break
    return at


MAX_GAINS = 5000


def root_locus(loop: LoopTransfer, gains: ArrayLike) -> Complex:
    """Return the closed loop's poles for each factor in `gains` on L, shape (k, n): column j follows one pole.

    The poles are in the z plane, or in rad/s. Each is matched with the nearest pole at the gain before. Raises
    ParameterError for no gains, a gain that is not finite, more than `MAX_GAINS`, and a continuous loop with a delay.
    """
    from scipy.optimize import linear_sum_assignment  # imported late: most commands start without it

    factors = np.atleast_1d(np.asarray(gains, dtype=float))
    if factors.ndim != 1 or not 0 < factors.size <= MAX_GAINS or not np.isfinite(factors).all():
        raise ParameterError(
            f"gains of shape {factors.shape} are not 1 to {MAX_GAINS} finite numbers", "root_locus", "give a list"
        )
    if loop.delay:
        raise ParameterError(
            "a loop with a continuous delay has infinitely many poles", "root_locus", "sample it with zero_order_hold"
        )
    found = np.empty((factors.size, len(loop.a)), np.complex128)
    for k, factor in enumerate(factors):
        poles = closed_loop_poles(loop.scaled(float(factor)))
        if k:
            _, order = linear_sum_assignment(np.abs(found[k - 1][:, None] - poles[None, :]))
            poles = poles[order]
        found[k] = poles
    return found
