"""Elementary functions against mpmath and their own identities."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf
from numpy.typing import NDArray

from tests.blocks.elementary.numpy_evaluation import REALS, function, traced
from tests.patience import PATIENCE_S
from twodof.blocks.elementary import coefficients, functions
from twodof.blocks.elementary.functions import ARGUMENTS, FUNCTIONS
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import Expr, leaf
from twodof.blocks.expressions.graph import walk
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[3]
INF, NAN = float("inf"), float("nan")
# The promise of the design, in units in the last place of the exact result.
BOUND = {"float64": 2.5, "float32": 4.0}
# Where the promise for sin, cos and tan ends: their argument is reduced with so many digits of pi.
TURNS = {"float64": 1e5, "float32": 6400.0}
BITS = {"float64": 53, "float32": 24}
# What is seen, in ulp: of float32 with one argument over all of them, else over some millions. A definition that is
# changed may not lose its accuracy unnoticed.
SEEN: dict[str, tuple[float, float]] = {
    "sin": (1.50, 2.48),
    "cos": (1.50, 2.48),
    "sin_octant": (1.30, 1.17),
    "cos_octant": (1.08, 0.98),
    "tan": (2.31, 2.65),
    "atan": (1.30, 1.75),
    "atan2": (1.77, 1.75),
    "asin": (2.07, 2.05),
    "acos": (1.22, 1.18),
    "exp": (0.99, 1.02),
    "log": (0.92, 0.96),
    "pow": (0.76, 0.78),
    "floor": (0.0, 0.0),
    "ceil": (0.0, 0.0),
    "trunc": (0.0, 0.0),
    "round_half_even": (0.0, 0.0),
    "round_half_away": (0.0, 0.0),
    "tanh": (1.30, 1.33),
    "hypot": (1.20, 1.18),
}
EXACT: dict[str, Callable[..., Any]] = {
    "sin": mp.sin,
    "cos": mp.cos,
    "sin_octant": mp.sin,
    "cos_octant": mp.cos,
    "tan": mp.tan,
    "atan": mp.atan,
    "atan2": mp.atan2,
    "asin": mp.asin,
    "acos": mp.acos,
    "exp": mp.exp,
    "log": mp.log,
    "pow": mp.power,
    "floor": mp.floor,
    "ceil": mp.ceil,
    "trunc": lambda x: mp.sign(x) * mp.floor(abs(x)),
    "round_half_even": mp.nint,
    "round_half_away": lambda x: mp.sign(x) * mp.floor(abs(x) + mpf(0.5)),
    "tanh": mp.tanh,
    "hypot": mp.hypot,
}
WIDE: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan": np.arctan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "exp": np.exp,
    "log": np.log,
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
    "round_half_even": np.rint,
    "round_half_away": lambda x: np.trunc(x) + np.sign(x) * (np.abs(x - np.trunc(x)) >= 0.5),
    "tanh": np.tanh,
}
ROUNDING = ("floor", "ceil", "trunc", "round_half_even", "round_half_away")
both = pytest.mark.parametrize("precision", ["float64", "float32"])


def patterns(count: int, precision: str, seed: int = 1) -> NDArray[Any]:
    """Finite reals with random bits: every exponent, subnormals included, is as likely as any other."""
    words = np.random.default_rng(seed).integers(0, 2 ** (64 if precision == "float64" else 32), count, dtype=np.uint64)
    values = words.view(np.float64) if precision == "float64" else words.astype(np.uint32).view(np.float32)
    return values[np.isfinite(values)]


def around(centres: Any, precision: str, steps: int = 3) -> NDArray[Any]:
    """The reals next to each centre, `steps` to either side."""
    real = REALS[precision]
    middle = np.asarray(centres, dtype=real)
    columns, up, down = [middle], middle, middle
    for _ in range(steps):
        up, down = np.nextafter(up, real(INF)), np.nextafter(down, real(-INF))
        columns += [up, down]
    return np.concatenate(columns)


def arguments(name: str, precision: str, scale: float = 1) -> tuple[NDArray[Any], ...]:
    """Finite arguments within the domain of `name`: random over its range, dense where it is delicate, and edges."""
    n = round(1000 * scale)
    if ARGUMENTS[name] == 2:
        y, x = _pairs(name, precision, n)
        return _joined(y, precision), _joined(x, precision)
    rng = np.random.default_rng(2)
    real = REALS[precision]
    tiny, info = around([0.0], precision), np.finfo(real)
    powers_of_2 = 2.0 ** rng.uniform(-120, 0, 100)
    if name in ("sin", "cos", "tan"):
        limit = TURNS[precision]
        quarters = np.arange(-int(limit / 1.6), int(limit / 1.6), int(limit / 130)) * (np.pi / 2)
        near = around(np.concatenate([quarters, np.arange(-64, 65) * (np.pi / 4)]), precision, 1)
        groups = [rng.uniform(-100, 100, 3 * n), rng.uniform(-1, 1, n), rng.uniform(-limit, limit, n), near, tiny]
    elif name.endswith("octant"):
        groups = [rng.uniform(-np.pi / 4, np.pi / 4, 2 * n), powers_of_2 * (np.pi / 4), tiny[tiny >= 0]]
    elif name in ("asin", "acos"):
        close = 1.0 - np.exp(rng.uniform(-30, 0, n))
        joints = around([0.5, -0.5], precision)
        groups = [rng.uniform(-1, 1, 3 * n), close, -close, powers_of_2, joints, tiny]
        groups += [[1.0, -1.0], np.nextafter(real([1, -1]), real(0))]
    elif name == "exp":
        low, high = np.log(float(info.smallest_subnormal)), np.log(float(info.max))
        joints = around((np.arange(-20, 20) + 0.5) * np.log(2.0), precision, 1)
        groups = [rng.uniform(low - 3, high + 1, 3 * n), rng.uniform(-1, 1, n), powers_of_2, tiny, joints]
        groups += [around([low, high], precision)]
    elif name == "log":
        groups = [np.abs(patterns(2 * n, precision)), rng.uniform(0.5, 2, 2 * n), 1 + rng.normal(size=n) * 1e-4]
        groups += [around([1.0, 0.5**0.5, 2**0.5, info.tiny], precision), [info.max, info.smallest_subnormal]]
        groups = [np.asarray(g)[np.asarray(g) > 0] for g in groups]
    elif name in ROUNDING:
        whole = 2.0 ** (BITS[precision] - 1)
        groups = [patterns(n, precision), rng.uniform(-1e4, 1e4, n), around(np.arange(-5, 6) / 2, precision)]
        groups += [around([whole, -whole, whole / 2, 2 * whole], precision), rng.uniform(-whole, whole, 100)]
    else:
        joints = around([0.25, 0.75, 1.0, 4 / 3, 4.0, 0.625, -0.25, -0.75, -1.0, -0.625], precision)
        groups = [patterns(n, precision), rng.uniform(-5, 5, 3 * n), rng.uniform(-30, 30, n), joints, tiny]
    return (_joined(groups, precision),)


def _pairs(name: str, precision: str, n: int) -> tuple[list[Any], list[Any]]:
    rng = np.random.default_rng(3)
    real = REALS[precision]
    info = np.finfo(real)
    most, least = float(info.max), float(info.smallest_subnormal)
    wild = patterns(4 * n, precision, 3)[: 2 * n]
    if name == "atan2":
        ratio, side = np.meshgrid(around([0.25, 0.75, 1.0, 4 / 3, 4.0], precision), [1.0, -1.0, 3.0, -0.1, most / 5])
        y = [rng.normal(size=3 * n), wild[:n], (ratio * side).ravel(), [most, most, info.tiny, 0.0, 1.0]]
        x = [rng.normal(size=3 * n), wild[n:], side.ravel(), [most, -most, -most, 1.0, 0.0]]
        large = rng.uniform(0.1, 1, (2, 100)) * most
        small = np.ceil(rng.uniform(0, 50, (2, 100))) * least
        return [*y, large[0], small[0]], [*x, large[1], small[1]]
    if name == "hypot":
        a = [rng.normal(size=3 * n), wild[:n], wild[:n], [3.0, 0.0, least, most]]
        b = [rng.normal(size=3 * n), wild[n:], wild[:n] * real(0.6), [4.0, 0.0, least, info.tiny]]
        return a, b
    # Exponents that put the power anywhere between the smallest and the largest real, and a little beyond.
    x = np.exp(rng.uniform(-0.98, 0.98, 2 * n) * np.log(most))
    near = real(1 + rng.normal(size=n) * 10.0 ** rng.uniform(-6 if precision == "float32" else -15, -1, n))
    near = near[near != 1]
    y = [rng.uniform(-1.05, 1.02, len(v)) * np.log(most) / np.log(np.float64(v)) for v in (x, near)]
    return [x, near, rng.uniform(-5, 5, n)], [*y, rng.integers(-30, 31, n)]


def _joined(groups: list[Any], precision: str) -> NDArray[Any]:
    return np.concatenate([np.asarray(g, dtype=REALS[precision]) for g in groups])


def ulps(got: Any, exact: Any, precision: str) -> float:
    """|got - exact| in units in the last place of the exact result; an infinity counts as the next power of two."""
    info = np.finfo(REALS[precision])
    if exact == 0:
        return 0.0 if got == 0 else INF
    if np.isnan(got):
        return INF
    largest = mpf(float(info.max))
    value = mpf(float(got)) if np.isfinite(got) else mp.sign(float(got)) * mpf(2) ** int(info.maxexp)
    exact = mp.sign(exact) * min(abs(exact), mpf(2) ** int(info.maxexp))
    exponent = mp.frexp(min(abs(exact), largest))[1] - 1
    return float(abs(value - exact) / mpf(2) ** (max(exponent, int(info.minexp)) - BITS[precision] + 1))


@both
@pytest.mark.parametrize("name", sorted(ARGUMENTS))
@pytest.mark.parametrize("scale", [0.1, pytest.param(1, marks=pytest.mark.soak)])
def test_error_against_mpmath(name: str, precision: str, scale: float) -> None:
    columns = arguments(name, precision, scale)
    got = function(name, precision)(*columns)
    with mp.workprec(160):
        exact = [EXACT[name](*(mpf(float(v)) for v in row)) for row in zip(*columns, strict=True)]
        errors = [ulps(g, e, precision) for g, e in zip(got, exact, strict=True)]
    worst = int(np.argmax(errors))
    at = [float(c[worst]) for c in columns]
    assert errors[worst] <= accepted(name, precision), f"{errors[worst]} ulp at {at}: {got[worst]}"


def accepted(name: str, precision: str) -> float:
    return min(BOUND[precision], SEEN[name][precision == "float32"])


@pytest.mark.parametrize("name", sorted(WIDE))
def test_float32_over_its_whole_range(name: str) -> None:
    # Every 32771st of all float32; the soak test takes all of them.
    check_float32(name, np.arange(0, 2**32, 32771, dtype=np.uint64).astype(np.uint32).view(np.float32))


@pytest.mark.soak
@pytest.mark.parametrize("name", sorted(WIDE))
def test_every_float32(name: str) -> None:
    for start in range(0, 2**32, 2**22):
        check_float32(name, np.arange(start, start + 2**22, dtype=np.uint64).astype(np.uint32).view(np.float32))


def check_float32(name: str, x: NDArray[np.float32]) -> None:
    """Compare with libm in float64, whose own error is a 2^-29 of a float32's last place."""
    got = function(name, "float32")(x)
    with np.errstate(all="ignore"):
        exact = WIDE[name](x.astype(np.float64))
        info = np.finfo(np.float32)
        # An exact result that rounds beyond the largest float32 counts as 2^128, as does an infinity.
        clipped = np.clip(exact, -(2.0**128), 2.0**128)
        wide = np.clip(got.astype(np.float64), -(2.0**128), 2.0**128)
        magnitude = np.clip(np.abs(clipped), float(info.tiny), float(info.max))
        error = np.abs(wide - clipped) / np.exp2(np.floor(np.log2(magnitude)) - 23)
    known = ~np.isnan(exact)
    if name in ("sin", "cos", "tan"):
        known &= np.abs(x) <= TURNS["float32"]
        assert name == "tan" or not np.any(np.abs(got) > 1)
    assert np.array_equal(np.isnan(got), np.isnan(exact))
    worst = int(np.argmax(np.where(known, error, 0)))
    assert error[worst] <= accepted(name, "float32") or not known[worst], (
        f"{error[worst]} ulp at {x[worst]!r}: {got[worst]!r}"
    )
    if name in ROUNDING:
        assert np.array_equal(got, exact.astype(np.float32), equal_nan=True)
        assert np.array_equal(np.signbit(got[known]), np.signbit(exact[known]))


