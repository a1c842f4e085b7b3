"""Noise: the generator against its published answers, its numbers against their distribution.

All seeds are fixed. A statistic may stray 5 standard deviations: for each one, 6e-7 of all good generators would stray
further. A p-value may be as small as 1e-5. A bad generator exceeds both by far at these lengths.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tests.blocks.elementary.numpy_evaluation import evaluate
from twodof.blocks import noise
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import Expr, leaf, tracing

pytestmark = pytest.mark.slow

N = 1 << 18
SIGMAS = 5.0
P_VALUE = 1e-5
both = pytest.mark.parametrize("precision", ["float64", "float32"])


def draw(
    what: Callable[..., Any], precision: str = "float64", *, seed: Any = 1, stream: Any = 0, first: int = 0, n: int = N
) -> NDArray[Any]:
    """One row for each number that `what` gives, over the ticks `first` .. `first + n - 1`."""
    with tracing("noise"):
        result = what(*(leaf("input", name, "uint32") for name in ("seed", "stream", "tick")))
    roots = [result] if isinstance(result, Expr) else list(result)
    full = {"seed": seed, "stream": stream, "tick": np.arange(first, first + n, dtype=np.uint64)}
    inputs = {k: np.broadcast_to(np.asarray(v, np.uint64).astype(np.uint32), (n,)) for k, v in full.items()}
    return np.array(evaluate(roots, inputs, precision))


def words_of(text: str) -> tuple[int, ...]:
    return tuple(int(word, 16) for word in text.split())


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ("0 0 0 0", "0 0", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        (" ".join(["ffffffff"] * 4), "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ],
)
def test_philox_gives_the_published_answers(counter: str, key: str, expected: str) -> None:
    # The known-answer vectors that the authors distribute with Random123.
    got = noise.philox(words_of(counter), words_of(key))
    assert tuple(word.value for word in got) == words_of(expected)


@both
@pytest.mark.parametrize("what", [noise.words, noise.uniform4, noise.normal, noise.normal4])
def test_recorded_and_computed_agree_to_the_bit(what: Callable[..., Any], precision: str) -> None:
    rng = np.random.default_rng(3)
    seed, stream = (int(v) for v in rng.integers(0, 2**32, 2))
    first = 2**32 - 20  # the tick wraps on the way
    recorded = draw(what, precision, seed=seed, stream=stream, first=first, n=40)
    with numbers.precision(precision):
        for i in range(40):
            got = what(numbers.UInt32(seed), stream, numbers.UInt32(first + i))
            got = got if isinstance(got, tuple) else (got,)
            for value, expected in zip(got, recorded[:, i], strict=True):
                if isinstance(value, numbers.UInt32):
                    assert value.value == expected
                else:
                    assert numbers.identical(value, expected)


def test_uniforms_are_the_same_in_both_precisions() -> None:
    wide, narrow = (draw(noise.uniform4, p, n=10000) for p in ("float64", "float32"))
    assert np.array_equal(wide, narrow)
    assert wide.min() >= 0.0
    assert wide.max() < 1.0
    assert np.array_equal(wide * 2**24, np.floor(wide * 2**24))


@both
def test_extreme_words_give_finite_normals(precision: str) -> None:
    with numbers.precision(precision):
        for length in (0, 1, 2**31, 2**32 - 256, 2**32 - 1):
            for direction in (0, 1, 2**29 - 1, 2**30 - 1, 2**30, 2**31, 2**32 - 1):
                pair = noise.normals(numbers.UInt32(length), numbers.UInt32(direction))
                # The length is the quantile of the radius, so the radius is known.
                radius = np.sqrt(-2 * np.log((length + 0.5) / 2**32))
                got = np.hypot(float(pair[0]), float(pair[1]))
                assert got == pytest.approx(radius, rel=1e-6, abs=2.0**-12)
                assert got <= 6.77


@both
def test_normal_distribution(precision: str) -> None:
    z = draw(noise.normal4, precision, seed=12345, stream=7).astype(np.float64).ravel()
    n = len(z)
    # Standard deviations of the moments of n normals: Kendall and Stuart, The Advanced Theory of Statistics, vol. 1.
    assert abs(z.mean()) <= SIGMAS / np.sqrt(n)
    assert abs(np.mean(z**2) - 1) <= SIGMAS * np.sqrt(2 / n)
    assert abs(np.mean(z**3)) <= SIGMAS * np.sqrt(15 / n)
    assert abs(np.mean(z**4) - 3) <= SIGMAS * np.sqrt(96 / n)
    assert stats.kstest(z, "norm").pvalue >= P_VALUE
    for limit in (2.0, 3.0, 4.0):
        expected = n * 2 * stats.norm.sf(limit)
        assert abs(np.sum(np.abs(z) > limit) - expected) <= SIGMAS * np.sqrt(expected)


def test_the_four_normals_of_a_tick_are_independent() -> None:
    z = draw(noise.normal4, seed=99)
    for a, b in ((0, 1), (0, 2), (1, 2), (2, 3), (0, 3), (1, 3)):
        for f in (np.positive, np.square, np.abs):
            assert abs(np.corrcoef(f(z[a]), f(z[b]))[0, 1]) <= SIGMAS / np.sqrt(N)
    turn = np.arctan2(z[1], z[0])
    assert stats.kstest(turn, "uniform", args=(-np.pi, 2 * np.pi)).pvalue >= P_VALUE
    # The angle tells nothing of the radius: each eighth of the circle has the same mean square.
    for eighth in range(8):
        inside = np.floor((turn + np.pi) / (np.pi / 4)) == eighth
        square = (z[0] ** 2 + z[1] ** 2)[inside]
        assert abs(square.mean() - 2) <= SIGMAS * 2 / np.sqrt(len(square))
