"""The frequencies at which a transfer has a given size, or is real: eigenvalues of a pencil, then refined roots.

G~ is conj(G): G(1 / z) on the unit circle, and G(-s) on the imaginary axis. So |G| = g where g^2 - G~ G has a zero, and
G is real where G - G~ has one. Those zeros are generalised eigenvalues of matrices of 2 n + 1 rows (the Hamiltonian and
symplectic pencils of Boyd, Balakrishnan and Kabamba 1989, and of Bruinsma and Steinbuch 1990).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twodof.design.closed_loop_poles import logarithms
from twodof.design.loop_transfer import LoopTransfer
from twodof.errors import ParameterError

Array = NDArray[np.float64]

NEAR = 0.3
"""How far from the axis, as a share of its frequency, an eigenvalue may lie to be looked at: more than roundings do."""

SLOW = 1e-9
"""A frequency below it, in turns a sample or rad/s, is 0 up to roundings."""

_SAME = 1e-10  # share by which two roots differ at least: beside one, rounding changes signs more than once
_ROUNDING = 4e-15


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
    finite = np.abs(beta) > _ROUNDING * np.abs(alpha)
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


Complex = NDArray[np.complex128]

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
            raise ParameterError(
                f"the delay of {loop.delay:g} s turns the loop {turns:.3g} times before its gain has fallen",
                "margins",
                "give the loop a lag at a lower frequency, or a shorter delay",
            )
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
