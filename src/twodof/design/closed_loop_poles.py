"""Poles of a closed loop, the roots of 1 + L = 0, also with a continuous delay; the motion of the worst pole.

Frequencies at which a transfer has a given size, or is real, are eigenvalues of a pencil, refined as roots. G~ is
conj(G): G(1 / z) on the unit circle, and G(-s) on the imaginary axis. So |G| = g where g^2 - G~ G has a zero, and G is
real where G - G~ has one. Those zeros are generalised eigenvalues of matrices of 2 n + 1 rows (the Hamiltonian and
symplectic pencils of Boyd, Balakrishnan and Kabamba 1989, and of Bruinsma and Steinbuch 1990).
"""

import math
from collections.abc import Callable
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

    The feedback cannot move a pole whose state the loop does not observe or does not reach, such as that of an
    estimator's bias. A pole on the border of stability that the open loop has too counts as such. Each pole of the open
    loop accounts for one of them.
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


NEAR = 0.3
"""How far from the axis, as a share of its frequency, an eigenvalue may lie to be looked at: more than roundings do."""

SLOW = 1e-9
"""A frequency below it, in turns a sample or rad/s, is 0 up to roundings."""

_SAME = 1e-10  # share by which two roots differ at least: beside one, rounding changes signs more than once
_PENCIL_ROUNDING = 4e-15


def frequencies_of_size(a: Array, b: Array, c: Array, d: Array, dt: float | None, size: float) -> Array:
    """Return sorted candidates [rad/s] that include every frequency at which a singular value of G is `size`.

    G is C (s - A)^-1 B + D, or with the sample time `dt` [s] C (z - A)^-1 B + D.
    """
    square = size**2
    last = np.hstack([d.T @ c / square, b.T / square, d.T @ d / square - np.eye(d.shape[1])])
    return _on_the_axis(a, b, c.T @ c, c.T @ d, last, dt)


def frequencies_of_the_real(g: LoopTransfer) -> Array:
    """Return sorted candidates [rad/s] that include every frequency at which G, without its delay, is real."""
    last = np.hstack([g.c, -g.b.T, np.zeros((1, 1))])
    return _on_the_axis(g.a, g.b, np.zeros_like(g.a), g.c.T, last, g.dt)


def _on_the_axis(a: Array, b: Array, drive: Array, direct: Array, last: Array, dt: float | None) -> Array:
    """Return the frequencies of eigenvalues near the axis of the pencil made of the rows of G and G~ and of `last`.

    The states x and the input u of G enter the states of G~ by `drive` x + `direct` u.
    """
    from scipy.linalg import eig  # imported late: most commands start without it

    n, k = len(a), b.shape[1]
    if n == 0:
        return np.zeros(0)
    zero = np.zeros((n, n))
    m, e = np.zeros((2 * n + k, 2 * n + k)), np.zeros((2 * n + k, 2 * n + k))
    m[:n] = np.hstack([a, zero, b])
    e[:n, :n] = np.eye(n)
    m[2 * n :] = last
    if dt is None:
        m[n : 2 * n] = np.hstack([-drive, -a.T, -direct])
        e[n : 2 * n, n : 2 * n] = np.eye(n)
    else:
        m[n : 2 * n, n : 2 * n] = np.eye(n)
        e[n : 2 * n] = np.hstack([drive, a.T, direct])
    alpha, beta = eig(m, e, right=False, homogeneous_eigvals=True)
    finite = np.abs(beta) > _PENCIL_ROUNDING * np.abs(alpha)
    z = alpha[finite] / beta[finite]
    z = z[np.abs(z) > 0.0]
    s = z if dt is None else np.log(z.astype(np.complex128)) / dt
    low = SLOW / dt if dt else SLOW
    close = (np.abs(s.real) <= NEAR * np.abs(s.imag)) & (np.abs(s.imag) > low)
    return np.unique(np.abs(s.imag[close]))


def refined_roots(f: Callable[[float], float], grid: Array, values: Array) -> list[float]:
    """Return the roots of `f`, to the last digits, between points of `grid` where `values` there change sign."""
    from scipy.optimize import brentq  # imported late: most commands start without it

    signs = np.sign(values)
    for k in np.flatnonzero(signs == 0.0):  # on a root: as its neighbour, so that it counts once
        signs[k] = signs[k - 1] if k else -1.0
    changes = np.flatnonzero(signs[:-1] * signs[1:] < 0.0)
    found: list[float] = []
    for k in changes:
        low, high = float(grid[k]), float(grid[k + 1])
        at_low, at_high = f(low), f(high)
        if at_low * at_high < 0.0:
            root = float(brentq(f, low, high, xtol=1e-300, rtol=1e-14, maxiter=200))
        else:  # `values` were computed in another order: one end is the root, up to rounding
            root = low if abs(at_low) < abs(at_high) else high
        if not found or root > found[-1] * (1.0 + _SAME):
            found.append(root)
    return found


PER_DECADE = 40
_WIDTHS = np.concatenate([-np.geomspace(30.0, 0.1, 12), [0.0], np.geomspace(0.1, 30.0, 12)])
_PER_TURN = 16  # of the phase of a delay
_MOST = 40_000


def frequency_grid(loop: LoopTransfer, closed: Complex, further: Array, below: float = 1e-3) -> Array:
    """Return sorted frequencies [rad/s] > 0, from far below the slowest pole to the Nyquist frequency.

    `closed` has the closed loop's poles. In continuous time the frequencies end where |L| stays below `below`. Those in
    `further` are included, with a point between each two. Raises ParameterError if a delay turns the phase of the loop
    too many times for a grid.
    """
    every = np.concatenate([loop.poles(), closed])
    s = logarithms(every[np.abs(every) > 0.0], loop.dt)
    size = np.abs(s)
    size = size[np.isfinite(size) & (size > 1e-9)]
    given = further[further > 0.0]
    known = np.concatenate([size, given]) if size.size + given.size else np.ones(1)
    low = 1e-2 * float(known.min())
    if loop.dt is None:
        high = _end(loop, 10.0 * float(known.max()), below)
    else:
        high = np.pi / loop.dt
    count = max(50, int(PER_DECADE * np.log10(high / low)))
    around = (np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * _WIDTHS).ravel()
    between = np.sqrt(given[1:] * given[:-1]) if given.size > 1 else given[:0]
    parts = [np.geomspace(low, high, count), around, given, between, [high]]
    if loop.delay:
        turns = high * loop.delay / (2.0 * np.pi)
        if turns * _PER_TURN > _MOST:
            what = f"the delay of {loop.delay:g} s turns the loop {turns:.3g} times before its gain has fallen"
            raise ParameterError(what, "margins", "give the loop a lag at a lower frequency, or a shorter delay")
        parts.append(np.linspace(low, high, int(turns * _PER_TURN) + 2))
    grid = np.unique(np.concatenate(parts))
    return np.asarray(grid[(grid >= min(low, float(known.min()))) & (grid <= high)])


def _end(loop: LoopTransfer, start: float, below: float) -> float:
    """Return the frequency above which |L| stays below `below` or near its direct path."""
    end = start
    for _ in range(40):
        if abs(loop.response(end)[0]) < below or loop.d:
            break
        end *= 2.0
    return end
