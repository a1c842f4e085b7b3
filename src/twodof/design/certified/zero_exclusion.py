"""Zero exclusion: a formula that is nowhere 0 over a region, shown by splitting the region until each part tells it.

The zeros of a characteristic polynomial move with its parameters without a jump. Where those of one member are all
inside the stability region, and no member has one on the border, all are inside. See Barmish, New Tools for Robustness
of Linear Systems (1994), chapter 7.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.design.certified.affine import Affine

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_CELLS = 200_000
"""Boxes that are looked at before the question is left open."""

_BATCH = 4096
_DIRECTIONS = np.exp(-1j * np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False))
_EACH = 0.05
_EQUAL = 1e-6
_SURE = 1e-12  # of the formula's size, beyond the roundings that the enclosure has


@dataclass(frozen=True, eq=False)
class Cells:
    """n boxes: `centre` (n, d) and `half` (n, d). Column 0 is the frequency; the others are within a ball.

    `kind` (n,) tells apart boxes on which the formula is another one.
    """

    centre: Array
    half: Array
    kind: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.kind)

    def part(self, which: Bools | slice | NDArray[np.int64]) -> "Cells":
        """Some of them."""
        return Cells(self.centre[which], self.half[which], self.kind[which])

    def split(self, axis: NDArray[np.int64]) -> "Cells":
        """Each cut in two along its own `axis`."""
        each = np.arange(len(self))
        half = self.half.copy()
        half[each, axis] *= 0.5
        left, right = self.centre.copy(), self.centre.copy()
        left[each, axis] -= half[each, axis]
        right[each, axis] += half[each, axis]
        return Cells(np.concatenate([left, right]), np.tile(half, (2, 1)), np.tile(self.kind, 2))

    def joined(self, other: "Cells") -> "Cells":
        """Both."""
        return Cells(
            np.concatenate([self.centre, other.centre]),
            np.concatenate([self.half, other.half]),
            np.concatenate([self.kind, other.kind]),
        )


@dataclass(frozen=True, eq=False)
class ZeroExclusion:
    """`left` are the boxes on which the formula may still be 0; with none of them it is nowhere 0. `looked`: at so many
    boxes.
    """

    left: Cells
    looked: int

    @property
    def proved(self) -> bool:
        """Whether the formula is 0 nowhere in the region."""
        return len(self.left) == 0


def exclude_zero(
    formula: Callable[[Cells], Affine],
    cells: Cells,
    radius: float = math.inf,
    most: int = MOST_CELLS,
    said: Callable[[int, int], bool] = lambda looked, left: False,
) -> ZeroExclusion:
    """Split `cells` until `formula`, which encloses its values on each, leaves out 0 on all of them.

    All columns but the first are in a ball of `radius` about 0. `said` is called with how many boxes were looked at and
    how many are left; where it gives True the search ends, as it does after `most` boxes.
    """
    looked, widest = 0, np.maximum(cells.half.max(axis=0, initial=0.0), 1e-300)

    def enclosed(some: Cells) -> Affine:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return formula(some)

    while len(cells) and looked < most and not said(looked, len(cells)):
        batch, rest = cells.part(slice(0, _BATCH)), cells.part(slice(_BATCH, None))
        batch = batch.part(_inside(batch, radius))
        if len(batch):
            looked += len(batch)
            found = enclosed(batch)
            open_ = ~_without_zero(found, batch, radius)
            batch = batch.part(open_)
        if len(batch):
            slopes = np.abs(found.slopes[open_])
            vague = ~(found.rest[open_] <= slopes.sum(axis=1))
            axis = _axis(slopes, batch.half / widest)
            if vague.any():
                looked += 2 * batch.half.shape[1] * int(vague.sum())
                axis[vague] = _best(enclosed, batch.part(vague), np.abs(found.centre[open_][vague]))
            batch = batch.split(axis)
        # The youngest first: an unstable member shows soon, and few boxes wait.
        cells = batch.joined(rest)
    return ZeroExclusion(cells, looked)


def _inside(cells: Cells, radius: float) -> Bools:
    nearest = np.maximum(0.0, np.abs(cells.centre[:, 1:]) - cells.half[:, 1:])
    return np.asarray((nearest**2).sum(axis=1) <= radius**2)


def _without_zero(found: Affine, cells: Cells, radius: float) -> Bools:
    """Whether a line through 0 has all values of a box on one side."""
    size = np.abs(found.centre)
    need = found.rest + _SURE * size
    slopes = found.slopes
    sure = np.asarray(size - np.abs(slopes).sum(axis=1) > need)
    hard = np.flatnonzero(~sure & np.isfinite(found.rest))
    if not hard.size:
        return sure
    towards = np.conj(found.centre[hard]) / np.where(size[hard] > 0.0, size[hard], 1.0)
    turned = np.concatenate([np.broadcast_to(_DIRECTIONS, (hard.size, len(_DIRECTIONS))), towards[:, None]], axis=1)
    along = (turned * found.centre[hard, None]).real
    tilt = (turned[:, :, None] * slopes[hard, None, :]).real
    box = np.abs(tilt).sum(axis=2)
    if math.isfinite(radius):
        # A box is cut by the ball: of the parameters the smaller of both counts.
        per = tilt[:, :, 1:] / cells.half[hard, None, 1:]
        ball = radius * np.sqrt((per**2).sum(axis=2)) + (per * cells.centre[hard, None, 1:]).sum(axis=2)
        box = np.abs(tilt[:, :, 0]) + np.minimum(np.abs(tilt[:, :, 1:]).sum(axis=2), ball)
    sure[hard] = (along - box > need[hard, None]).any(axis=1)
    return sure


def _axis(slopes: Array, share: Array) -> NDArray[np.int64]:
    """The side along which the formula changes most; each also counts a little by its `share` of its first width."""
    return np.asarray((slopes + _EACH * slopes.sum(axis=1, keepdims=True) * share).argmax(axis=1))


def _best(formula: Callable[[Cells], Affine], cells: Cells, size: Array) -> NDArray[np.int64]:
    """The side whose cut leaves the least of `rest`, where the slopes do not say which it is: each is tried."""
    n, d = cells.half.shape
    left = np.empty((n, d))
    for axis in range(d):
        rest = formula(cells.split(np.full(n, axis, dtype=np.int64))).rest
        # From 0, nothing left, to 1, nothing known.
        known = np.isfinite(rest)
        rest = np.where(known, rest, 0.0)
        share = np.where(known, rest / (rest + np.tile(size, 2) + 1e-300), 1.0)
        left[:, axis] = share.reshape(2, n).sum(axis=0)
    # Where none says anything yet the widest is cut.
    return np.asarray((left - _EQUAL * cells.half / cells.half.max(axis=1, keepdims=True)).argmin(axis=1))
