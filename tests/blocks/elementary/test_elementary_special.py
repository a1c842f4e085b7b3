"""Elementary functions at C99's special cases."""

import numpy as np
import pytest

from tests.blocks.elementary.numpy_evaluation import REALS, function
from twodof.blocks.elementary.functions import ARGUMENTS, FUNCTIONS
from twodof.blocks.expressions import numbers

INF, NAN = float("inf"), float("nan")
WHOLE = ("floor", "ceil", "trunc", "round_half_even", "round_half_away")

# C99, Annex F.9: exact results, signs of zeros included.
SPECIAL: list[tuple[str, tuple[float, ...], float]] = [
    *((f, (z,), z) for f in ("sin", "tan", "atan", "asin", "tanh", *WHOLE) for z in (0.0, -0.0)),
    *((f, (NAN,), NAN) for f, count in ARGUMENTS.items() if count == 1),
    *((f, (x,), NAN) for f in ("sin", "cos", "tan") for x in (INF, -INF)),
    *((f, (x,), x) for f in WHOLE for x in (INF, -INF)),
    *((f, (x,), NAN) for f in ("asin", "acos") for x in (1.5, -1.5, INF, -INF)),
    *((f, (x,), 1.0) for f in ("cos", "exp") for x in (0.0, -0.0)),
    ("acos", (1.0,), 0.0),
    ("tanh", (INF,), 1.0),
    ("tanh", (-INF,), -1.0),
    ("exp", (INF,), INF),
    ("exp", (-INF,), 0.0),
    ("log", (1.0,), 0.0),
    ("log", (0.0,), -INF),
    ("log", (-0.0,), -INF),
    ("log", (-1.0,), NAN),
    ("log", (-INF,), NAN),
    ("log", (INF,), INF),
    ("floor", (-0.3,), -1.0),
    ("floor", (0.3,), 0.0),
    ("ceil", (-0.3,), -0.0),
    ("ceil", (-0.7,), -0.0),
    ("ceil", (0.3,), 1.0),
    ("trunc", (-0.7,), -0.0),
    ("trunc", (1.7,), 1.0),
    *(("round_half_even", (x,), y) for x, y in ((0.5, 0.0), (-0.5, -0.0), (1.5, 2.0), (2.5, 2.0), (-2.5, -2.0))),
    *(("round_half_away", (x,), y) for x, y in ((0.5, 1.0), (-0.5, -1.0), (1.5, 2.0), (2.5, 3.0), (-0.3, -0.0))),
    ("atan2", (0.0, 0.0), 0.0),
    ("atan2", (-0.0, 0.0), -0.0),
    ("atan2", (0.0, 3.0), 0.0),
    ("atan2", (-0.0, 3.0), -0.0),
    ("atan2", (2.0, INF), 0.0),
    ("atan2", (-2.0, INF), -0.0),
    *(("atan2", (y, x), NAN) for y, x in ((NAN, 1.0), (1.0, NAN), (NAN, INF), (INF, NAN), (0.0, NAN))),
    *(("hypot", (a, b), INF) for a, b in ((INF, NAN), (NAN, -INF), (INF, 1.0), (-INF, INF))),
    *(("hypot", (a, b), NAN) for a, b in ((NAN, 1.0), (0.0, NAN))),
    ("hypot", (-3.0, 4.0), 5.0),
    ("hypot", (-0.0, 0.0), 0.0),
    *(("pow", (0.0, y), INF) for y in (-3.0, -2.0, -0.5, -INF)),
    *(("pow", (-0.0, y), r) for y, r in ((-3.0, -INF), (-2.0, INF), (-0.5, INF), (3.0, -0.0), (2.0, 0.0), (0.5, 0.0))),
    *(("pow", (0.0, y), 0.0) for y in (3.0, 2.0, 0.5, INF)),
    *(("pow", (-1.0, y), 1.0) for y in (INF, -INF, 2.0, 1e30)),
    ("pow", (-1.0, 3.0), -1.0),
    *(("pow", (1.0, y), 1.0) for y in (NAN, INF, -INF, 0.0, 5.5)),
    *(("pow", (x, z), 1.0) for x in (NAN, INF, -INF, 0.0, -0.0, -2.5, 3.0) for z in (0.0, -0.0)),
    *(("pow", (x, y), NAN) for x, y in ((-2.0, 0.5), (-0.1, -1.5), (NAN, 1.0), (2.0, NAN), (-1.0, NAN), (0.0, NAN))),
    *(("pow", (x, -INF), INF) for x in (0.5, -0.5, 0.999)),
    *(("pow", (x, -INF), 0.0) for x in (1.5, -1.5, 1.001)),
    *(("pow", (x, INF), 0.0) for x in (0.5, -0.5, 0.999)),
    *(("pow", (x, INF), INF) for x in (1.5, -1.5, 1.001)),
    *(("pow", (-INF, y), r) for y, r in ((-3.0, -0.0), (-2.0, 0.0), (-0.5, 0.0), (3.0, -INF), (2.0, INF), (0.5, INF))),
    *(("pow", (INF, y), r) for y, r in ((-1.0, 0.0), (-INF, 0.0), (2.5, INF), (INF, INF))),
    ("pow", (-2.0, 3.0), -8.0),
    ("pow", (-2.0, 1e30), INF),
]
# The same for results that are multiples of pi: the nearest real.
ANGLES: list[tuple[str, tuple[float, ...], float]] = [
    ("atan", (INF,), 0.5),
    ("atan", (-INF,), -0.5),
    ("asin", (1.0,), 0.5),
    ("asin", (-1.0,), -0.5),
    ("acos", (-1.0,), 1.0),
    ("acos", (0.0,), 0.5),
    ("atan2", (0.0, -0.0), 1.0),
    ("atan2", (-0.0, -0.0), -1.0),
    ("atan2", (0.0, -2.0), 1.0),
    ("atan2", (-0.0, -2.0), -1.0),
    ("atan2", (2.0, 0.0), 0.5),
    ("atan2", (-2.0, -0.0), -0.5),
    ("atan2", (2.0, -INF), 1.0),
    ("atan2", (-2.0, -INF), -1.0),
    ("atan2", (INF, 5.0), 0.5),
    ("atan2", (-INF, 5.0), -0.5),
    ("atan2", (INF, INF), 0.25),
    ("atan2", (INF, -INF), 0.75),
    ("atan2", (-INF, INF), -0.25),
    ("atan2", (-INF, -INF), -0.75),
]


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_special_cases_of_c99(precision: str) -> None:
    real = REALS[precision]
    table = SPECIAL + [(f, a, r * np.pi) for f, a, r in ANGLES]
    table = [row for row in table if not row[0].endswith("octant") or not np.isinf(row[1][0])]
    with numbers.precision(precision):
        for name, args, expected in table:
            got = FUNCTIONS[name](*map(real, args))
            assert numbers.identical(got, real(expected)), f"{name}{args} = {got}, not {expected}"


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_an_angle_within_the_octant_is_its_own_remainder(precision: str) -> None:
    """On both sides of the angle up to which nothing is reduced: 0.78."""
    rng = np.random.default_rng(1)
    scales = 10.0 ** rng.uniform(-45.0, 0.0, 20_000)
    near = np.linspace(0.7799, 0.7801, 20_000)
    wide = rng.uniform(-0.7853, 0.7853, 100_000)
    x = np.concatenate([wide, near, -near, scales * 0.785, -scales * 0.785, [0.0, -0.0, 0.78, -0.78]])
    x = x.astype(REALS[precision])
    for name in ("sin", "cos"):
        plain, octant = function(name, precision)(x), function(f"{name}_octant", precision)(x)
        bits = f"u{x.itemsize}"
        assert (plain.view(bits) == octant.view(bits))[x != 0.0].all()
