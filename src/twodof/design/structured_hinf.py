"""Structured H-infinity: the gains of a fixed structure that make the largest weighted response smallest.

The norm is not convex in the gains and has kinks where two peaks are alike. The search goes from several starts. First
it stabilises the least stable pole. Then BFGS with a weak Wolfe search lowers the norm; this search copes with kinks
(Lewis and Overton, Nonsmooth optimization via quasi-Newton methods, 2013). Gradients at points around the end then
show whether it is a minimum: the shortest vector in their hull is a direction of descent, or nearly zero. This is the
gradient sampling of Burke, Lewis and Overton (2005). The problem is that of Apkarian and Noll (2006) and of systune.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ParameterError
from twodof.models.lti import check_system, transfer

Array = NDArray[np.float64]
System = tuple[Array, Array, Array, Array]
"""(A, B, C, D)."""
ClosedLoop = Callable[[Array], Sequence[System]]
"""Function from the gains (k,) to the weighted closed loop: one or more systems, of which the largest norm counts."""

STARTS = 6
_ITERATIONS = 120
_AGAIN = 4
_SEARCHES = 24
_RADII = (1e-2, 1e-3, 1e-4)
_SAMPLED = 4  # rounds at each radius
_INSIDE = 1e-9
_DIFFERENCE = 1e-6  # of a gain, for slopes of the closed loop's matrices
_MOST_GAINS = 60


@dataclass(frozen=True, eq=False)
class StructuredHinf:
    """The `gains` (k,) and their `norm`, met at `omega` [rad/s].

    `norms` has the norm reached from each start, the best first: if several agree, it is hardly a local minimum.
    """

    gains: Array
    norm: float
    omega: float
    norms: tuple[float, ...]


def structured_hinf(
    closed: ClosedLoop,
    starts: Sequence[Array],
    dt: float | None = None,
    low: Array | None = None,
    high: Array | None = None,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> StructuredHinf:
    """Return the gains that minimise the H-infinity norm of `closed`, each from `low` to `high` (None: unbounded).

    The search is scaled by the first start's gains. `dt` [s] is the sample time of the loop, None a continuous one.
    `progress` is called with the share done. Raise ParameterError for starts that do not fit, and if no start leads
    to a stable loop.
    """
    points = [np.asarray(start, dtype=float) for start in starts]
    if not points or any(p.ndim != 1 or p.shape != points[0].shape or not np.isfinite(p).all() for p in points):
        raise _error("the starts are not gains (k,) of one length", "give finite numbers")
    k = points[0].size
    if not 1 <= k <= _MOST_GAINS:
        raise _error(f"{k} gains are too few or too many", f"give 1 to {_MOST_GAINS}")
    bottom = np.full(k, -math.inf) if low is None else np.asarray(low, dtype=float)
    top = np.full(k, math.inf) if high is None else np.asarray(high, dtype=float)
    if bottom.shape != (k,) or top.shape != (k,) or not (bottom < top).all():
        raise _error("the bounds do not fit the gains", "give low < high, each (k,)")
    search = _Search(closed, dt, np.where(points[0] != 0.0, np.abs(points[0]), 1.0), bottom, top)
    rng = np.random.default_rng(seed)
    found: list[tuple[float, Array]] = []
    for number, start in enumerate(points):
        progress(number / len(points))
        y = search.stable(np.clip(start, bottom, top) / search.scale, rng)
        if y is not None:
            found.append(search.lowest(y))
    if not found:
        raise _error("no start leads to a stable loop", "give a start that stabilises it, or more starts")
    found.sort(key=lambda one: one[0])
    found[0] = search.polished(*found[0], rng)
    gains = search.gains(found[0][1])
    norm, omega, _ = largest_norm(closed(gains), dt)
    return StructuredHinf(gains, norm, omega, tuple(value for value, _ in found))


def largest_norm(systems: Sequence[System], dt: float | None) -> tuple[float, float, int]:
    """Return (norm, frequency [rad/s], index) of the system with the largest H-infinity norm; infinite if unstable."""
    found = [hinf_norm(*one, dt) for one in systems]
    place = max(range(len(found)), key=lambda i: found[i][0])
    return *found[place], place


class _Search:
    """The norm and its gradient over scaled gains y = gains / scale."""

    def __init__(self, closed: ClosedLoop, dt: float | None, scale: Array, low: Array, high: Array) -> None:
        self.closed, self.dt, self.scale = closed, dt, scale
        self.low, self.high = low / scale, high / scale

    def gains(self, y: Array) -> Array:
        return np.asarray(np.clip(y, self.low, self.high) * self.scale)

    def stable(self, y: Array, rng: np.random.Generator) -> Array | None:
        """Return a stable point, by lowering the least stable pole from `y`; None if that ends unstable."""
        for _ in range(4):
            if self._inside(self.abscissa(y)):
                return y
            y, value = self._descend(y, self.abscissa, self._abscissa_slope, lambda v: self._inside(v))
            if self._inside(value):
                return y
            y = y + 0.3 * rng.standard_normal(y.size)
        return None

    def lowest(self, y: Array) -> tuple[float, Array]:
        """Return (norm, y) that BFGS reaches from the stable `y`, restarted if it has come to a kink."""
        value = math.inf
        for _ in range(_AGAIN):
            y, reached = self._descend(y, self.norm, self._norm_slope, lambda v: False)
            if not reached < value * (1.0 - 1e-5):
                break
            value = reached
        return min(value, reached), np.clip(y, self.low, self.high)

    def polished(self, value: float, y: Array, rng: np.random.Generator) -> tuple[float, Array]:
        """Return (norm, y) after gradient sampling about `y`."""
        for radius in _RADII:
            for _ in range(_SAMPLED):
                around = y + radius * rng.uniform(-1.0, 1.0, (2 * y.size, y.size))
                slopes = [g for point in (y, *around) if (g := self._norm_slope(point)) is not None]
                if not slopes:
                    break
                down = -_shortest(np.array(slopes))
                length = float(np.linalg.norm(down))
                if length < 1e-9:
                    break
                step, better = radius * 4.0, False
                for _ in range(12):
                    trial = y + step * down / length
                    reached = self.norm(trial)
                    if reached < value * (1.0 - 1e-6):
                        y, value, better = trial, reached, True
                        break
                    step *= 0.5
                if not better:
                    break
        return value, np.clip(y, self.low, self.high)

    def norm(self, y: Array) -> float:
        return largest_norm(self.closed(self.gains(y)), self.dt)[0]

    def abscissa(self, y: Array) -> float:
        poles = np.concatenate([np.linalg.eigvals(one[0]) for one in self.closed(self.gains(y))])
        return float(np.abs(poles).max() - 1.0 if self.dt is not None else poles.real.max())

    def _inside(self, value: float) -> bool:
        return value < -_INSIDE

    def _abscissa_slope(self, y: Array) -> Array | None:
        value = self.abscissa(y)
        return np.array([(self.abscissa(y + step) - value) / _DIFFERENCE for step in _DIFFERENCE * np.eye(y.size)])

    def _norm_slope(self, y: Array) -> Array | None:
        """Return the gradient by the singular vectors at the peak; None if unstable or if bounds hold all."""
        systems = self.closed(self.gains(y))
        value, omega, place = largest_norm(systems, self.dt)
        if not math.isfinite(value):
            return None
        left, _, right = np.linalg.svd(self._response(systems[place], omega))
        slope = np.zeros(y.size)
        for i in range(y.size):
            up, down = y.copy(), y.copy()
            up[i], down[i] = y[i] + _DIFFERENCE, y[i] - _DIFFERENCE
            ends = (np.clip(up, self.low, self.high) - np.clip(down, self.low, self.high))[i]
            if ends <= 0.0:
                continue
            ahead, behind = (self._response(self.closed(self.gains(end))[place], omega) for end in (up, down))
            change = ahead - behind
            slope[i] = float((left[:, 0].conj() @ change @ right[0].conj()).real) / ends
        return slope

    def _response(self, matrices: System, omega: float) -> NDArray[np.complex128]:
        if not math.isfinite(omega):
            return matrices[3].astype(np.complex128)
        return np.asarray(transfer(*matrices, 1j * omega if self.dt is None else np.exp(1j * omega * self.dt))[0])

    def _descend(
        self,
        y: Array,
        of: Callable[[Array], float],
        slope_of: Callable[[Array], Array | None],
        enough: Callable[[float], bool],
    ) -> tuple[Array, float]:
        """Minimise by BFGS with a weak Wolfe search by bisection."""
        value, slope = of(y), slope_of(y)
        inverse = np.eye(y.size)
        for _ in range(_ITERATIONS):
            if slope is None or enough(value):
                break
            direction = -inverse @ slope
            fall = float(slope @ direction)
            if fall >= 0.0 or not math.isfinite(fall):
                inverse, direction = np.eye(y.size), -slope
                fall = -float(slope @ slope)
            if fall > -1e-16:
                break
            step, least, most = min(1.0, 1.0 / float(np.linalg.norm(direction))), 0.0, math.inf
            new, reached, fresh = y, value, slope
            for _ in range(_SEARCHES):
                trial = y + step * direction
                seen = of(trial)
                if not seen <= value + 1e-4 * step * fall:
                    most = step
                else:
                    new, reached = trial, seen
                    there = slope_of(trial)
                    if there is None:
                        break
                    fresh = there
                    if float(there @ direction) >= 0.9 * fall:
                        break
                    least = step
                step = 2.0 * step if math.isinf(most) else 0.5 * (least + most)
            if new is y or value - reached < 1e-7 * abs(value):
                y, value = (new, reached) if reached < value else (y, value)
                break
            moved, turned = new - y, fresh - slope
            product = float(moved @ turned)
            if product > 1e-14:
                half = np.eye(y.size) - np.outer(moved, turned) / product
                inverse = half @ inverse @ half.T + np.outer(moved, moved) / product
            y, value, slope = new, reached, fresh
        return y, value


def _shortest(rows: Array) -> Array:
    """Return the shortest vector of the convex hull of the rows, by non-negative least squares."""
    from scipy.optimize import nnls  # imported late: most commands start without it

    # min |w R| with w >= 0 and sum w = 1: a row of large weight asks for the sum.
    heavy = 1e3 * max(1.0, float(np.abs(rows).max()))
    weights, _ = nnls(np.vstack([rows.T, np.full((1, len(rows)), heavy)]), np.append(np.zeros(rows.shape[1]), heavy))
    total = float(weights.sum())
    return np.asarray(weights @ rows / total if total > 0.0 else rows.mean(axis=0))


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "structured_hinf", remedy)


Complex = NDArray[np.complex128]

TOLERANCE = 1e-7
_ROUNDS = 40
_NEAR = 1e-7  # of an eigenvalue to the imaginary axis, as a share of its size


def hinf_norm(a: Array, b: Array, c: Array, d: Array, dt: float | None = None) -> tuple[float, float]:
    """Return norm and peak [rad/s] of C (s - A)^-1 B + D, or with the sample time `dt` [s] of C (z - A)^-1 B + D.

    Shapes (n, n), (n, m), (p, n), (p, m). An unstable system has the norm infinity. The relative error is at most
    `TOLERANCE`. Raises ParameterError for shapes that do not fit and numbers that are not finite.
    """
    check_system(a, b, c, d, "hinf_norm")
    poles = np.linalg.eigvals(a)
    if ((np.abs(poles) >= 1.0) if dt is not None else (poles.real >= 0.0)).any():
        return math.inf, math.nan
    return peak_gain(a, b, c, d, dt)


def peak_gain(a: Array, b: Array, c: Array, d: Array, dt: float | None = None) -> tuple[float, float]:
    """Return the largest singular value over all frequencies, and its frequency [rad/s], of a stable system."""
    if dt is not None:
        # The bilinear map keeps the norm: z = (1 + s) / (1 - s), w = tan(omega dt / 2).
        inverse, root = np.linalg.inv(np.eye(len(a)) + a), math.sqrt(2.0)
        turned = (inverse @ (a - np.eye(len(a))), root * inverse @ b, root * c @ inverse, d - c @ inverse @ b)
        norm, w = peak_gain(*turned)
        return norm, 2.0 * math.atan(w) / dt
    poles = np.linalg.eigvals(a)
    first = np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag)])
    sizes = _sizes(a, b, c, d, first)
    best, place = float(np.linalg.norm(d, 2)), math.inf
    if sizes.max() > best:
        best, place = float(sizes.max()), float(first[sizes.argmax()])
    for _ in range(_ROUNDS if best > 0.0 else 0):
        level = best * (1.0 + 2.0 * TOLERANCE)
        met = _met(a, b, c, d, level)
        if met.size < 2:
            break
        between = 0.5 * (met[1:] + met[:-1])
        sizes = _sizes(a, b, c, d, between)
        if sizes.max() <= level:
            break
        best, place = float(sizes.max()), abs(float(between[sizes.argmax()]))
    return best, place


def _met(a: Array, b: Array, c: Array, d: Array, level: float) -> Array:
    """Return the sorted frequencies at which a singular value is `level`, which is larger than that of D."""
    r = d.T @ d - level**2 * np.eye(d.shape[1])
    left = np.linalg.solve(r, d.T @ c)
    right = np.linalg.solve(r, b.T)
    upper = a - b @ left
    hamiltonian = np.block(
        [[upper, -level * b @ right], [level * c.T @ np.linalg.solve(d @ d.T - level**2 * np.eye(len(d)), c), -upper.T]]
    )
    roots = np.linalg.eigvals(hamiltonian)
    near = np.abs(roots.real) <= _NEAR * np.maximum(np.abs(roots), 1e-12) + 1e-12
    found = np.abs(roots[near].imag)
    return np.unique(np.concatenate([found, -found]))


def _sizes(a: Array, b: Array, c: Array, d: Array, omega: Array) -> Array:
    """Return the largest singular value at each frequency."""
    return np.asarray(np.linalg.svd(transfer(a, b, c, d, 1j * omega), compute_uv=False).max(axis=1))
