"""Averaged auto- and cross-spectra of all signals of a record at once: what every frequency response is made of."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, nearest, shown
from twodof.identify.record import Record

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_FEWEST = 8
"""Samples of a segment."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectral matrix of n signals at k frequencies, averaged over tapered segments.

    `matrix[f, i, j]` is the mean of conj(X_i) X_j. The matrix has shape (k, n, n). Its frequencies are `omega` [rad/s],
    shape (k,). `averages` is how many independent segments the overlapping ones are worth. `spacing` is how many points
    of the grid are worth one independent point, since neighbours share the taper's main lobe. `length` [s] is that of a
    segment.
    """

    names: tuple[str, ...]
    omega: Array
    matrix: Complex
    averages: float
    spacing: float
    length: float

    def block(self, rows: Sequence[str], columns: Sequence[str]) -> Complex:
        """The part of the matrix between these signals, shape (k, rows, columns)."""
        i, j = ([self.names.index(name) for name in part] for part in (rows, columns))
        return np.asarray(self.matrix[np.ix_(range(self.omega.size), i, j)])


def spectra(
    record: Record, names: Sequence[str], length: int, *, window: str = "hann", padded: int | None = None
) -> Spectra:
    """Welch's averaged spectra of the channels `names`, over half-overlapped segments of `length` samples.

    The mean of each segment is taken away. `padded`: each segment is filled up with zeros to this many samples, so that
    segments of several lengths give the same frequencies. Outputs are interpolated linearly onto the record's grid.
    Raises IdentificationError for a channel or window that is not there, and a segment that does not fit 1.5 times.
    """
    check_segment(record, length)
    signals = np.array([grid_signal(record, name) for name in names])
    taper = _taper(window, length)
    starts = np.arange(0, record.steps - length + 1, length // 2)
    # One segment at a time: all at once would need the record's memory many times over.
    size = length if padded is None else padded
    total = np.zeros((size // 2, len(names), len(names)), dtype=np.complex128)
    for start in starts:
        piece = signals[:, start : start + length]
        transform = np.fft.rfft((piece - piece.mean(axis=1, keepdims=True)) * taper, size)[:, 1:].T
        total += transform.conj()[:, :, None] * transform[:, None, :]
    squares = taper**2
    return Spectra(
        tuple(names),
        np.asarray(2.0 * math.pi * np.fft.rfftfreq(size, record.dt)[1:], dtype=np.float64),
        total / starts.size,
        _independent(taper, starts.size, length // 2),
        float(size * (squares @ squares) / squares.sum() ** 2),
        length * record.dt,
    )


def check_segment(record: Record, length: int) -> None:
    """Raises IdentificationError for segments of `length` samples that are too short or fit less than 1.5 times."""
    if length < _FEWEST or 3 * length > 2 * record.steps:
        raise IdentificationError(
            f"segments of {length} samples do not fit at least twice into {record.steps} samples",
            f"record '{record.name}'",
            "use a longer record or a shorter segment",
        )


def grid_signal(record: Record, name: str) -> Array:
    """A channel of the record on its grid: an input as it is held, an output interpolated linearly."""
    if name in record.inputs:
        return record.inputs[name]
    if name in record.outputs:
        samples = record.outputs[name]
        return np.asarray(np.interp(np.arange(record.steps), samples.position, samples.value))
    raise IdentificationError(
        f"the record does not hold {shown(name)}",
        f"record '{record.name}'",
        f"there are: {nearest(name, (*record.inputs, *record.outputs))}",
    )


def _taper(window: str, length: int) -> Array:
    from scipy.signal import get_window  # imported late: most commands start without it

    try:
        return np.asarray(get_window(window, length), dtype=np.float64)
    except (ValueError, TypeError) as reason:
        raise IdentificationError(
            f"no window is called {shown(window)}", "frequency response", "as 'hann' or 'blackman'"
        ) from reason


def _independent(taper: Array, count: int, hop: int) -> float:
    """How many independent segments the overlapping ones are worth (Welch 1967)."""
    energy = float(taper @ taper)
    total = 1.0
    for k in range(1, count):
        if k * hop >= taper.size:
            break
        overlap = float(taper[k * hop :] @ taper[: taper.size - k * hop]) / energy
        total += 2.0 * (1.0 - k / count) * overlap**2
    return count / total
