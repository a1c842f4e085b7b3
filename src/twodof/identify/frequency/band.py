"""The Fourier coefficients of an output's samples inside a band, where single samples may be lost."""

import math

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError

Array = NDArray[np.float64]

# Jitter of a tenth of the interval turns the phase at the highest frequency by 18 degrees, in a band by far less.
_JITTER = 0.1
_MOST_LOST = 0.1


class Band:
    """The discrete Fourier coefficients between two frequencies (`low`, `high`) [Hz] of samples at `position` [steps].

    `dt` [s] is the step. The samples are on a uniform clock, of which single ones may be lost, one in ten at most.
    `where` names record and output in errors. Raises IdentificationError for other gaps and for a band without any
    coefficient.
    """

    def __init__(self, band: tuple[float, float], position: Array, dt: float, where: str) -> None:
        self._number = _numbers(position, where)
        self._size = int(self._number[-1]) + 1
        interval = float(position[-1] - position[0]) / (self._size - 1) * dt
        frequency = np.fft.rfftfreq(self._size, interval)
        # The coefficients at 0 and at half the sampling rate are real: they would be rows of another variance.
        inner = (frequency > 0.0) & (frequency < 0.5 / interval * (1.0 - 1e-9))
        self.bins = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & inner)
        if self.bins.size == 0:
            raise IdentificationError(
                f"no Fourier coefficient lies in {band[0]:g} to {band[1]:g} Hz",
                where,
                f"the resolution is {1.0 / (interval * self._size):g} Hz",
            )

    def coefficients(self, error: Array) -> Array:
        """Real parts, then imaginary parts, shape (2 * bins,); white noise keeps its standard deviation.

        The error of a lost sample is taken as that between its neighbours.
        """
        if self._size > error.size:
            error = np.interp(np.arange(self._size), self._number, error)
        spectrum = np.fft.rfft(error)[self.bins] * math.sqrt(2.0 / self._size)
        return np.concatenate([spectrum.real, spectrum.imag])


def _numbers(position: Array, where: str) -> NDArray[np.int64]:
    """The number of each sample on the uniform clock, counting those that are lost."""
    interval = np.diff(position)
    if interval.size:
        count = np.maximum(1.0, np.round(interval / np.median(interval)))
        number = np.concatenate([[0.0], np.cumsum(count)])
        usual = float(position[-1] - position[0]) / number[-1]
        lost = number[-1] + 1.0 - position.size
        even = np.abs(interval - count * usual).max() <= _JITTER * usual
        if even and count.max() <= 2.0 and lost <= _MOST_LOST * position.size:
            return number.astype(np.int64)
    raise IdentificationError(
        "the frequency domain needs samples on a uniform clock, of which at most single ones are lost, one in ten",
        where,
        "fit in the time domain, or resample the log first",
    )
