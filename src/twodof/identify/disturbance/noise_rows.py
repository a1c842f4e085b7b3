"""The rows of a problem that share one noise: where they are, where they have gaps, and where they are louder."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import pieces_of
from twodof.identify.disturbance.loudness import Loudness, loudness, moves
from twodof.identify.problem import Problem

Array = NDArray[np.float64]


class NoiseRows:
    """The rows of the blocks of one noise. `pieces` (of them) have no gap inside.

    `deviation` (size,) is the standard deviation of the prediction errors over their root mean square.
    """

    def __init__(self, problem: Problem, blocks: Sequence[int]) -> None:
        self._problem, self._blocks = problem, tuple(blocks)
        own = [problem.blocks[k] for k in blocks]
        rows = np.concatenate([np.arange(block.rows.start, block.rows.stop) for block in own])
        # A slice is a view: most flights are one record.
        self.rows = own[0].rows if len(own) == 1 else rows
        self.size = int(rows.size)
        found, start = [], 0
        for block in own:
            position = problem.records[block.record].outputs[block.output].position
            found += [slice(start + piece.start, start + piece.stop) for piece in pieces_of(position)]
            start += position.size
        self.pieces = tuple(found)
        self.loud: Loudness | None = None
        self.deviation = np.ones(self.size)

    def listen(self, error: Array) -> None:
        """Find how loud the noise is where an input has moved, from its white `error`."""
        self.loud, self.deviation = loudness(error, self._moves), np.ones(self.size)
        if self.loud is not None:
            place = self.loud.input, self.loud.window
            moved = next(size for name, window, size in self._moves if (name, window) == place)
            variance = self.loud.variance(moved)
            self.deviation = np.sqrt(variance * float(np.mean(error**2 / variance) / np.mean(error**2)))

    @cached_property
    def _moves(self) -> tuple[tuple[str, int, Array], ...]:
        return tuple(moves(self._problem, self._blocks))
