"""Sensitivity: S = 1 / (1 + L) and T = L / (1 + L) of a loop, and the largest size of a transfer."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.design.closed_loop_poles import feedback_gain
from twodof.design.loop_transfer import LoopTransfer
from twodof.design.structured_hinf import peak_gain

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Transfer `direct` + `share` S of a loop, with S = 1 / (1 + L): T, for example, has direct 1 and share -1."""

    loop: LoopTransfer
    share: float
    direct: float

    @cached_property
    def matrices(self) -> LoopTransfer | None:
        """The transfer as matrices, finite also where L has a pole; None if the loop has a continuous delay."""
        if self.loop.delay:
            return None
        k, one = feedback_gain(self.loop), self.loop
        return LoopTransfer(
            one.a - k * one.b @ one.c, k * one.b, -self.share * k * one.c, self.direct + self.share * k, one.dt
        )

    def response(self, omega: ArrayLike) -> Complex:
        """Return the frequency response at `omega` [rad/s], shape (k,)."""
        if self.matrices is not None:
            return self.matrices.response(omega)
        return np.asarray(self.direct + self.share / (1.0 + self.loop.response(omega)))


def largest(of: Sensitivity, grid: Array) -> tuple[float, float]:
    """Return (size, frequency [rad/s]) of the largest |of| over all frequencies.

    It is the highest peak on `grid` [rad/s], refined. Without a continuous delay no higher peak is missed.
    """
    best, place = _peak(of.response, grid)
    if (own := of.matrices) is not None:
        return max((best, place), peak_gain(own.a, own.b, own.c, np.array([[own.d]]), own.dt))
    for omega, value in ((0.0, of.response(0.0)[0]), (np.inf, of.direct + of.share)):
        if np.isfinite(value) and abs(value) > best:
            best, place = float(abs(value)), omega
    return best, place


def _peak(of: Callable[[Array], Complex], grid: Array) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar  # imported late: most commands start without it

    sizes = np.abs(of(grid))
    grid, sizes = grid[np.isfinite(sizes)], sizes[np.isfinite(sizes)]
    top = float(sizes.max(initial=0.0))
    best, place = top, float(grid[int(np.argmax(sizes))]) if grid.size else 0.0
    inner = np.flatnonzero((sizes[1:-1] >= sizes[:-2]) & (sizes[1:-1] >= sizes[2:])) + 1
    for k in inner[sizes[inner] > 0.8 * top]:
        found = minimize_scalar(
            lambda x: -float(np.abs(of(np.exp(np.atleast_1d(x))))[0]),
            bounds=(float(np.log(grid[k - 1])), float(np.log(grid[k + 1]))),
            method="bounded",
            options={"xatol": 1e-12},
        )
        if -found.fun > best:
            best, place = float(-found.fun), float(np.exp(found.x))
    return best, place


@dataclass(frozen=True)
class DiskMargin:
    """The loop stays stable for every factor (1 + (1 - skew) d / 2) / (1 - (1 + skew) d / 2), |d| < `alpha`, d complex.

    `alpha` is 1 / max |S + (skew - 1) / 2|, at the frequency `omega` [rad/s]: Seiler, Packard and Gahinet, An
    Introduction to Disk Margins, IEEE Control Systems 40-5 (2020), theorem 1. Skew 0 is balanced between S and T,
    1 measures S and -1 measures T.
    """

    alpha: float
    skew: float
    omega: float

    @property
    def gain(self) -> tuple[float, float]:
        """Factors (low, high) between which the gain alone may change; low may be < 0, and high infinite."""
        up, down = 1.0 - self.skew, 1.0 + self.skew
        low = (2.0 - self.alpha * up) / (2.0 + self.alpha * down)
        rest = 2.0 - self.alpha * down
        return low, (2.0 + self.alpha * up) / rest if rest > 0.0 else math.inf

    @property
    def phase(self) -> float:
        """Largest change of the phase alone, either way [rad], at most pi: equation (15) of the paper named above."""
        low, high = self.gain
        if math.isinf(high):
            cosine = low
        else:
            cosine = (1.0 + low * high) / (low + high) if low + high > 0.0 else -1.0
        return math.acos(max(-1.0, min(1.0, cosine)))
