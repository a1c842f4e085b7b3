"""Nonlinear least squares within bounds: scipy's search, and whether its end is a minimum."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Residual = Callable[[Array], Array]
Jacobian = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class LeastSquaresMinimum:
    """End of a search: `cost` is half the sum of squares, `at_bound` marks the unknowns held by a bound."""

    x: Array
    residual: Array
    cost: float
    iterations: int
    converged: bool
    at_bound: NDArray[np.bool_]


class _NoDirectionError(Exception):
    """A Jacobian with NaN or infinity, from which no step follows."""


# A trial too far out may overflow; its residual is then not finite, and the search takes a shorter step.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def minimise(
    residual: Residual,
    jacobian: Jacobian,
    x0: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-10,
    iterations: int = 200,
) -> LeastSquaresMinimum:
    """Minimise |residual(x)|^2 / 2 for lower <= x <= upper, from `x0` (clipped into the bounds).

    `jacobian(x, r)` gets the residual at x too. The search is scipy's `least_squares` (dogleg steps in a box). It
    ends when a step lowers the cost by less than a share of `tolerance`, or after `iterations` evaluations. `converged`
    says that a further Gauss-Newton step would move the estimate by less than a twentieth of its standard deviation. A
    residual that is not finite at `x0` is returned as it is, not converged; so is the best x before a Jacobian that is
    not finite.
    """
    from scipy.optimize import least_squares  # imported late: most commands start without it

    x = np.clip(x0, lower, upper)
    last = x.copy(), residual(x)
    best, r = last
    count = 0
    if not np.isfinite(r).all():
        return LeastSquaresMinimum(x, r, math.inf, 0, False, np.zeros(x.shape, dtype=bool))

    def errors(trial: Array) -> Array:
        nonlocal last, count
        if not np.array_equal(trial, last[0]):
            last, count = (trial.copy(), residual(trial)), count + 1
        return last[1]

    def slopes(at: Array) -> Array:
        nonlocal best, r
        best, r = at.copy(), errors(at)
        found = jacobian(best, r)
        if not np.isfinite(found).all():
            raise _NoDirectionError
        return found

    options = {"method": "dogbox", "x_scale": "jac", "ftol": tolerance, "xtol": 1e-14, "gtol": None}
    try:
        found = least_squares(errors, x, slopes, (lower, upper), max_nfev=iterations, **options)
    except _NoDirectionError:
        return LeastSquaresMinimum(best, r, 0.5 * float(r @ r), count, False, np.zeros(x.shape, dtype=bool))
    gradient = found.jac.T @ found.fun
    held = ((found.x <= lower) & (gradient > 0.0)) | ((found.x >= upper) & (gradient < 0.0))
    converged = _converged(found.fun, found.cost, gradient[~held], found.jac[:, ~held])
    return LeastSquaresMinimum(found.x, found.fun, float(found.cost), found.nfev, converged, held)


def _converged(r: Array, cost: float, gradient: Array, jacobian: Array) -> bool:
    """Return True if the next Gauss-Newton step is shorter than a twentieth of the estimate's standard deviation."""
    length = np.linalg.norm(jacobian, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    unit = jacobian / length
    slope = gradient / length
    reach = float(slope @ np.linalg.pinv(unit.T @ unit, rcond=1e-12, hermitian=True) @ slope)
    shift = math.sqrt(max(reach, 0.0) * r.size / (2.0 * cost)) if cost > 0.0 else 0.0
    # Residuals of rounding errors alone have no standard deviation worth comparing with.
    return cost < 1e-16 * r.size or shift < 0.05