@both
@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_arrays_and_the_reference_agree_to_the_bit(name: str, precision: str) -> None:
    """The other tests evaluate the traced definition on arrays; this ties them to what the interpreter computes."""
    special = [0.0, -0.0, 1.0, -1.0, 0.5, INF, -INF, NAN, 1e-40, 1e30, np.pi]
    columns = [np.concatenate([c[::37], special]).astype(REALS[precision]) for c in arguments(name, precision)]
    got = function(name, precision)(*columns)
    with numbers.precision(precision):
        for row in zip(got, *columns, strict=True):
            value = FUNCTIONS[name](*row[1:])
            assert numbers.identical(value, REALS[precision](row[0])), row


@both
@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_beyond_the_exact_turns(name: str, precision: str) -> None:
    limit, last = TURNS[precision], 2.0**44 if precision == "float64" else 2.0**16
    real = REALS[precision]
    x = real(np.exp(np.random.default_rng(5).uniform(np.log(limit), np.log(last), 2000)))
    got = function(name, precision)(x)
    if name != "tan":
        # The docstring's promise: no worse than if x had been off by its own last place.
        with mp.workprec(200):
            exact = np.array([float(EXACT[name](mpf(float(v)))) for v in x])
        assert np.all(np.abs(got - exact) <= np.spacing(x))
    for huge in (1.001 * last, float(np.finfo(real).max)):
        value = function(name, precision)(real([huge, -huge]))
        assert np.array_equal(value, real([1, 1] if name == "cos" else [0, 0]))


