"""Recorded expressions: typing, hash-consing, the errors that name a user's line, and evaluation as on numbers."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.blocks.expressions import expr, numbers
from twodof.blocks.expressions.arrays import fold, vector
from twodof.blocks.expressions.expr import Expr, leaf, maximum, minimum, to_int32, to_uint32, where
from twodof.blocks.expressions.graph import evaluate, leaves, walk
from twodof.blocks.expressions.numbers import UInt32
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

X = leaf("input", "x", "real")
Y = leaf("input", "y", "real")
I = leaf("input", "i", "int32")
REAL = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from(
    [0.0, -0.0, 5e-324, math.inf, -math.inf, math.nan]
)


def at(root: Expr, **values: object) -> object:
    return evaluate([root], lambda item: values[item.data], {})[0]


def test_equal_expressions_are_one_node_and_signed_zeros_are_two() -> None:
    assert (X + Y) * 2 is (X + Y) * 2.0
    assert expr.const(0.0, "real") is not expr.const(-0.0, "real")


def test_a_condition_on_a_recorded_value_names_block_and_line() -> None:
    def careless() -> int:
        return 1 if X > 0 else 2

    with expr.tracing("rig.cart"), pytest.raises(DiagramError, match=r"rig\.cart.*test_expr\.py:\d+.*where\("):
        careless()


@pytest.mark.parametrize(
    ("bad", "remedy"),
    [
        (lambda: X + I, "to_real"),
        (lambda: I / I, "//"),
        (lambda: X // Y, "floor"),
        (lambda: X**2, "x \\* x"),
        (lambda: math.sin(X), "sin"),
        (lambda: X & Y, "it takes"),
        (lambda: X[0], "index an array"),
        (lambda: range(I), "constant"),
        (lambda: vector([X, I]), "to_real"),
        (lambda: X + np.zeros((1, 1, 1)), "vector"),
    ],
)
def test_what_the_language_lacks_is_refused_with_the_remedy(bad: Callable[[], object], remedy: str) -> None:
    with pytest.raises(DiagramError, match=remedy):
        bad()


@given(REAL, REAL)
def test_recorded_and_computed_agree_to_the_bit(a: float, b: float) -> None:
    def formula(x: object, y: object) -> object:
        low, high = minimum(x, y), maximum(x, y)
        return where(low <= high, (x + y) * 0.1 - abs(x) / y, -high) + expr.sqrt(x)

    with numbers.precision("float32"):
        x, y = np.float32(a), np.float32(b)
        assert numbers.identical(at(formula(X, Y), x=x, y=y), formula(x, y))
    with numbers.precision("float64"):
        assert numbers.identical(
            at(formula(X, Y), x=np.float64(a), y=np.float64(b)), formula(np.float64(a), np.float64(b))
        )


@given(REAL)
def test_real_to_integer_truncates_saturates_and_makes_zero_of_nan(a: float) -> None:
    with numbers.precision("float64"):
        signed, unsigned = to_int32(np.float64(a)), to_uint32(np.float64(a))
    if math.isnan(a):
        assert (signed.value, unsigned.value) == (0, 0)
    else:
        inside = max(min(a, 1e12), -1e12)
        assert signed.value == min(max(math.trunc(inside), -(2**31)), 2**31 - 1)
        assert unsigned.value == min(max(math.trunc(inside), 0), 2**32 - 1)


def test_loops_stay_loops_and_compute_the_same() -> None:
    coefficients = [0.5, -1.0, 2.0, 4.0]

    def horner(x: object) -> object:
        c = (
            vector([expr.real(v) for v in coefficients])
            if not isinstance(x, Expr)
            else vector([x * 0 + v for v in coefficients])
        )
        return fold(4, [x * 0], lambda i, s: [s * x + c[3 - i]])[0]

    with expr.tracing("horner"):
        recorded = horner(X)
    assert sum(n.op == "fold" for n in walk([recorded])) == 1
    assert sum(n.op == "add" for n in walk([recorded])) == 5  # one in the body, four in the vector
    with numbers.precision("float64"):
        assert at(recorded, x=np.float64(1.5)) == np.polyval([4.0, 2.0, -1.0, 0.5], 1.5)
        assert horner(np.float64(1.5)) == np.polyval([4.0, 2.0, -1.0, 0.5], 1.5)


def test_a_deep_graph_is_walked_without_recursion() -> None:
    deep = X
    for _ in range(10_000):
        deep = deep + 1.0
    assert len(walk([deep])) == 10_002
    assert leaves([deep], "input") == {"x"}
    with numbers.precision("float64"):
        assert at(deep, x=np.float64(0)) == 10_000


def test_bits_of_nan_are_canonical() -> None:
    with numbers.precision("float32"):
        quiet = expr.bits_of(np.float32("nan")).value
        assert expr.bits_of(-np.float32("nan")).value == quiet == 0x7FC00000
        assert expr.from_bits(UInt32(0x3F800000)) == np.float32(1)
    with numbers.precision("float64"):
        assert expr.bits_of(np.float64(1), 1).value == 0x3FF00000
        assert expr.from_bits(UInt32(0), UInt32(0x3FF00000)) == np.float64(1)
