"""Forward-mode derivatives: each operation against mpmath's numerical derivative, loops, arrays, ties."""

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest

from twodof.blocks import array_of, fold, maximum, minimum, sqrt, store, to_int32, to_real, vector, where
from twodof.blocks.elementary import functions as f
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.derivative import Dual, Tangent
from twodof.blocks.expressions.expr import bits_of, leaf, tracing
from twodof.errors import DiagramError

FUNCTIONS: list[tuple[Callable[..., Any], Callable[..., Any], tuple[float, ...]]] = [
    (lambda x, y: x + y * x - x / y, lambda x, y: x + y * x - x / y, (0.7, -1.3)),
    (lambda x, y: -abs(x - y), lambda x, y: -abs(x - y), (0.7, 1.3)),
    (lambda x, y: sqrt(x * y), lambda x, y: mpmath.sqrt(x * y), (0.7, 1.3)),
    (lambda x, y: f.sin(x) * f.cos(y), lambda x, y: mpmath.sin(x) * mpmath.cos(y), (0.7, 1.3)),
    (lambda x, y: f.tan(x) + f.tanh(y), lambda x, y: mpmath.tan(x) + mpmath.tanh(y), (0.7, 1.3)),
    (lambda x, y: f.asin(x) + f.acos(y), lambda x, y: mpmath.asin(x) + mpmath.acos(y), (0.7, -0.3)),
    (lambda x, y: f.atan(x) - f.atan2(x, y), lambda x, y: mpmath.atan(x) - mpmath.atan2(x, y), (0.7, -1.3)),
    (lambda x, y: f.exp(x) + f.log(y), lambda x, y: mpmath.exp(x) + mpmath.log(y), (0.7, 1.3)),
    (lambda x, y: f.pow(x, y), lambda x, y: mpmath.power(x, y), (0.7, 1.3)),
    (lambda x, y: f.hypot(x, y), lambda x, y: mpmath.hypot(x, y), (0.7, -1.3)),
    (lambda x, y: f.sin_octant(x) * f.cos_octant(y), lambda x, y: mpmath.sin(x) * mpmath.cos(y), (0.3, -0.2)),
    (lambda x, y: minimum(x, maximum(y, 0.0)), lambda x, y: min(x, max(y, 0)), (0.7, 0.3)),
    (lambda x, y: where(x < y, x * x, y), lambda x, y: x * x, (0.7, 1.3)),
    (
        lambda x, y: f.floor(x) * y + to_real(to_int32(x * 3.0)) * x,
        lambda x, y: mpmath.floor(x) * y + 2 * x,
        (0.7, 1.3),
    ),
    (lambda x, y: fold(4, [x], lambda i, s: [s * y + x])[0], lambda x, y: x * (1 + y + y**2 + y**3 + y**4), (0.7, 1.3)),
    (
        lambda x, y: store(array_of(3, lambda i: x * to_real(i)), 1, y * y)[1] + vector([x, y])[to_int32(1.2)],
        lambda x, y: y * y + y,
        (0.7, 1.3),
    ),
]


def tangent(function: Callable[..., Any], at: tuple[float, ...], direction: Any = None) -> tuple[Dual, Tangent]:
    with tracing("test"):
        root = function(leaf("input", "x", "real"), leaf("input", "y", "real"))
    work = Tangent(direction)
    seeds = {"x": Dual(np.float64(at[0]), np.array([1.0, 0.0])), "y": Dual(np.float64(at[1]), np.array([0.0, 1.0]))}
    with numbers.precision("float64"):
        (found,) = work.evaluate([root], lambda item: seeds[item.data])
    assert isinstance(found, Dual)
    return found, work


@pytest.mark.parametrize("case", range(len(FUNCTIONS)))
def test_slopes_are_those_that_mpmath_finds(case: int) -> None:
    function, true, at = FUNCTIONS[case]
    found, work = tangent(function, at)
    with mpmath.workdps(40):
        x, y = (mpmath.mpf(v) for v in at)
        expected = [float(mpmath.diff(true, (x, y), orders)) for orders in ((1, 0), (0, 1))]
        value = float(true(x, y))
    # Some ten roundings of numbers near 1, each 1.1e-16.
    assert found.slope is not None
    np.testing.assert_allclose(found.slope, expected, rtol=1e-14, atol=1e-15)
    assert float(found.value) == pytest.approx(value, rel=1e-15)
    assert work.ties == []


def test_at_a_tie_the_direction_chooses_the_branch() -> None:
    for way in (1.0, -1.0):
        found, work = tangent(lambda x, y: abs(x) + maximum(x, y), (0.0, 0.0), np.array([way, 0.0]))
        assert found.slope is not None
        # |x| + max(x, y): to the right of x = 0 > y it is 2 x, to the left -x + y.
        np.testing.assert_array_equal(found.slope, [2.0, 0.0] if way > 0 else [-1.0, 1.0])
        assert len(work.ties) == 2


def test_a_constant_has_no_slope_and_bit_patterns_none_to_give() -> None:
    assert tangent(lambda x, y: where(x < y, 1.0, 2.0), (0.0, 1.0))[0].slope is None
    with tracing("test"):
        bits = bits_of(leaf("input", "x", "real"))
    work = Tangent()
    with pytest.raises(DiagramError, match="no derivative"), numbers.precision("float64"):
        work.evaluate([bits], lambda item: Dual(np.float64(1.0), np.array([1.0])))
