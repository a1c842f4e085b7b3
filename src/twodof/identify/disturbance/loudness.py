"""Noise that is louder where an input has just moved.

A rotor that turns evenly shakes the gyro evenly, and an autoregression foretells that. A command that has just moved
has changed the rotors' speed, and with it the frequency of what they shake. For some hundredths of a second the noise
is several times as strong as before. Just there an excitation tells most. A fit that takes the noise for even claims
too much.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.identify.problem import Problem

Array = NDArray[np.float64]

_WINDOWS = (8, 16, 32)
"""Samples in which an input counts as having just moved: 32 to 128 ms at 250 Hz."""

_CERTAIN = 12.0
"""Gain of the log likelihood from which on the noise is not even. Twice it is chi-square with the strength, the move
that halves it, input and window to choose: less than one in 10,000 by chance."""

_STRENGTHS = 2.0 ** np.arange(-2.0, 5.5, 0.5)
_HALVES = 2.0 ** np.arange(-6.0, 0.5, 0.5)
"""Strengths (variance over the even one, less 1) and moves, as shares of the largest, that are tried."""

_ALIKE = 1024
"""Sizes of a move that are told apart: 16 of them up to the smallest half."""


@dataclass(frozen=True)
class Loudness:
    """The variance of the noise is 1 + `strength` m^2 / (m^2 + `half`^2) times that at rest.

    m is how far the input moved within the `window` samples before: its largest less its smallest value.
    """

    input: str
    window: int
    strength: float
    half: float

    @property
    def times(self) -> float:
        """Standard deviation after the largest moves, over that at rest."""
        return float(np.sqrt(1.0 + self.strength))

    def variance(self, moved: Array) -> Array:
        """Over that at rest, for moves of these sizes."""
        square = moved**2
        return np.asarray(1.0 + self.strength * square / (square + self.half**2))


def moves(problem: Problem, blocks: Sequence[int]) -> Iterator[tuple[str, int, Array]]:
    """Each input that changes, each window, and how far the input had moved before each row of these blocks.

    A row's own sample does not count. A controller's output answers it, and weights that answer the noise would make
    the estimates wrong.
    """
    for name in problem.structure.inputs:
        whole = [problem.records[problem.blocks[k].record].inputs[name] for k in blocks]
        if not any(float(np.ptp(one)) > 0.0 for one in whole):
            continue
        for window in _WINDOWS:
            ranges = (_range_before(one, window)[problem.blocks[k].when] for k, one in zip(blocks, whole, strict=True))
            yield name, window, np.concatenate(list(ranges))


def loudness(error: Array, moved: Sequence[tuple[str, int, Array]]) -> Loudness | None:
    """The most likely loudness of white `error` (samples,) by what has `moved`; None where it may well be even."""
    square = error**2
    power = float(square.mean())
    best, gain = None, _CERTAIN
    for name, window, size in moved:
        largest = float(size.max())
        # An error that is 0 throughout is the rounding of an exact model, and nothing is louder in it.
        if not (power > 0.0 and largest > 0.0):
            continue
        count, sizes, powers = _by_size(size / largest, square / power)
        for half in _HALVES:
            variance = 1.0 + np.outer(_STRENGTHS, sizes**2 / (sizes**2 + half**2))
            logs = -0.5 * error.size * np.log((powers / variance).sum(axis=1) / error.size)
            logs -= 0.5 * np.log(variance) @ count
            k = int(np.argmax(logs))
            if float(logs[k]) > gain:
                gain = float(logs[k])
                best = Loudness(name, window, float(_STRENGTHS[k]), float(half) * largest)
    return best


def _by_size(size: Array, square: Array) -> tuple[Array, Array, Array]:
    """Rows that moved alike, taken together: how many they are, their mean size, and the sum of their squares.

    So a record of a million samples takes as long as one of a thousand.
    """
    place = np.minimum((size * _ALIKE).astype(np.int64), _ALIKE - 1)
    count, sizes, squares = (
        np.asarray(np.bincount(place, weights, _ALIKE), dtype=np.float64) for weights in (None, size, square)
    )
    there = count > 0.0
    return count[there], sizes[there] / count[there], squares[there]


def _range_before(values: Array, window: int) -> Array:
    """Largest less smallest of the `window` values before each one, shape as `values`."""
    before = np.concatenate([np.full(window, values[0]), values[:-1]])
    seen = np.lib.stride_tricks.sliding_window_view(before, window)[-values.size :]
    return np.asarray(seen.max(axis=1) - seen.min(axis=1))
