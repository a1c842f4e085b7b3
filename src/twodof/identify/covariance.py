"""Covariance of the estimates from the Jacobian at the solution, its robust form, and identifiability."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError

Array = NDArray[np.float64]

# Two-sided differences carry a relative error of some 1e-10 of a column: a ratio of singular values below this
# limit is a combination of unknowns with no effect, not a small one.
RANK_TOLERANCE = 1e-6


def check_identifiable(jacobian: Array, scale: Array, labels: Sequence[str], where: str) -> float:
    """Return the condition number of `jacobian` (rows, unknowns).

    Raises IdentificationError naming the unknowns that the data cannot tell. Columns are scaled to unit length, so
    units do not matter. An unknown has no effect if its change by its whole
    `scale` moves the outputs less than 1e-9 times as much as that of the most effective one.
    """
    length, s, vt = _unit_svd(jacobian, where)
    effect = length * scale
    mute = [label for label, e in zip(labels, effect, strict=True) if e <= 1e-9 * effect.max()]
    if mute:
        what = f"the data say nothing about {_listed(mute)}"
        raise IdentificationError(what, where, "fix it (leave it out of `estimate`), or excite what it acts on")
    if jacobian.shape[0] < jacobian.shape[1] or s[-1] < RANK_TOLERANCE * s[0]:
        involved = np.abs(vt[s < RANK_TOLERANCE * s[0]]).max(axis=0, initial=0.0)
        names = [label for label, share in zip(labels, involved, strict=True) if share > 0.05]
        remedy = "fix one of them, measure another output, or add an experiment in which they act differently"
        raise IdentificationError(f"the data cannot tell apart {_listed(names or list(labels))}", where, remedy)
    return float(s[0] / s[-1])


def uncertain_unknowns(jacobian: Array, scale: Array, free: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the unknowns for the covariance: the `free` ones, and those held by a bound if the data show them.

    A bound ends the search, not the doubt. With other noise the unknown would have left its bound and moved the others.
    """
    every = np.arange(jacobian.shape[1])
    try:
        check_identifiable(jacobian, scale, [""] * every.size, "")
    except IdentificationError:
        return free
    return every


def covariance(jacobian: Array) -> Array:
    """(J' J)^-1 for rows that were divided by their noise's standard deviation: the Cramer-Rao bound if it is white."""
    length, s, vt = _unit_svd(jacobian)
    half = vt.T / s / np.where(length > 0.0, length, 1.0)[:, None]
    return np.asarray(half @ half.T)


@dataclass(frozen=True, eq=False)
class ResidualRows:
    """The rows of one output of one record; `when` is the step (or Fourier coefficient) of each."""

    record: int
    output: str
    rows: slice
    when: NDArray[np.int64]


def robust_covariance(jacobian: Array, residual: Array, blocks: Sequence[ResidualRows], spectral: bool) -> Array:
    """(J'J)^-1 J' R J (J'J)^-1 with R the covariance that the residuals themselves show, supposing it stationary.

    In the time domain R is Toeplitz. It holds the residuals' auto- and cross-covariances within a record (Morelli and
    Klein, Accuracy of aerodynamic model parameters estimated from flight test data, 1997). Bartlett's window over 2
    sqrt(n) lags tapers it, which keeps it positive. For Fourier coefficients (`spectral`) it is the diagonal of their
    power, smoothed over neighbours. White residuals give `covariance` back, except for the scatter of R.
    """
    bread = covariance(jacobian)
    meat = np.zeros_like(bread)
    for block in blocks:
        if spectral:
            power = _smoothed(residual[block.rows])
            meat += (jacobian[block.rows].T * power) @ jacobian[block.rows]
            continue
        for other in blocks:
            if other.record == block.record:
                meat += _coloured(jacobian, residual, block, other)
    # Rows behind those of the data: what is known before, with errors of its own.
    before = jacobian[max(block.rows.stop for block in blocks) :]
    meat += before.T @ before
    freedom = residual.size / max(1, residual.size - jacobian.shape[1])
    return np.asarray(freedom * bread @ meat @ bread)


def _coloured(jacobian: Array, residual: Array, one: ResidualRows, two: ResidualRows) -> Array:
    """J1' R12 J2 for two outputs of one record; steps without a sample count as absent."""
    first = int(min(one.when.min(), two.when.min()))
    steps = int(max(one.when.max(), two.when.max())) - first + 1

    def spread(block: ResidualRows) -> tuple[Array, Array]:
        j, e = np.zeros((steps, jacobian.shape[1])), np.zeros(steps)
        j[block.when - first] = jacobian[block.rows]
        e[block.when - first] = residual[block.rows]
        return j, e

    (j1, e1), (j2, e2) = spread(one), spread(two)
    reach = min(math.ceil(2.0 * math.sqrt(steps)), steps - 1)
    lags = np.arange(-reach, reach + 1)
    # A power of two, at which the transform is fast, that holds the steps and the lags on both sides.
    size = 1 << (steps + 2 * reach - 1).bit_length()
    cross = np.fft.irfft(np.fft.rfft(e1, size) * np.fft.rfft(e2, size).conj(), size)[lags]
    kernel = (1.0 - np.abs(lags) / (reach + 1.0)) * cross / math.sqrt(one.when.size * two.when.size)
    spectrum = np.fft.rfft(j2.T, size) * np.fft.rfft(kernel, size)
    filtered = np.fft.irfft(spectrum, size)[:, reach : reach + steps]
    return np.asarray(j1.T @ filtered.T)


def _smoothed(residual: Array) -> Array:
    """Power of each row of (real parts, imaginary parts), averaged over neighbouring coefficients."""
    half = residual.size // 2
    power = 0.5 * (residual[:half] ** 2 + residual[half:] ** 2)
    width = min(half, 2 * math.ceil(math.sqrt(half)) + 1)
    window = np.ones(width)
    mean = np.convolve(power, window, mode="same") / np.convolve(np.ones(half), window, mode="same")
    return np.concatenate([mean, mean])


def _unit_svd(jacobian: Array, where: str = "the search") -> tuple[Array, Array, Array]:
    """Lengths of the columns; singular values (falling) and right vectors of the Jacobian with columns of unit length.

    They come from the small matrix J' J, which costs a hundredth of a decomposition of the tall one. A singular value
    is then known to 1e-8 of the largest, well below RANK_TOLERANCE. None is below 1e-16, so that inverses are finite.
    A column without a length stays 0. Raises IdentificationError for one that is not finite.
    """
    length = np.linalg.norm(jacobian, axis=0)
    if not np.isfinite(length).all():
        raise IdentificationError(
            "the model's sensitivities are not finite: close to the estimate it is unstable, or far faster than a step",
            where,
            "choose another first guess, or a structure with fewer states",
        )
    unit = jacobian / np.where(length > 0.0, length, 1.0)
    squares, vectors = np.linalg.eigh(unit.T @ unit)
    return np.asarray(length), np.sqrt(np.maximum(squares[::-1], 1e-32)), np.asarray(vectors.T[::-1])


def _listed(names: Sequence[str]) -> str:
    quoted = [f"'{name}'" for name in names]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} and {quoted[-1]}"