@both
@pytest.mark.parametrize("name", ["sin", "tan", "atan", "asin", "tanh", "trunc"])
def test_odd_functions_are_odd_to_the_bit(name: str, precision: str) -> None:
    x = np.concatenate([arguments(name, precision)[0], patterns(5000, precision, 7)])
    f = function(name, precision)
    assert np.array_equal(f(-x), -f(x), equal_nan=True)


@both
def test_even_and_reflected(precision: str) -> None:
    x = np.concatenate([arguments("cos", precision)[0], patterns(5000, precision, 7)])
    cos, floor, ceil = (function(n, precision) for n in ("cos", "floor", "ceil"))
    assert np.array_equal(cos(-x), cos(x), equal_nan=True)
    assert np.array_equal(ceil(x), -floor(-x))
    with np.errstate(all="ignore"):
        a, b = patterns(9000, precision, 8)[:8000].reshape(2, -1)
        hypot, atan2 = function("hypot", precision), function("atan2", precision)
        assert np.array_equal(hypot(a, b), hypot(-b, a))
        assert np.array_equal(atan2(-a, b), -atan2(a, b))


@both
def test_pow_is_exact_where_the_result_is(precision: str) -> None:
    base, power = (g.ravel().astype(REALS[precision]) for g in np.meshgrid(np.arange(-40, 41), np.arange(0, 54)))
    whole = [int(b) ** int(p) for b, p in zip(base, power, strict=True)]
    fits = np.array([abs(w) <= 2 ** BITS[precision] for w in whole])
    expected = np.array([float(w) for w, ok in zip(whole, fits, strict=True) if ok])
    assert fits.sum() > 200
    assert np.array_equal(function("pow", precision)(base[fits], power[fits]), expected)
    x = np.abs(patterns(2000, precision, 9))
    assert np.array_equal(function("pow", precision)(x, np.ones_like(x)), x)


