"""Arithmetic, elementary functions and routing against numpy, element by element."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.blocks.library.harness import assert_close, few, noise, run, run_y
from twodof.blocks.block import Block
from twodof.blocks.diagram import Diagram
from twodof.blocks.library import (
    Abs,
    Atan2,
    Bias,
    Concatenate,
    Convert,
    Demux,
    Divide,
    DotProduct,
    Elementary,
    Gain,
    Hypot,
    Index,
    MatrixGain,
    MatrixMultiply,
    Maximum,
    Minimum,
    MultiportSwitch,
    Mux,
    Norm,
    Polynomial,
    Power,
    Product,
    Remainder,
    Reshape,
    Rounding,
    Selector,
    Sign,
    Sum,
    SumOfElements,
    Switch,
    Transpose,
    Trigonometry,
)
from twodof.blocks.reference import Reference

A, B, C = noise(12, 1), noise(12, 2), noise(12, 3)
INTEGERS = np.array([-(2**31), -7, -3, -1, 0, 1, 2, 7, 2**31 - 1])

WIDE = A.reshape(4, 3)


@pytest.mark.parametrize(
    ("block", "inputs", "expected"),
    [
        (Sum("+-+"), {"a": A, "b": B, "c": C}, A - B + C),
        (Sum("-"), {"a": A}, -A),
        (Sum("+-", width=3), {"a": WIDE, "b": B.reshape(4, 3)}, (A - B).reshape(4, 3)),
        (Product("*/*"), {"a": A, "b": B, "c": C}, A / B * C),
        (Product("/"), {"a": A}, 1 / A),
        (Divide(), {"a": A, "b": B}, A / B),
        (Gain(2.5), {"u": A}, 2.5 * A),
        (Gain(2.5, width=3), {"u": WIDE}, 2.5 * WIDE),
        (Bias(2.5), {"u": A}, 2.5 + A),
        (SumOfElements(3), {"u": WIDE}, WIDE[:, 0] + WIDE[:, 1] + WIDE[:, 2]),
        (Polynomial([2.0, -1.0, 0.5]), {"u": A}, (2 * A - 1) * A + 0.5),
        (Abs(), {"u": A}, np.abs(A)),
        (Sign(), {"u": np.array([-2.0, 0.0, 3.0])}, np.array([-1.0, 0.0, 1.0])),
        (Minimum(3), {"a": A, "b": B, "c": C}, np.minimum(np.minimum(A, B), C)),
        (Maximum(3), {"a": A, "b": B, "c": C}, np.maximum(np.maximum(A, B), C)),
        (Rounding("nearest"), {"u": np.array([-2.5, -0.4, 0.5, 1.4, 2.5])}, np.array([-3, 0, 1, 1, 3])),
        (Rounding("floor"), {"u": 3 * A}, np.floor(3 * A)),
        (Rounding("ceil"), {"u": 3 * A}, np.ceil(3 * A)),
        (Rounding("trunc"), {"u": 3 * A}, np.trunc(3 * A)),
        (Elementary("square"), {"u": A}, A * A),
        (Elementary("reciprocal"), {"u": A}, 1 / A),
        (Elementary("sqrt"), {"u": np.abs(A)}, np.sqrt(np.abs(A))),
        (Switch(), {"condition": A > 0, "a": B, "b": C}, np.where(A > 0, B, C)),
        (Mux(3), {"a": A, "b": B, "c": C}, np.stack((A, B, C), axis=1)),
        (Selector(3, [2, 0]), {"u": WIDE}, WIDE[:, [2, 0]]),
        (Selector(3, [1]), {"u": WIDE}, WIDE[:, 1]),
        (Index(3), {"u": WIDE, "index": np.array([-5, 1, 2, 9])}, WIDE[np.arange(4), [0, 1, 2, 2]]),
        (Concatenate([3, 1]), {"a": WIDE, "b": B[:4, None]}, np.concatenate((WIDE, B[:4, None]), axis=1)),
        (
            MultiportSwitch(3),
            {"index": np.array([-1, 0, 1, 2, 3]), "a": A[:5], "b": B[:5], "c": C[:5]},
            np.array([A[0], A[1], B[2], C[3], C[4]]),
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Block) else "",
)
def test_exactly_numpy(block: Block, inputs: dict[str, np.ndarray], expected: np.ndarray) -> None:
    rows = run(block, len(expected), inputs=inputs)
    np.testing.assert_array_equal(rows["y"], expected)


def test_demux_takes_apart_what_mux_puts_together() -> None:
    rows = run(Demux(3), 4, inputs={"u": WIDE})
    np.testing.assert_array_equal(np.stack([rows[k] for k in "abc"], axis=1), WIDE)


def test_sums_over_elements_are_numpys() -> None:
    other = B.reshape(4, 3)
    rows = run(DotProduct(3), 4, inputs={"a": WIDE, "b": other})
    assert_close(rows["y"], np.sum(WIDE * other, axis=1))
    K = noise(6, 9).reshape(2, 3)
    assert_close(run_y(MatrixGain(K.tolist()), WIDE), WIDE @ K.T)
    assert_close(run_y(MatrixGain(K[:1].tolist()), WIDE), WIDE @ K[0])
    assert_close(run_y(MatrixGain(K[:, :1].tolist()), A), np.outer(A, K[:, 0]))


@pytest.mark.parametrize(
    ("block", "function", "domain"),
    [
        *((Trigonometry(n), getattr(np, n), 3.0) for n in ("sin", "cos", "tan", "tanh")),
        (Trigonometry("asin"), np.arcsin, 1.0),
        (Trigonometry("acos"), np.arccos, 1.0),
        (Trigonometry("atan"), np.arctan, 9.0),
        (Elementary("exp"), np.exp, 5.0),
    ],
    ids=lambda value: getattr(value, "function", ""),
)
def test_functions_of_one_argument(block: Block, function: Callable[[Any], Any], domain: float) -> None:
    u = np.linspace(-domain, domain, 41)
    # 2.5 ulp of ours (docs/explanation/language.md) and 1 of numpy's.
    np.testing.assert_allclose(run_y(block, u), function(u), rtol=8e-16, atol=1e-16)


def test_functions_of_two_arguments() -> None:
    both = {"a": A, "b": B}
    for block, function in ((Atan2(), np.arctan2), (Hypot(), np.hypot)):
        np.testing.assert_allclose(run(block, 12, inputs=both)["y"], function(A, B), rtol=8e-16)
    base = {"a": np.abs(A), "b": B}
    np.testing.assert_allclose(run(Power(), 12, inputs=base)["y"], np.abs(A) ** B, rtol=8e-16)
    np.testing.assert_allclose(run_y(Elementary("log"), np.abs(A)), np.log(np.abs(A)), rtol=8e-16)


def test_a_remainder_has_the_sign_that_is_promised() -> None:
    both = {"a": 10 * A, "b": B}
    np.testing.assert_allclose(run(Remainder(), 12, inputs=both)["y"], np.mod(10 * A, B), rtol=0, atol=1e-13)
    integers = {"a": np.array([7, -7, 7, -7, 5]), "b": np.array([3, 3, -3, -3, 0])}
    assert run(Remainder("int32"), 5, inputs=integers)["y"].tolist() == [1, -1, 1, -1, 0]


def test_integers_wrap_and_truncate() -> None:
    n = len(INTEGERS)
    one = np.ones(n, dtype=int)
    wrapped = (INTEGERS + 1 + 2**31) % 2**32 - 2**31
    assert run(Sum(kind="int32"), n, inputs={"a": INTEGERS, "b": one})["y"].tolist() == wrapped.tolist()
    assert run_y(Abs("int32"), INTEGERS).tolist() == [-(2**31), 7, 3, 1, 0, 1, 2, 7, 2**31 - 1]
    assert run_y(Sign("int32"), INTEGERS).tolist() == np.sign(INTEGERS).tolist()
    quotient = run(Divide("int32"), 4, inputs={"a": [7, -7, 5, -(2**31)], "b": [2, 2, 0, -1]})["y"]
    assert quotient.tolist() == [3, -3, 0, -(2**31)]
    largest = run(Maximum(kind="uint32"), 2, inputs={"a": [1, 2**32 - 1], "b": [2, 3]})["y"]
    assert largest.tolist() == [2, 2**32 - 1]


@few
@given(st.floats(width=64), st.floats(width=64))
def test_extremes_mean_what_the_language_says(a: float, b: float) -> None:
    inputs = {"a": [a], "b": [b]}
    low, high = run(Minimum(), 1, inputs=inputs)["y"][0], run(Maximum(), 1, inputs=inputs)["y"][0]
    assert str(low) == str(np.float64(min(b, a)))
    assert str(high) == str(np.float64(max(b, a)))


@pytest.mark.parametrize(
    ("block", "values", "expected"),
    [
        (Convert("real", "int32"), [-2.7, 2.7, np.nan, 1e20, -1e20], [-2, 2, 0, 2**31 - 1, -(2**31)]),
        (Convert("real", "uint32"), [-2.7, 2.7, np.nan, 1e20], [0, 2, 0, 2**32 - 1]),
        (Convert("real", "int32", "nearest"), [-2.5, 2.4, 2.5], [-3, 2, 3]),
        (Convert("real", "int32", "floor"), [-2.5, 2.5], [-3, 2]),
        (Convert("real", "bool"), [0.0, -0.0, 0.1, np.nan], [False, False, True, True]),
        (Convert("int32", "uint32"), [-1, 5], [2**32 - 1, 5]),
        (Convert("uint32", "int32"), [2**32 - 1, 5], [-1, 5]),
        (Convert("uint32", "real"), [2**32 - 1], [4294967295.0]),
        (Convert("bool", "real"), [True, False], [1.0, 0.0]),
        (Convert("bool", "int32"), [True, False], [1, 0]),
        (Convert("int32", "bool"), [0, -4], [False, True]),
        (Convert("bool", "bool"), [True, False], [True, False]),
    ],
    ids=lambda value: f"{value.source}-{value.target}" if isinstance(value, Convert) else "",
)
def test_conversions(block: Convert, values: list[Any], expected: list[Any]) -> None:
    assert run_y(block, values).tolist() == expected


def test_products_transposes_norms_and_reshapes_are_those_of_numpy() -> None:
    a, b = A[:6].reshape(2, 3), B.reshape(3, 4)
    d = Diagram("algebra")
    d.input("a", shape=(2, 3))
    d.input("b", shape=(3, 4))
    d.add("product", MatrixMultiply([2, 3], [3, 4]), a="a", b="b")
    d.add("turned", Transpose([2, 4]), u="product")
    d.add("flat", Reshape([4, 2], [8]), u="turned")
    d.add("size", Norm([4, 2]), u="turned")
    for name in d.parts:
        d.output(name, name)
    out = Reference(d, 0.1).machine().step({"a": a, "b": b})
    assert_close(np.array(out["product"]), a @ b)
    assert_close(np.array(out["turned"]), (a @ b).T)
    assert_close(np.array(out["flat"]), (a @ b).T.ravel(order="F"))
    assert_close(np.array(out["size"]), np.array(np.linalg.norm(a @ b)))
