"""Affine: what a formula is on a whole box, enclosed: centre, slopes along each side, and a bound of the rest."""

from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[Any]
"""Of float64 or complex128."""

ROUNDING = 1e-15
"""What an operation in double precision may be off, as a share of its result: five times the unit roundoff."""


class Affine:
    """On each of n boxes the value is centre + sum of slopes_i e_i + e, where |e_i| <= 1 are real, |e| <= rest.

    `centre` (n,), `slopes` (n, k), `rest` (n,). All that the operations leave out goes into `rest`, the roundings too,
    so the enclosure holds. Where it says nothing, as of 1 / x about 0, `rest` is infinite. Centre and slopes may be
    complex. Figueiredo and Stolfi, Affine arithmetic: concepts and applications, Numerical Algorithms 37 (2004).
    """

    def __init__(self, centre: Numbers, slopes: Numbers, rest: Array) -> None:
        self.centre, self.slopes, self.rest = centre, slopes, rest

    @classmethod
    def range(cls, low: Array, high: Array, symbols: int) -> Self:
        """A real number between `low` and `high`, whatever the `symbols` are."""
        half = 0.5 * (high - low)
        return cls(low + half, np.zeros((len(low), symbols)), half * (1.0 + ROUNDING))

    @cached_property
    def spread(self) -> Array:
        """How far the value may be from the centre, (n,)."""
        size = np.abs(self.slopes)
        # Column by column: numpy's sum along a short last axis takes ten times as long.
        total = self.rest.copy()
        for k in range(size.shape[1]):
            total += size[:, k]
        return total

    def __add__(self, other: "Affine | Array | float") -> "Affine":
        if not isinstance(other, Affine):
            return Affine(self.centre + other, self.slopes, self.rest + ROUNDING * np.abs(self.centre + other))
        centre = self.centre + other.centre
        rest = self.rest + other.rest + ROUNDING * (np.abs(centre) + np.abs(self.centre))
        return Affine(centre, self.slopes + other.slopes, rest)

    def __neg__(self) -> "Affine":
        return Affine(-self.centre, -self.slopes, self.rest)

    def __sub__(self, other: "Affine | Array | float") -> "Affine":
        return self + -other

    def __rsub__(self, other: float) -> "Affine":
        return -self + other

    def __mul__(self, other: "Affine | float") -> "Affine":
        if not isinstance(other, Affine):
            size = abs(other)
            rest = size * (self.rest + ROUNDING * np.abs(self.centre))
            return Affine(self.centre * other, self.slopes * other, rest)
        a, b = self.centre, other.centre
        slopes = a[:, None] * other.slopes + b[:, None] * self.slopes
        rest = np.abs(a) * other.rest + np.abs(b) * self.rest + self.spread * other.spread
        return Affine(a * b, slopes, rest + 4.0 * ROUNDING * np.abs(a * b))

    __radd__ = __add__
    __rmul__ = __mul__

    def inverse(self) -> "Affine":
        """1 / x: 1/c (1 - d + d^2 / (1 + d)) with d = (x - c) / c; nothing is known where a box may hold 0."""
        size = np.abs(self.centre)
        far = self.spread >= size * (1.0 - 1e-9)
        centre = np.where(far, 1.0, self.centre)
        small = np.where(far, 0.0, self.spread / np.where(far, 1.0, size))
        one = 1.0 / centre
        rest = np.abs(one) * (self.rest * np.abs(one) + small**2 / (1.0 - small) + 4.0 * ROUNDING)
        slopes = np.where(far[:, None], 0.0, -self.slopes * (one * one)[:, None])
        return Affine(one, slopes, np.where(far, np.inf, rest))

    def exp(self) -> "Affine":
        """e^x: e^c (1 + d) and at most e^c d^2/2 e^|d| beyond; real and steep it is told by its ends alone."""
        one, off = np.exp(self.centre), self.spread
        with np.errstate(over="ignore", invalid="ignore"):
            rest = np.abs(one) * (self.rest + 0.5 * off**2 * np.exp(np.minimum(off, 700.0)) + 4.0 * ROUNDING)
            if np.iscomplexobj(one):
                return Affine(one, one[:, None] * self.slopes, rest)
            low, high = np.exp(self.centre - off), np.exp(self.centre + off)
        flat = ~(rest <= 0.5 * (high - low))
        half = 0.5 * (high - low)
        return Affine(
            np.where(flat, low + half, one),
            np.where(flat[:, None], 0.0, one[:, None] * self.slopes),
            np.where(flat, half * (1.0 + 4.0 * ROUNDING) + 4.0 * ROUNDING * high, rest),
        )

    def within(self, low: float | Array, high: float | Array) -> "Affine":
        """The part of a real range that is within the bounds: x there is max(low, min(high, x)), nearly a line."""
        return -((-self._above(low))._above(-high))

    def known_within(self, low: float | Array, high: float | Array) -> "Affine":
        """The same number, real and known to be within the bounds, told by them where they say more than slopes do."""
        least, most = np.maximum(self.centre - self.spread, low), np.minimum(self.centre + self.spread, high)
        more = ~(self.rest <= 0.5 * (most - least))
        some = Affine.range(least, np.maximum(least, most), self.slopes.shape[1])
        return Affine(
            np.where(more, some.centre, self.centre),
            np.where(more[:, None], 0.0, self.slopes),
            np.where(more, some.rest, self.rest),
        )

    def _above(self, low: float | Array) -> "Affine":
        """max(low, x): between its secant over the range and that less the height of the kink."""
        least, most = self.centre - self.spread, self.centre + self.spread
        width = np.where(most > least, most - least, 1.0)
        slope = np.where(least >= low, 1.0, np.clip((most - low) / width, 0.0, 1.0))
        kink = np.where(least >= low, 0.0, slope * (low - least))
        start = np.where(least >= low, least, low)
        centre = start + slope * (self.centre - least) - 0.5 * kink
        rest = slope * self.rest + 0.5 * kink + 4.0 * ROUNDING * (np.abs(centre) + np.abs(self.centre))
        return Affine(centre, slope[:, None] * self.slopes, rest)
