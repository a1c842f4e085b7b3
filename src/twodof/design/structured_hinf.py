"""Structured H-infinity: the gains of a fixed structure that make the largest weighted response smallest.

The norm is not convex in the gains and has kinks where two peaks are alike. So the largest response is an unknown t of
its own: the search makes t least, with each response below t at a set of frequencies. Sequential quadratic programming
takes a kink for what it is, two constraints that hold together. The frequencies at which the norm is met are added
until none is above t. The search goes from several starts. The problem is that of Apkarian and Noll (2006) and of
systune.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.design.closed_loop_poles import frequencies_of_size, logarithms
from twodof.errors import ParameterError
from twodof.models.lti import check_system, transfer

Array = NDArray[np.float64]
System = tuple[Array, Array, Array, Array]
"""(A, B, C, D)."""
ClosedLoop = Callable[[Array], Sequence[System]]
"""Function from the gains (k,) to the weighted closed loop: one or more systems, of which the largest norm counts."""

_FREQUENCIES, _LOWEST = 60, 1e-4
"""Frequencies at the start of a search, and the lowest one as a share of half the sample rate."""
_EXCHANGES = 12
_TRIED = 4  # starts beside one that leads to no stable loop
_INSIDE = 1e-9
_ENOUGH = 1e-6  # by how much the norm may exceed t, as a share
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
    dt: float,
    low: Array,
    high: Array,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> StructuredHinf:
    """Return the gains that minimise the H-infinity norm of `closed`, each from `low` to `high`.

    The search is scaled by the first start's gains. `dt` [s] is the sample time of the loop. `progress` is called with
    the share done. Raise ParameterError for starts that do not fit, and if no start leads to a stable loop.
    """
    points = [np.asarray(start, dtype=float) for start in starts]
    if not points or any(p.ndim != 1 or p.shape != points[0].shape or not np.isfinite(p).all() for p in points):
        raise _error("the starts are not gains (k,) of one length", "give finite numbers")
    k = points[0].size
    if not 1 <= k <= _MOST_GAINS:
        raise _error(f"{k} gains are too few or too many", f"give 1 to {_MOST_GAINS}")
    if low.shape != (k,) or high.shape != (k,) or not (low < high).all():
        raise _error("the bounds do not fit the gains", "give low < high, each (k,)")
    search = _Search(closed, dt, np.where(points[0] != 0.0, np.abs(points[0]), 1.0), low, high)
    rng = np.random.default_rng(seed)
    found: list[tuple[float, Array]] = []
    for number, start in enumerate(points):
        progress(number / len(points))
        for _ in range(_TRIED):
            value, gains = search.lowest(np.clip(start, low, high))
            if math.isfinite(value):
                found.append((value, gains))
                break
            start = start + 0.3 * search.scale * rng.standard_normal(k)
    if not found:
        raise _error("no start leads to a stable loop", "give a start that stabilises it, or more starts")
    found.sort(key=lambda one: one[0])
    norm, omega = largest_norm(closed(found[0][1]), dt)
    return StructuredHinf(found[0][1], norm, omega, tuple(value for value, _ in found))


def largest_norm(systems: Sequence[System], dt: float | None) -> tuple[float, float]:
    """Return (norm, frequency [rad/s]) of the system with the largest H-infinity norm; infinite if unstable."""
    return max((hinf_norm(*one, dt) for one in systems), key=lambda one: one[0])


@dataclass(frozen=True, eq=False)
class _Search:
    """Search of the gains, each in units of its `scale`."""

    closed: ClosedLoop
    dt: float
    scale: Array
    low: Array
    high: Array

    def lowest(self, gains: Array) -> tuple[float, Array]:
        """Return the lowest norm that is reached from `gains`, and where; infinity if no stable loop is."""
        from scipy.optimize import minimize  # imported late: most commands start without it

        omega = np.geomspace(_LOWEST, 1.0, _FREQUENCIES) * math.pi / self.dt
        kept = x = np.append(gains / self.scale, self._sizes(gains, omega).max())
        bounds = [*zip(self.low / self.scale, self.high / self.scale, strict=True), (0.0, None)]
        fixed: dict[str, Any] = {"method": "SLSQP", "bounds": bounds, "options": {"maxiter": 200, "ftol": 1e-10}}
        best = math.inf
        for _ in range(_EXCHANGES):
            below = {"type": "ineq", "fun": lambda x, omega=omega: self._below(x, omega)}
            with np.errstate(all="ignore"):
                x = minimize(lambda x: x[-1], x, jac=lambda x: np.eye(x.size)[-1], constraints=below, **fixed).x
            found = [hinf_norm(*one, self.dt) for one in self.closed(self.gains(x))]
            norm = max(norm for norm, _ in found)
            if norm < best:
                best, kept = norm, x
            if not math.isfinite(norm) or norm <= x[-1] * (1.0 + _ENOUGH):
                break
            # At 0 itself a loop that an integral makes has a pole on the way.
            omega = np.append(omega, [max(peak, 1e-3 * omega[0]) for _, peak in found])
        return best, self.gains(kept)

    def gains(self, x: Array) -> Array:
        return np.asarray(np.clip(x[:-1] * self.scale, self.low, self.high))

    def _below(self, x: Array, omega: Array) -> Array:
        """Return the distance of each response at `omega` [rad/s] below t, and of the poles to the stability border."""
        gains = x[:-1] * self.scale
        radius = max(float(np.abs(np.linalg.eigvals(one[0])).max()) for one in self.closed(gains))
        return np.append(x[-1] - self._sizes(gains, omega), 1.0 - radius - _INSIDE)

    def _sizes(self, gains: Array, omega: Array) -> Array:
        return np.concatenate([_sizes(*one, self.dt, omega) for one in self.closed(gains)])


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "structured_hinf", remedy)


Complex = NDArray[np.complex128]

TOLERANCE = 1e-7
_ROUNDS = 40


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
    fast = math.inf if dt is None else math.pi / dt
    poles = logarithms(np.linalg.eigvals(a).astype(np.complex128), dt)
    first = np.concatenate([[0.0, *([fast] if dt else [])], np.abs(poles), np.abs(poles.imag)])
    first = first[first <= fast]  # a pole at z = 0 is infinitely fast
    sizes = _sizes(a, b, c, d, dt, first)
    best, place = (float(np.linalg.norm(d, 2)), fast) if dt is None else (0.0, 0.0)
    if sizes.max() > best:
        best, place = float(sizes.max()), float(first[sizes.argmax()])
    for _ in range(_ROUNDS if best > 0.0 else 0):
        level = best * (1.0 + 2.0 * TOLERANCE)
        met = np.concatenate([[0.0], frequencies_of_size(a, b, c, d, dt, level), [fast] if dt else []])
        between = 0.5 * (met[1:] + met[:-1])
        sizes = _sizes(a, b, c, d, dt, between)
        if sizes.max(initial=0.0) <= level:
            break
        best, place = float(sizes.max()), float(between[sizes.argmax()])
    return best, place


def _sizes(a: Array, b: Array, c: Array, d: Array, dt: float | None, omega: Array) -> Array:
    """Return the largest singular value at each frequency [rad/s]."""
    places = 1j * omega if dt is None else np.exp(1j * omega * dt)
    return np.asarray(np.linalg.svd(transfer(a, b, c, d, places), compute_uv=False).max(axis=1))
