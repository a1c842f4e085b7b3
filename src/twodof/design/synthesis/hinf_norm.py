"""The H-infinity norm of a linear system of any number of inputs and outputs, and the frequency at which it is met.

It uses the level sets of Boyd, Balakrishnan and Kabamba (1989) in the two steps of Bruinsma and Steinbuch (1990). The
imaginary eigenvalues of a Hamiltonian matrix tell where a size is met. So a peak cannot hide between points of a grid.
"""

import math

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ParameterError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TOLERANCE = 1e-7
_ROUNDS = 40
_NEAR = 1e-7  # of an eigenvalue to the imaginary axis, as a share of its size


def hinf_norm(a: Array, b: Array, c: Array, d: Array, dt: float | None = None) -> tuple[float, float]:
    """(norm, frequency [rad/s]) of C (s - A)^-1 B + D, or with the sample time `dt` [s] of C (z - A)^-1 B + D.

    Shapes (n, n), (n, m), (p, n), (p, m). An unstable system has the norm infinity. Good to `TOLERANCE` of itself.
    Raises ParameterError for shapes that do not fit and numbers that are not finite.
    """
    n = len(a)
    if a.shape != (n, n) or b.shape[0] != n or c.shape[1] != n or d.shape != (c.shape[0], b.shape[1]):
        shapes = (a.shape, b.shape, c.shape, d.shape)
        raise ParameterError(f"shapes {shapes} are not a system", "hinf_norm", "give (n,n), (n,m), (p,n), (p,m)")
    if not all(np.isfinite(part).all() for part in (a, b, c, d)):
        raise ParameterError("a matrix holds NaN or infinity", "hinf_norm", "give finite numbers")
    through = float(np.linalg.norm(d, 2)) if d.size else 0.0
    if n == 0:
        return through, 0.0
    poles = np.linalg.eigvals(a).astype(np.complex128)
    if (np.abs(poles).max() >= 1.0) if dt is not None else (poles.real.max() >= 0.0):
        return math.inf, math.nan
    if dt is None:
        return _continuous(a, b, c, d, poles, through)
    # The bilinear map keeps the norm: z = (1 + s) / (1 - s), w = tan(omega dt / 2).
    inverse = np.linalg.inv(np.eye(n) + a)
    root = math.sqrt(2.0)
    ac, bc = inverse @ (a - np.eye(n)), root * inverse @ b
    cc, dc = root * c @ inverse, d - c @ inverse @ b
    norm, w = _continuous(ac, bc, cc, dc, np.linalg.eigvals(ac).astype(np.complex128), float(np.linalg.norm(dc, 2)))
    return norm, 2.0 * math.atan(w) / dt


def _continuous(a: Array, b: Array, c: Array, d: Array, poles: Complex, through: float) -> tuple[float, float]:
    size = np.abs(poles)
    first = np.concatenate([[0.0], size, np.abs(poles.imag)])
    sizes = _sizes(a, b, c, d, first)
    best, place = through, math.inf
    if sizes.max() > best:
        best, place = float(sizes.max()), float(first[sizes.argmax()])
    if best == 0.0:
        return 0.0, 0.0
    for _ in range(_ROUNDS):
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
    """The frequencies, sorted, at which a singular value is `level`, which is larger than that of D."""
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
    """The largest singular value at each frequency."""
    s = 1j * omega[:, None, None] * np.eye(len(a)) - a
    response = c @ np.linalg.solve(s, np.broadcast_to(b, (len(omega), *b.shape)).astype(np.complex128)) + d
    return np.asarray(np.linalg.svd(response, compute_uv=False).max(axis=1))
