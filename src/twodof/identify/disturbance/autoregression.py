"""Coloured noise as an autoregression, v[t] + a_1 v[t-1] + ... + a_n v[t-n] = e[t] with white e.

Its coefficients come by Burg's method (Burg, 1975; Percival and Walden, Spectral Analysis for Physical Applications,
section 9.5), which always gives a stable model. Its order is the one of the least corrected AIC (Hurvich and Tsai,
1989), so that a short record gets a small one.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_ORDER = 60
"""Largest order that is looked at: at 250 Hz a memory of .24 s, nine periods of the rotors' vibration of 38 Hz. Noise
that has next to nothing at some frequency, such as vibration at 0 Hz, needs so many. With 25 at most, mu of 60
flights of attitude steps on the rig `paper` had 20 % more spread."""

_CERTAIN = 1e-12
"""Share of the variance that is left to chance: rounding must not make it negative."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """A stable autoregression of order n with the standard deviation `sigma` of its white noise.

    `predictors` holds the best predictor from k earlier samples, for each k from 0 to n. Its coefficients are (1, a_1,
    ..., a_k). `deviations` holds the standard deviations of their errors. The shorter predictors serve the first
    samples of a piece, which have fewer samples before them.
    """

    predictors: tuple[Array, ...] = field(repr=False)
    deviations: Array = field(repr=False)

    @property
    def order(self) -> int:
        """The number n of earlier samples that count."""
        return len(self.predictors) - 1

    @property
    def sigma(self) -> float:
        """Standard deviation of the white noise e."""
        return float(self.deviations[-1])

    @property
    def coefficients(self) -> Array:
        """(1, a_1, ..., a_n)."""
        return self.predictors[-1]

    def scaled(self, factor: float) -> "Autoregression":
        """Return the same colour with `factor` times the standard deviation."""
        return replace(self, deviations=self.deviations * factor)

    def whiten(self, rows: Array, pieces: Sequence[slice]) -> Array:
        """`rows` (samples, ...) less their prediction from the earlier ones, over the deviation of the error.

        Noise of this model becomes white with standard deviation 1, the first samples included: the product of this
        matrix's transpose with itself is the inverse of the noise's covariance. `pieces` have no gaps and do not know
        of each other.
        """
        white = np.empty_like(rows)
        n, ahead = self.order, self.coefficients / self.sigma
        for piece in pieces:
            own = rows[piece]
            known = min(n, own.shape[0])
            out = np.empty_like(own)
            out[:known] = self._beginning[:known, :known] @ own[:known]
            if own.shape[0] > n:
                columns = np.ascontiguousarray(own.reshape(own.shape[0], -1).T)
                rest = np.array([np.convolve(column, ahead, "valid") for column in columns])
                out[n:] = rest.T.reshape(out[n:].shape)
            white[piece] = out
        return white

    @cached_property
    def _beginning(self) -> Array:
        """Return the matrix (n, n) that whitens the first n samples of a piece, each by those before it."""
        found, n = np.zeros((self.order, self.order)), self.order
        if n:
            found[np.tril_indices(n)] = np.concatenate([one[::-1] for one in self.predictors[:-1]])
        return found / self.deviations[:-1, None]

    def colour(self, rows: Array) -> Array:
        """`rows` (samples, columns) through the transpose of the filter that makes this noise of white noise.

        The products of the result with itself are rows' R rows, R the covariance of the noise, up to its beginning.
        """
        size = 1 << (8 * rows.shape[0]).bit_length()
        response = self.sigma / np.fft.rfft(self.coefficients, size)
        return np.asarray(np.fft.irfft(np.fft.rfft(rows, size, axis=0) * response.conj()[:, None], size, axis=0))

    def log_deviations(self, pieces: Sequence[slice]) -> float:
        """Half the logarithm of the determinant of the noise's covariance."""
        logs = np.log(self.deviations)
        lengths = [piece.stop - piece.start for piece in pieces]
        return float(sum(logs[:-1][:size].sum() + max(0, size - self.order) * logs[-1] for size in lengths))


def pieces_of(position: Array) -> tuple[slice, ...]:
    """Return the stretches of samples at `position` without a gap, an interval of 1.5 times the usual one or more."""
    if position.size < 2:
        return (slice(0, position.size),)
    interval = np.diff(position)
    edges = np.flatnonzero(interval > 1.5 * np.median(interval)) + 1
    bounds = [0, *edges.tolist(), position.size]
    return tuple(slice(a, b) for a, b in itertools.pairwise(bounds))


def autoregression(noise: Array, pieces: Sequence[slice], order: int | None = None, spent: int = 0) -> Autoregression:
    """Fit the autoregression of `noise` (samples,), by default of the order with the least corrected AIC.

    `spent` is the number of other unknowns that were fitted to the same samples.
    """
    most = min(MAX_ORDER if order is None else order, max(0, (noise.size - spent) // 4))
    forward = [noise[piece].copy() for piece in pieces]
    backward = [one.copy() for one in forward]
    variance = float(noise @ noise) / max(1, noise.size)
    predictors, variances = [np.ones(1)], [variance]
    for _ in range(most):
        pairs = [(f[1:], b[:-1]) for f, b in zip(forward, backward, strict=True) if f.size > 1]
        power = sum(float(f @ f) + float(b @ b) for f, b in pairs)
        if power <= 0.0 or variance <= 0.0:
            break
        reflection = -2.0 * sum(float(f @ b) for f, b in pairs) / power
        forward = [f + reflection * b for f, b in pairs]
        backward = [b + reflection * f for f, b in pairs]
        padded = np.append(predictors[-1], 0.0)
        variance *= 1.0 - reflection**2
        predictors.append(padded + reflection * padded[::-1])
        variances.append(variance)
    chosen = len(variances) - 1
    if order is None:
        costs = [_corrected_aic(noise.size, one, k + spent + 1) for k, one in enumerate(variances)]
        chosen = int(np.argmin(costs))
    scale = noise.size / max(1, noise.size - spent - chosen)
    deviations = np.sqrt(scale * np.maximum(variances[: chosen + 1], 1e-300))
    return Autoregression(tuple(predictors[: chosen + 1]), np.asarray(deviations))


def from_covariance(covariance: Array) -> Autoregression:
    """Return the autoregression with these autocovariances at lags 0, 1, ..., n.

    Row k of the inverse of the covariance matrix's Cholesky factor holds the best predictor from k earlier samples, the
    earliest first, over the deviation of its error.
    """
    lag = np.arange(covariance.size)
    matrix = covariance[np.abs(lag[:, None] - lag)]
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        # Rounding has made the matrix of an almost deterministic process indefinite.
        factor = np.linalg.cholesky(matrix + _CERTAIN * covariance[0] * np.eye(covariance.size))
    deviations = np.diag(factor)
    rows = np.linalg.inv(factor) * deviations[:, None]
    return Autoregression(tuple(row[k::-1] for k, row in enumerate(rows)), deviations)


def _corrected_aic(size: int, variance: float, unknowns: int) -> float:
    """Akaike's criterion for `size` samples whose predictions err by `variance`, corrected for short records."""
    return size * math.log(max(variance, 1e-300)) + 2.0 * unknowns * size / max(1, size - unknowns - 1)
