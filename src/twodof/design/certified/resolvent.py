"""Coprime factors of a controller, K = N / D with D and N stable, and what they are on an arc of the unit circle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.design.certified.affine import ROUNDING, Affine
from twodof.errors import ParameterError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class CoprimeFactors:
    """`a` (n, n) is stable, `c` (1, n). Of `b` (n, 1 + m) and `d` (1, 1 + m) column 0 is of D, the others of N."""

    a: Array
    b: Array
    c: Array
    d: Array

    def on_arc(self, angle: Array, half: Array, symbols: int) -> list[Affine]:
        """D and each of N at z = e^(j angle) e^(j half e), |e| <= 1: the first of `symbols` is e. `angle` is (k,)."""
        n, z = len(self.a), np.exp(1j * angle)
        r = np.linalg.inv(z[:, None, None] * np.eye(n) - self.a) if n else np.zeros((len(z), 0, 0), complex)
        left, right = self.c @ r, r @ self.b
        value, slope = (left @ self.b)[:, 0] + self.d[0], -(left @ right)[:, 0]
        # The resolvent at z + d is R - d R^2 + d^2 R^2 (1 + d R)^-1 R; the chord d is at most as long as the arc.
        norm = np.sqrt((np.abs(r) ** 2).sum(axis=(1, 2)))
        reach = half * norm
        factor = np.where(reach < 1.0, half**2 * norm / np.maximum(1.0 - reach, 1e-300), np.inf)
        sizes = np.sqrt((np.abs(left[:, 0]) ** 2).sum(axis=1))[:, None] * np.sqrt((np.abs(right) ** 2).sum(axis=1))
        rounding = 100.0 * ROUNDING * n * norm[:, None] * np.linalg.norm(self.c) * np.linalg.norm(self.b, axis=0)
        rest = factor[:, None] * sizes + 0.5 * half[:, None] ** 2 * np.abs(slope) + rounding
        found = []
        for j in range(value.shape[1]):
            slopes = np.zeros((len(z), symbols), complex)
            slopes[:, 0] = 1j * z * half * slope[:, j]
            found.append(Affine(value[:, j], slopes, rest[:, j]))
        return found


def coprime_factors(a: Array, b: Array, c: Array, d: Array) -> CoprimeFactors:
    """Of a sampled controller with one output: D^-1 N, by the gain of a Kalman filter of its states (Vidyasagar 1985).

    Raises ParameterError for a controller with a motion on or outside the circle that its output does not show.
    """
    from scipy.linalg import LinAlgError, matrix_balance, solve_discrete_are  # imported late: most start without it

    n = len(a)
    if n == 0:
        return CoprimeFactors(a, np.zeros((0, 1 + b.shape[1])), c, np.concatenate([np.ones((1, 1)), d], axis=1))
    _, scale = matrix_balance(
        np.block(
            [[a, b, np.zeros((n, 1))], [c, np.zeros((1, b.shape[1] + 1))], [np.zeros((b.shape[1], n + b.shape[1] + 1))]]
        ),
        permute=False,
        separate=True,
    )
    s = scale[0][:n] / np.exp(np.mean(np.log(scale[0][:n])))
    a, b, c = a / s[:, None] * s, b / s[:, None], c * s
    try:
        p = solve_discrete_are(a.T, c.T, np.eye(n), np.array([[float(np.sum(c**2)) or 1.0]]))
    except (LinAlgError, ValueError) as reason:
        raise _error() from reason
    gain = a @ p @ c.T / (float((c @ p @ c.T)[0, 0]) + float(np.sum(c**2)))
    stable = a - gain @ c
    if not np.abs(np.linalg.eigvals(stable)).max() < 1.0 - 1e-9:
        raise _error()
    return CoprimeFactors(
        stable, np.concatenate([-gain, b - gain @ d], axis=1), c, np.concatenate([np.ones((1, 1)), d], axis=1)
    )


def _error() -> ParameterError:
    return ParameterError(
        "the controller has a motion that does not die out and that M does not show",
        "certificate",
        "take it out of the diagram, or let it end in reset",
    )
