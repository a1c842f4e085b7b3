"""What is known of unknowns before the flight, as rows of the least-squares problem."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError

Array = NDArray[np.float64]


class Prior:
    """Normal distributions of some entries of x: each is one more row, (x - mean) / deviation.

    `places` are the entries, each with its (mean, standard deviation).
    """

    def __init__(self, places: Sequence[tuple[int, tuple[float, float]]], size: int) -> None:
        self.index = np.array([place for place, _ in places], dtype=np.int64)
        self.mean = np.array([mean for _, (mean, _) in places])
        self.deviation = np.array([deviation for _, (_, deviation) in places])
        self.slopes = np.zeros((len(places), size))
        self.slopes[np.arange(len(places)), self.index] = 1.0 / self.deviation

    def __len__(self) -> int:
        return self.index.size

    def rows(self, x: Array) -> Array:
        """How far x is from what was known, in standard deviations."""
        return np.asarray((x[self.index] - self.mean) / self.deviation)


def check_prior(prior: Mapping[str, tuple[float, float]], unknowns: Sequence[str], where: str) -> None:
    """Raises IdentificationError for a name that is not an unknown, and for no mean or no standard deviation.

    A standard deviation may be infinite: then nothing is known.
    """
    for name, given in prior.items():
        if name not in unknowns:
            raise IdentificationError(f"no unknown is called '{name}'", where, f"there are: {', '.join(unknowns)}")
        try:
            mean, deviation = (float(one) for one in given)
            right = math.isfinite(mean) and deviation > 0.0
        except (TypeError, ValueError):
            right = False
        if not right:
            raise IdentificationError(
                f"the prior of '{name}' is {given!r:.80}", where, "give (mean, standard deviation), the latter above 0"
            )
