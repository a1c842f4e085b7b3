"""PitchRegion: a confidence region of a family, the dead time apart by whole samples, as boxes and members."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from twodof.design.certified.affine import ROUNDING, Affine
from twodof.design.certified.zero_exclusion import Cells
from twodof.design.uncertain.pitch_family import PARAMETERS, PitchFamily, PitchMembers
from twodof.design.uncertain.pitch_loop import NO_LAG
from twodof.signals import PERIOD

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_WIDE, _SHORT = 0.35, 1e-4  # of the lag; [s]
_FIRST = ("dead_time", "lag", "mu", "w_n", "xi")
_JITTER = 1e-10  # of each variance, added: a covariance without one direction keeps its root, the region grows a little


@dataclass(frozen=True, eq=False)
class PitchRegion:
    """Parameters `values` + `root` u, |u| <= `radius`: `root` (5, k) has a row for each of `PARAMETERS`.

    What lies beyond the bounds of `PARAMETERS` is not in the region.
    """

    values: Array
    root: Array
    radius: float

    @classmethod
    def of(cls, family: PitchFamily, radius: float) -> Self:
        """The estimates of `family` up to `radius` standard deviations off, in the metric of its covariance."""
        names = list(PARAMETERS)
        size = np.sqrt(np.maximum(np.diag(family.covariance), 0.0))
        # The dead time is first: then one of u alone tells it, and the region divides by whole samples.
        order = sorted((i for i in range(len(size)) if size[i] > 0.0), key=lambda i: _FIRST.index(family.uncertain[i]))
        root = np.zeros((len(names), len(order)))
        if order:
            scale = size[order]
            shape = family.covariance[np.ix_(order, order)] / np.outer(scale, scale)
            lower = scale[:, None] * np.linalg.cholesky(shape + _JITTER * len(order) * np.eye(len(order)))
            for i, row in zip(order, lower, strict=True):
                root[names.index(family.uncertain[i])] = row
        return cls(np.array([float(family.values[name]) for name in names]), root, radius)

    def cells(self, angles: Array) -> Cells:
        """The region with arcs between `angles` [rad], for each whole number of samples that the dead time may have."""
        k = self.root.shape[1]
        at = list(PARAMETERS).index("dead_time")
        reach = self.radius * float(np.linalg.norm(self.root[at]))
        low, high = (min(max(self.values[at] + s * reach, 0.0), PARAMETERS["dead_time"][1]) for s in (-1.0, 1.0))
        found = None
        for whole in range(max(0, math.floor(low / PERIOD - 1e-9)), math.floor(high / PERIOD) + 1):
            n = len(angles) - 1
            centre, half = np.zeros((n, k + 1)), np.full((n, k + 1), self.radius)
            centre[:, 0], half[:, 0] = 0.5 * (angles[1:] + angles[:-1]), 0.5 * np.diff(angles)
            if k and not self.root[at, 1:].any() and self.root[at, 0] > 0.0:
                # The first of u says which kind it is: no box then reaches into another kind.
                ends = (np.array([whole, whole + 1]) * PERIOD - self.values[at]) / self.root[at, 0]
                ends = np.clip(ends + np.array([-1e-9, NO_LAG / self.root[at, 0]]), -self.radius, self.radius)
                centre[:, 1], half[:, 1] = ends.mean(), 0.5 * np.diff(ends)
            kind = np.full(n, whole, dtype=np.int64)
            some = Cells(centre, half, kind)
            found = some if found is None else found.joined(some)
        assert found is not None
        return self._cut_by_lag(found)

    def _cut_by_lag(self, cells: Cells) -> Cells:
        """Cut along the lag until its ends differ by a factor of two or so: e^(-t / lag) is far from a line."""
        done, k = None, self.root.shape[1]
        while k and len(cells):
            lag = self._free(cells)["lag"]
            wide = (lag.spread > _WIDE * np.abs(lag.centre)) & (lag.spread > _SHORT)
            gone = lag.centre + lag.spread < 0.0
            ready = cells.part(~wide & ~gone)
            done = ready if done is None else done.joined(ready)
            rest = wide & ~gone
            cells = cells.part(rest)
            cells = cells.split(np.abs(lag.slopes[rest]).argmax(axis=1)) if len(cells) else cells
        return cells if done is None else done

    def parameters(self, cells: Cells) -> dict[str, Affine]:
        """Each parameter on each box."""
        return {name: one.within(*PARAMETERS[name]) for name, one in self._free(cells).items()}

    def beyond(self, cells: Cells) -> Bools:
        """Which boxes hold nothing within the bounds of `PARAMETERS`."""
        found = np.zeros(len(cells), dtype=bool)
        for name, one in self._free(cells).items():
            low, high = PARAMETERS[name]
            found |= (one.centre + one.spread < low) | (one.centre - one.spread > high)
        return found

    def members(self, cells: Cells) -> PitchMembers:
        """Those at the centres of the boxes, kept in the region."""
        u = cells.centre[:, 1:]
        size = np.linalg.norm(u, axis=1, keepdims=True)
        rows = self.values + (u * np.minimum(1.0, self.radius / np.maximum(size, 1e-300))) @ self.root.T
        return PitchMembers(**{name: np.clip(rows[:, i], *PARAMETERS[name]) for i, name in enumerate(PARAMETERS)})

    def _free(self, cells: Cells) -> dict[str, Affine]:
        found = {}
        n, k = cells.centre.shape
        for i, name in enumerate(PARAMETERS):
            # A sum, for a matrix product of this size would be shared out among threads.
            centre = self.values[i] + (cells.centre[:, 1:] * self.root[i]).sum(axis=1)
            slopes = np.zeros((n, k))
            slopes[:, 1:] = self.root[i] * cells.half[:, 1:]
            found[name] = Affine(centre, slopes, 4.0 * ROUNDING * np.abs(centre))
        return found
