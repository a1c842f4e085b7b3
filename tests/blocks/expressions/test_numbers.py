"""The reference's integers against C's, by definition: wrap, truncate, zero for a zero divisor, masked shifts."""

import ctypes

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import Int32, UInt32, Vector
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

INT = st.integers(-(2**31), 2**31 - 1) | st.sampled_from([-(2**31), -1, 0, 1, 2**31 - 1])
UINT = st.integers(0, 2**32 - 1) | st.sampled_from([0, 1, 2**31, 2**32 - 1])


@given(INT, INT)
def test_int32_wraps_like_the_machine(a: int, b: int) -> None:
    for ours, exact in ((Int32(a) + Int32(b), a + b), (Int32(a) - Int32(b), a - b), (Int32(a) * Int32(b), a * b)):
        assert ours.value == ctypes.c_int32(exact).value


@given(UINT, UINT)
def test_uint32_wraps_like_the_machine(a: int, b: int) -> None:
    for ours, exact in ((UInt32(a) + UInt32(b), a + b), (UInt32(a) - UInt32(b), a - b), (UInt32(a) * UInt32(b), a * b)):
        assert ours.value == exact % 2**32


@given(INT, INT)
def test_division_truncates_and_the_remainder_completes_it(a: int, b: int) -> None:
    quotient, remainder = Int32(a) // Int32(b), Int32(a) % Int32(b)
    if b == 0:
        assert (quotient.value, remainder.value) == (0, 0)
    else:
        assert (quotient * Int32(b) + remainder).value == a
        assert abs(remainder.value) < abs(b)
        assert remainder.value == 0 or (remainder.value < 0) == (a < 0)


def test_the_least_integer_divided_by_minus_one_wraps() -> None:
    least = Int32(-(2**31))
    assert (least // Int32(-1)).value == least.value
    assert (least % Int32(-1)).value == 0
    assert abs(least).value == least.value
    assert (-least).value == least.value


@given(INT, st.integers(0, 200))
def test_shift_counts_are_masked_and_int32_keeps_its_sign(a: int, count: int) -> None:
    assert (Int32(a) >> Int32(count)).value == a >> (count & 31)
    assert (Int32(a) << Int32(count)).value == ctypes.c_int32(a << (count & 31)).value


def test_types_do_not_mix() -> None:
    for bad in (lambda: Int32(1) + UInt32(1), lambda: np.float64(1) + Int32(1), lambda: Int32(1) * 0.5):
        with pytest.raises(DiagramError, match="meets"):
            bad()


def test_a_computed_index_is_clamped_and_a_literal_one_checked() -> None:
    v = Vector([10, 20, 30])
    assert [v[Int32(i)] for i in (-5, 0, 2, 99)] == [10, 10, 30, 30]
    with pytest.raises(DiagramError, match="outside an array of 3"):
        v[3]


def test_a_float64_that_leaks_into_a_float32_run_is_an_error() -> None:
    with numbers.precision("float32"), pytest.raises(DiagramError, match="it takes real"):
        numbers.cast(np.float64(0.5), "real")


def test_identical_knows_signed_zeros_and_one_nan() -> None:
    assert not numbers.identical(np.float64(0.0), np.float64(-0.0))
    assert numbers.identical(np.float64("nan"), -np.float64("nan"))
    assert not numbers.identical(np.float32(1), np.float64(1))
    assert numbers.identical(Vector([np.float64(1), np.float64("nan")]), Vector([np.float64(1), np.float64("nan")]))
