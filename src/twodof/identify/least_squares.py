"""Nonlinear least squares within bounds by Levenberg-Marquardt.

scipy's `least_squares` ends short of the minimum on the real free response with dry friction, whose cost has kinks:
with "dogbox", with "trf", and with one after the other, a Gauss-Newton step of 23 standard deviations is left.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Residual = Callable[[Array], Array]
Jacobian = Callable[[Array, Array], Array]

_OFF = 0.2
"""Share by which a step must be too long or too short to be tried again with another length."""


@dataclass(frozen=True, eq=False)
class LeastSquaresMinimum:
    """End of a search: `cost` is half the sum of squares, `at_bound` marks the unknowns held by a bound."""

    x: Array
    residual: Array
    cost: float
    iterations: int
    converged: bool
    at_bound: NDArray[np.bool_]


# A trial too far out may overflow; its cost is then infinite or NaN, and it is stepped back from.
@np.errstate(over="ignore", invalid="ignore")
def minimise(
    residual: Residual,
    jacobian: Jacobian,
    x0: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-10,
    iterations: int = 100,
) -> LeastSquaresMinimum:
    """Minimise |residual(x)|^2 / 2 for lower <= x <= upper, from `x0` (clipped into the bounds).

    Damping after Nielsen (1999) with More's (1978) column scaling; an unknown at a bound that the gradient pushes
    outwards is held there. Where residuals are large and bend, Gauss-Newton steps are up to twice too long, and the
    search would swing about the minimum for tens of steps: a parabola mends their length. It ends when the next step
    promises a relative decrease below `tolerance`, when the steps have become too small to change x, or after
    `iterations`. `converged` says that a further Gauss-Newton step would
    move the estimate by less than a twentieth of its standard deviation, however the search ended. A residual that is
    not finite at `x0` is returned as it is, not converged; so is the best x so far whose Jacobian is not finite.
    """
    x = np.clip(x0, lower, upper)
    r = residual(x)
    cost = 0.5 * float(r @ r)
    if not math.isfinite(cost):
        return LeastSquaresMinimum(x, r, cost, 0, False, np.zeros(x.shape, dtype=bool))
    damping, growth = 1e-3, 2.0
    scale = np.zeros_like(x)
    held = np.zeros(x.shape, dtype=bool)
    for iteration in range(1, iterations + 1):
        jac = jacobian(x, r)
        gradient = jac.T @ r
        normal = jac.T @ jac
        if not np.isfinite(normal).all():  # no direction to go on
            return LeastSquaresMinimum(x, r, cost, iteration, False, held)
        held = ((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0))
        free = np.flatnonzero(~held)
        scale = np.maximum(scale, np.sqrt(normal.diagonal()))
        squares = np.where(scale > 0.0, scale, 1.0) ** 2
        while True:
            step, clipped = _bounded_step(normal, gradient, damping * squares, free, lower - x, upper - x)
            trial = np.minimum(np.maximum(x + step, lower), upper)
            promised = -float(gradient @ step) - 0.5 * float(step @ normal @ step)
            small = bool((np.abs(step) <= 1e-14 * (np.abs(x) + 1e-14)).all())
            # A step cut by a bound may promise nothing although a shorter one would.
            if small or (promised <= tolerance * cost and not clipped):
                converged = _converged(r, cost, gradient, normal, free)
                return LeastSquaresMinimum(x, r, cost, iteration, converged, held)
            r_trial = residual(trial)
            cost_trial = 0.5 * float(r_trial @ r_trial)
            gain = (cost - cost_trial) / promised if promised > 0.0 else -1.0
            share = _parabola(float(gradient @ step), cost_trial - cost)
            if abs(share - 1.0) > _OFF:
                nearer = np.minimum(np.maximum(x + share * step, lower), upper)
                r_nearer = residual(nearer)
                cost_nearer = 0.5 * float(r_nearer @ r_nearer)
                if cost_nearer < min(cost_trial, cost):
                    trial, r_trial, cost_trial = nearer, r_nearer, cost_nearer
                    gain = max(gain, 0.5)
            if gain > 1e-4:
                x, r, cost = trial, r_trial, cost_trial
                damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
                damping, growth = max(damping, 1e-12), 2.0
                break
            damping *= growth
            growth *= 2.0
    jac = jacobian(x, r)
    free = np.flatnonzero(~held)
    return LeastSquaresMinimum(x, r, cost, iterations, _converged(r, cost, jac.T @ r, jac.T @ jac, free), held)


def _parabola(slope: float, change: float) -> float:
    """Return where the parabola of this `slope` at 0 that has changed by `change` at 1 is least, within .1 to 4."""
    bend = change - slope
    return min(max(-slope / (2.0 * bend), 0.1), 4.0) if bend > 0.0 else 1.0


def _bounded_step(
    normal: Array, gradient: Array, damping: Array, free: NDArray[np.int64], low: Array, high: Array
) -> tuple[Array, bool]:
    """Return the damped Gauss-Newton step of the `free` unknowns within [low, high], and whether a bound cut it.

    An unknown that would cross its bound goes to it, and the others are solved for again, given that.
    """
    step = np.zeros_like(gradient)
    open_ = free
    while open_.size:
        system = normal[np.ix_(open_, open_)] + np.diag(damping[open_])
        cut = np.setdiff1d(free, open_, assume_unique=True)
        target = -gradient[open_] - normal[np.ix_(open_, cut)] @ step[cut]
        step[open_] = np.linalg.solve(system, target)
        crossing = (step[open_] < low[open_]) | (step[open_] > high[open_])
        if not crossing.any():
            break
        crossed = open_[crossing]
        step[crossed] = np.clip(step[crossed], low[crossed], high[crossed])
        open_ = open_[~crossing]
    return step, open_.size < free.size


def _converged(r: Array, cost: float, gradient: Array, normal: Array, free: NDArray[np.int64]) -> bool:
    """Return True if the next Gauss-Newton step is shorter than a twentieth of the estimate's standard deviation."""
    if not np.isfinite(normal).all():
        return False
    g = gradient[free]
    length = np.sqrt(np.diag(normal)[free])
    length = np.where(length > 0.0, length, 1.0)
    unit = normal[np.ix_(free, free)] / np.outer(length, length)
    reach = float((g / length) @ np.linalg.pinv(unit, rcond=1e-12, hermitian=True) @ (g / length))
    shift = math.sqrt(max(reach, 0.0) * r.size / (2.0 * cost)) if cost > 0.0 else 0.0
    # Residuals of rounding errors alone have no standard deviation worth comparing with.
    exact = cost < 1e-16 * r.size
    return exact or shift < 0.05
