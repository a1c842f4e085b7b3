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
    even = -0.5 * error.size * np.log(square.mean())
    best, gain = None, _CERTAIN
    for name, window, size in moved:
        largest = float(size.max())
        for half in largest * _HALVES if largest > 0.0 else ():
            share = size**2 / (size**2 + half**2)
            variance = 1.0 + np.outer(_STRENGTHS, share)
            logs = -0.5 * error.size * np.log((square / variance).mean(axis=1)) - 0.5 * np.log(variance).sum(axis=1)
            k = int(np.argmax(logs))
            if float(logs[k]) - even > gain:
                gain = float(logs[k]) - even
                best = Loudness(name, window, float(_STRENGTHS[k]), float(half))
    return best


def _range_before(values: Array, window: int) -> Array:
    """Largest less smallest of the `window` values before each one, shape as `values`."""
    before = np.concatenate([np.full(window, values[0]), values[:-1]])
    seen = np.lib.stride_tricks.sliding_window_view(before, window)[-values.size :]
    return np.asarray(seen.max(axis=1) - seen.min(axis=1))
