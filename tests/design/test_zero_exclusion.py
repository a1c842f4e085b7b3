"""Affine arithmetic and zero exclusion: enclosures that hold, and published examples whose margins are known."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from twodof.design.certified.affine import Affine
from twodof.design.certified.zero_exclusion import Cells, exclude_zero


def symbol(cells: Cells, column: int) -> Affine:
    """The number of one column on each box."""
    slopes = np.zeros(cells.centre.shape)
    slopes[:, column] = cells.half[:, column]
    return Affine(cells.centre[:, column], slopes, np.zeros(len(cells)))


def boxes(frequencies: np.ndarray, low: list[float], high: list[float]) -> Cells:
    n = len(frequencies) - 1
    centre, half = np.zeros((n, 1 + len(low))), np.zeros((n, 1 + len(low)))
    centre[:, 0], half[:, 0] = 0.5 * (frequencies[1:] + frequencies[:-1]), 0.5 * np.diff(frequencies)
    centre[:, 1:], half[:, 1:] = 0.5 * (np.array(low) + high), 0.5 * (np.array(high) - low)
    return Cells(centre, half, np.zeros(n, dtype=np.int64))


@pytest.mark.parametrize(
    "law",
    [
        lambda x, y: x * y - 3.0 * x + 2.0,
        lambda x, y: (x + 2.5).inverse() * y if isinstance(x, Affine) else y / (x + 2.5),
        lambda x, y: (x * y).exp() if isinstance(x, Affine) else np.exp(x * y),
        lambda x, y: (-8.0 * (x + 1.2)).exp() * y if isinstance(x, Affine) else np.exp(-8.0 * (x + 1.2)) * y,
        lambda x, y: (1j * x * y).exp() if isinstance(x, Affine) else np.exp(1j * x * y),
        lambda x, y: x.within(-0.3, 0.4) - y if isinstance(x, Affine) else x - y,
    ],
)
def test_enclosures_hold(law: Callable[[object, object], object]) -> None:
    rng = np.random.default_rng(2)
    centre, half = rng.uniform(-1.0, 1.0, (400, 2)), rng.uniform(0.0, 0.5, (400, 2))
    cells = Cells(centre, half, np.zeros(400, dtype=np.int64))
    found = law(symbol(cells, 0), symbol(cells, 1))
    assert isinstance(found, Affine)
    checked = 0
    for _ in range(60):
        e = rng.choice([-1.0, 1.0, rng.uniform(-1.0, 1.0)], (400, 2))
        x, y = (centre + half * e).T
        inside = (x >= -0.3) & (x <= 0.4)
        value = law(x, y)
        off = np.abs(value - found.centre - (found.slopes * e).sum(axis=1))
        # `within` speaks of the part that is in its bounds; the others of all
        assert (off <= found.rest * (1.0 + 1e-12))[inside].all()
        checked += int(inside.sum())
    assert checked > 3000
    assert np.median(found.rest[np.isfinite(found.rest)]) < 1.0, "an enclosure that is never tight tells nothing"


def test_an_inverse_about_zero_says_nothing() -> None:
    cells = Cells(np.array([[0.1]]), np.array([[0.2]]), np.zeros(1, dtype=np.int64))
    assert np.isinf(symbol(cells, 0).inverse().rest).all()


@pytest.mark.parametrize("a", [1.0, 10.0])
def test_margin_of_the_spinning_satellite(a: float) -> None:
    """Zhou, Doyle and Glover, Robust and Optimal Control (1996), 10.3, and Skogestad and Postlethwaite, 3.7.1.

    Two gains that are off by d1 and d2 leave s^2 + (2 + d1 + d2) s + 1 + d1 + d2 + (1 + a^2) d1 d2. The loops one at a
    time have margin 1; both at once have 1 / sqrt(1 + a^2), at d1 = -d2: mu is sqrt(1 + a^2).
    """

    def proved(margin: float) -> bool:
        def formula(cells: Cells) -> Affine:
            s, d1, d2 = 1j * symbol(cells, 0), symbol(cells, 1), symbol(cells, 2)
            return s * s + (2.0 + d1 + d2) * s + 1.0 + d1 + d2 + (1.0 + a * a) * (d1 * d2)

        # every root is below 1 + the largest coefficient (Cauchy)
        grid = np.linspace(0.0, 6.0 + a * a, 60)
        return exclude_zero(formula, boxes(grid, [-margin] * 2, [margin] * 2), most=40_000).proved

    exact = 1.0 / math.sqrt(1.0 + a * a)
    assert proved(0.99 * exact)
    assert not proved(1.0001 * exact)


def test_sampled_interval_polynomial_is_robust() -> None:
    """[10,20] + [20,30] z + [128,138] z^2 + [260,270] z^3 + 168 z^4: robust by the Polynomial Toolbox's demo 4 (2000).

    Its own value sets are drawn and looked at; Barmish, New Tools for Robustness of Linear Systems (1994) has the like.
    """

    def proved(width: float) -> bool:
        def formula(cells: Cells) -> Affine:
            z = (1j * symbol(cells, 0)).exp()
            b = [symbol(cells, k) for k in range(1, 5)]
            return ((((168.0 * z + 260.0 + b[3]) * z) + 128.0 + b[2]) * z + 20.0 + b[1]) * z + 10.0 + b[0]

        return exclude_zero(formula, boxes(np.linspace(0.0, math.pi, 40), [0.0] * 4, [width] * 4), most=100_000).proved

    assert proved(10.0)
    # and where it ends: a corner of a wider box has a root outside, which the proof must not pass over
    edge = next(
        width
        for width in np.arange(10.0, 300.0, 1.0)
        if max(
            np.abs(np.roots([168.0, 260.0 + w3, 128.0 + w2, 20.0 + w1, 10.0 + w0])).max()
            for w0 in (0.0, width)
            for w1 in (0.0, width)
            for w2 in (0.0, width)
            for w3 in (0.0, width)
        )
        >= 1.0
    )
    assert not proved(float(edge))


def test_it_ends_when_told() -> None:
    cells = boxes(np.linspace(-1.0, 1.0, 5), [-1.0], [1.0])
    found = exclude_zero(lambda c: symbol(c, 0) + symbol(c, 1), cells, said=lambda looked, left: looked > 100)
    assert not found.proved
    assert found.looked < 10_000
