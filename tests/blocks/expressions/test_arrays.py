"""Vectors and matrices as blocks see them: numpy is the judge, on numbers and on recorded graphs alike."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twodof.blocks import (
    array_of,
    concatenate,
    cross,
    diag,
    eye,
    int32,
    matrix,
    maximum,
    minimum,
    norm,
    outer,
    sqrt,
    sum,
    to_int32,
    to_real,
    vector,
    where,
    zeros,
)
from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.arrays import flat_of, shape_of, shaped
from twodof.blocks.expressions.expr import Expr, leaf, tracing
from twodof.blocks.expressions.graph import evaluate
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

SIZES = st.integers(1, 10)
SEEDS = st.integers(0, 2**32 - 1)
Array = NDArray[np.float64]


def some(seed: int, *shape: int) -> Array:
    return np.random.default_rng(seed).normal(size=shape)


def given_as(value: Array, leaf_name: str = "") -> Any:
    """An array of the language: numbers, or, with a name, the leaf that stands for them."""
    flat = leaf("input", leaf_name, "real", value.size) if leaf_name else numbers.Vector(value.ravel(order="F"))
    shape = (value.shape[0], value.shape[1]) if value.ndim == 2 else None
    return shaped(flat, shape)


def as_numpy(value: Any) -> Array:
    return np.array(flat_of(value), np.float64).reshape(shape_of(value), order="F")


def both_ways(f: Callable[..., Any], *values: Array) -> Array:
    """`f` on numbers, after it has given the same bits when it is recorded and then computed."""
    names = [f"a{i}" for i in range(len(values))]
    direct = f(*map(given_as, values))
    with tracing("test"):
        recorded = f(*map(given_as, values, names))
    flats = dict(zip(names, (flat_of(given_as(v)) for v in values), strict=True))
    root = flat_of(recorded)
    assert isinstance(root, Expr)
    (computed,) = evaluate([root], lambda item: flats[item.data], FUNCTIONS)
    assert shape_of(recorded) == shape_of(direct)
    assert np.array(computed).tobytes() == np.array(flat_of(direct)).tobytes()
    return as_numpy(direct)


@given(st.integers(1, 8), st.integers(1, 8), SEEDS)
@settings(max_examples=20)
def test_operators_and_functions_go_element_by_element_as_in_numpy(rows: int, columns: int, seed: int) -> None:
    a, b = some(seed, rows, columns), some(seed + 1, rows, columns)
    for ours, theirs in (
        (lambda a, b: (2 * a + b / 2 - 1) * -b, lambda a, b: (2 * a + b / 2 - 1) * -b),
        (lambda a, b: where((a < b) & (b >= 0), a, 3.0), lambda a, b: np.where((a < b) & (b >= 0), a, 3.0)),
        (lambda a, b: minimum(a, b) + maximum(a, 0), lambda a, b: np.minimum(a, b) + np.maximum(a, 0)),
        (lambda a, b: sqrt(abs(a)) - 1 / b, lambda a, b: np.sqrt(np.abs(a)) - 1 / b),
    ):
        assert both_ways(ours, a, b).tobytes() == theirs(a, b).tobytes()
        assert both_ways(ours, a[0], b[0]).tobytes() == theirs(a[0], b[0]).tobytes()


@given(SIZES, SIZES, SIZES, SEEDS)
@settings(max_examples=20)
def test_a_product_sums_from_the_left_and_agrees_with_numpy(rows: int, inner: int, columns: int, seed: int) -> None:
    a, b = some(seed, rows, inner), some(seed + 1, inner, columns)
    found = both_ways(lambda a, b: a @ b, a, b)
    exact = a[:, :1] * b[:1]
    for k in range(1, inner):
        exact = exact + a[:, k : k + 1] * b[k : k + 1]
    assert found.tobytes() == exact.tobytes()
    assert np.all(np.abs(found - a @ b) <= inner * np.finfo(float).eps * (np.abs(a) @ np.abs(b)))
    assert np.array_equal(both_ways(lambda a, b: a @ b[:, -1], a, b), exact[:, -1])
    assert np.array_equal(both_ways(lambda a, b: a[0] @ b, a, b), exact[0])
    assert np.array_equal(both_ways(lambda a, b: a[-1] @ b[:, 0], a, b), exact[-1, 0])
    assert np.array_equal(both_ways(lambda a, b: (b.T @ a.T).T, a, b), exact)


def test_operators_on_more_elements_than_are_written_out_are_a_loop_of_the_same_bits() -> None:
    a = some(1, 11, 6)
    assert both_ways(lambda a: where(a < 0, -a, 2 * a), a).tobytes() == np.where(a < 0, -a, 2 * a).tobytes()


def test_an_array_of_arrays_is_all_of_them_one_after_the_other() -> None:
    def table(v: Any) -> Any:
        return array_of(4, lambda i: array_of(3, lambda j: v[i] * to_real(j)))

    v = some(1, 4)
    assert np.array_equal(both_ways(table, v), np.outer(v, [0, 1, 2]).ravel())
    assert np.array_equal(both_ways(lambda v: array_of(3, lambda i: v), v), np.tile(v, 3))
    assert np.array_equal(both_ways(lambda v: array_of(2, lambda i: [v[i], v[-1]]), v), [v[0], v[3], v[1], v[3]])


def test_a_sum_of_many_terms_is_a_loop_of_the_same_bits() -> None:
    a, b = some(1, 3, 50), some(2, 50, 4)
    exact = a[:, :1] * b[:1]
    for k in range(1, 50):
        exact = exact + a[:, k : k + 1] * b[k : k + 1]
    assert both_ways(lambda a, b: a @ b, a, b).tobytes() == exact.tobytes()


def test_a_product_of_minus_zeros_is_minus_zero() -> None:
    assert np.signbit(both_ways(lambda a, b: a @ b, np.array([-0.0]), np.array([1.0])))


@given(st.integers(2, 8), st.integers(2, 8), SEEDS)
@settings(max_examples=20)
def test_slices_indices_and_transposes_are_those_of_numpy(rows: int, columns: int, seed: int) -> None:
    m = some(seed, rows, columns)
    cuts: list[Callable[[Any], Any]] = [
        lambda m: m[:, 0],
        lambda m: m[-1],
        lambda m: m[0:2, 1:],
        lambda m: m[::-1, -1],
        lambda m: m.T,
        lambda m: m[:, 1][0:2],
        lambda m: m[rows - 1, -2],
        lambda m: m[:1].T,
    ]
    for cut in cuts:
        assert np.array_equal(both_ways(cut, m), cut(m))
    picked = both_ways(lambda m: m[to_int32(m[0, 0] * 100), int32(1)], m)
    assert picked == m[np.clip(int(m[0, 0] * 100), 0, rows - 1), 1]


@given(st.integers(1, 5), SEEDS)
@settings(max_examples=20)
def test_the_functions_of_vectors_are_those_of_numpy(size: int, seed: int) -> None:
    v, w, m = some(seed, size), some(seed + 1, size), some(seed + 2, size, size)
    assert np.array_equal(both_ways(outer, v, w), np.outer(v, w))
    assert np.array_equal(both_ways(diag, v), np.diag(v))
    assert np.array_equal(both_ways(diag, m), np.diag(m))
    assert np.array_equal(both_ways(lambda v, w: concatenate([v, w, [1.0]]), v, w), np.concatenate([v, w, [1.0]]))
    assert np.array_equal(both_ways(lambda m: concatenate([m, eye(size)], axis=1), m), np.hstack([m, np.eye(size)]))
    assert np.array_equal(both_ways(lambda m: concatenate([m, zeros(2, size)]), m), np.vstack([m, np.zeros((2, size))]))
    assert np.isclose(both_ways(norm, m), np.linalg.norm(m), rtol=size**2 * 2.3e-16, atol=0)
    assert np.isclose(both_ways(sum, v), np.sum(v), rtol=0, atol=size * 2.3e-16 * np.sum(np.abs(v)))
    a, b = some(seed, 3), some(seed + 1, 3)
    assert np.array_equal(both_ways(cross, a, b), np.cross(a, b))
    assert np.array_equal(both_ways(lambda m: matrix([[1, 2.0], [m[0, 0], 4]]) @ [1, 2], m), [5, m[0, 0] + 8])


def test_lists_and_numpy_arrays_are_operands_and_integers_keep_their_type() -> None:
    def f(a: Any) -> Any:
        return to_int32(a + np.array([1.0, 2.0])) * [3, 4] // vector([int32(2), int32(3)])

    counted = f(numbers.Vector([np.float64(2.5), np.float64(-7.5)]))
    assert [v.value for v in counted] == [4, -6]
    assert as_numpy(np.float64(2) * given_as(np.ones(2)) + [[1, 2]][0]).tolist() == [3, 4]
    assert as_numpy(np.ones((2, 2)) @ given_as(np.ones((2, 2)))).tolist() == [[2, 2], [2, 2]]


V2, V3 = leaf("input", "v", "real", 2), leaf("input", "w", "real", 3)
M = shaped(leaf("input", "m", "real", 6), (2, 3))


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda: V2 + V3, "arrays of 2 and 3 are in one"),
        (lambda: where(V2 < 0, V3, 0.0), "arrays of 2 and 3 are in one"),
        (lambda: M * M.T, "arrays of 2x3 and 3x2 are in one"),
        (lambda: M @ M, "2x3 @ 2x3"),
        (lambda: M @ V2, "2x3 @ 2"),
        (lambda: M @ 2.0, r"2x3 @ a scalar.*write \*"),
        (lambda: V3[1:9], "the slice 1:9 does not fit an array of 3"),
        (lambda: V3[2:1], "the slice 2:1 does not fit an array of 3"),
        (lambda: V3[0 : to_int32(V3[0])], "a bound that is computed"),
        (lambda: V3[-4], "index -4 is outside an array of 3"),
        (lambda: V3[0, 1], "has 2 indices"),
        (lambda: M[0, 3], "index 3 is outside an array of 3"),
        (lambda: M[0, 0, 0], "has 3 indices"),
        (lambda: matrix([[1, 2], [3]]), "different lengths"),
        (lambda: V3 + np.zeros((3, 1, 1)), "more than two dimensions"),
        (lambda: concatenate([M, M.T]), "arrays of 2x3, 3x2 cannot be joined along axis 0"),
        (lambda: cross(V3, V2), "cross cannot take 3 and 2"),
        (lambda: bool(M), "has no truth"),
    ],
)
def test_what_does_not_fit_is_refused_with_both_shapes_block_and_line(mistake: Callable[[], Any], message: str) -> None:
    with tracing("MyBlock"), pytest.raises(DiagramError, match=message) as caught:
        mistake()
    assert caught.value.where.startswith("block MyBlock")
    assert __file__ in caught.value.where