# Where a definition passes from one formula, or one integer multiple, to the next.
JOINTS: dict[str, list[float]] = {
    "sin": [np.pi / 4, -np.pi / 4, np.pi * 1.25, 100 * np.pi + 0.1],
    "cos": [np.pi / 4, np.pi * 0.75, 1.0],
    "tan": [np.pi / 4, -np.pi / 4, 1.0],
    "atan": [0.25, 0.75, 1.0, 4 / 3, 4.0],
    "asin": [0.5, -0.5, 0.99],
    "acos": [0.5, -0.5, 0.99],
    "exp": [np.log(2) / 2, -np.log(2) / 2, 0.0, 1.0, 5.5 * np.log(2)],
    "log": [0.5**0.5, 2**0.5, 1.0, 2.0],
    "tanh": [0.625, 3.0],
}


@both
@pytest.mark.parametrize("name", sorted(JOINTS))
def test_no_step_back_at_the_joints(name: str, precision: str) -> None:
    """Along neighbouring arguments a rising function may fall by rounding, but by no more than 2 ulp.

    The bound on the error would allow twice itself (5 or 8 ulp); a joint that is off shows long before.
    """
    for centre in JOINTS[name]:
        x = np.unique(around([centre], precision, 400))
        y = function(name, precision)(x)
        rising = float(y[-1]) > float(y[0])
        steps = np.diff(y.astype(np.float64)) * (1 if rising else -1) / np.spacing(np.abs(y[1:]))
        assert steps.min() >= -2, f"falls by {-steps.min()} ulp near {centre}"


def test_on_expressions_a_call_is_recorded() -> None:
    x = leaf("input", "x", "real")
    for name, count in ARGUMENTS.items():
        recorded = FUNCTIONS[name](*[x] * count)
        assert isinstance(recorded, Expr)
        assert (recorded.op, recorded.data, recorded.kind, len(recorded.args)) == ("call", name, "real", count)
    assert functions.atan2(1.0, x).args[0].data == 1.0
    with pytest.raises(DiagramError, match="int32"):
        functions.sin(leaf("input", "n", "int32"))
    v = leaf("input", "v", "real", 3)
    assert [e.args for e in functions.sin(v).args] == [(v[i],) for i in range(3)]
    with pytest.raises(DiagramError, match="arrays of 3 and 2 are in one operation"):
        functions.atan2(v, leaf("input", "w", "real", 2))


@both
def test_definitions_call_nothing_and_stay_small(precision: str) -> None:
    limit = {"pow": 300, "tanh": 95, "atan2": 85}
    for name in ARGUMENTS:
        root, _ = traced(name, precision)
        operations = [n.op for n in walk([root]) if n.op not in ("const", "input")]
        assert "call" not in operations
        # sin and cos are in the rig's inner loop; a change that makes them dearer should be meant.
        assert len(operations) <= limit.get(name, 65), f"{name} has {len(operations)} operations"


@pytest.mark.soak
def test_the_tool_reproduces_the_coefficients() -> None:
    tool = subprocess.run(
        [sys.executable, PROJECT / "tools/minimax.py"], capture_output=True, text=True, check=True, timeout=PATIENCE_S
    )
    assert tool.stdout == Path(coefficients.__file__).read_text(encoding="utf-8")
