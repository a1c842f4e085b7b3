"""Simulink's smaller blocks and those of its own libraries, beside their definitions computed in numpy."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.slx.files import Blocks, model_of, slx
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.slx.importer import Imported, import_system
from twodof.slx.model import read_model

pytestmark = pytest.mark.slow
DT = 0.01
STEPS = 250
DRAWN = np.random.default_rng(6).normal(0.0, 2.0, (3, STEPS)).round(2)
TIME = np.arange(STEPS) * DT
Wanted = Callable[..., np.ndarray]


def one_block(tmp_path: Path, kind: str, values: dict[str, str], kinds: tuple[str, ...]) -> Imported:
    """Import a block with inputs of these data types; a name with "/" is a block of a library."""
    if "/" in kind:
        kind, values = "Reference", {"SourceBlock": kind, **values}
    ports: Blocks = [
        ("Inport", f"u{k}", {"Port": str(k), "OutDataTypeStr": one}) for k, one in enumerate(kinds, start=1)
    ]
    blocks: Blocks = [*ports, (kind, "block", {"Ports": f"[{len(kinds)}, 1]", **values}), ("Outport", "y", {})]
    lines = [*((f"u{k}", f"block:{k}") for k in range(1, len(kinds) + 1)), ("block", "y")]
    return import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)


def run(found: Imported, inputs: list[np.ndarray], precision: str = "float64") -> np.ndarray:
    assert found.diagram is not None, found.refused
    given = {f"u{k}": one for k, one in enumerate(inputs, start=1)}
    built = build(from_json(to_json(found.diagram)), dt=found.dt, precision=precision)
    return built.machine().run(STEPS, given)["y"]


def recurrent(step: Callable[..., tuple[float, object]], start: object) -> Wanted:
    """What a function of inputs and state gives, sample after sample."""

    def wanted(*inputs: np.ndarray) -> np.ndarray:
        state, found = start, []
        for row in zip(*inputs, strict=True):
            y, state = step(*row, state)
            found.append(y)
        return np.array(found)

    return wanted


def before(u: np.ndarray, start: float = 0.0) -> np.ndarray:
    return np.r_[start, u[:-1]]


def again(value: float) -> tuple[float, float]:
    return value, value


def away(u: np.ndarray) -> np.ndarray:
    return np.sign(u) * np.floor(abs(u) + 0.5)


LOGIC = "simulink/Logic and Bit Operations"
EDGES = "simulink/Discontinuities"


@pytest.mark.parametrize(
    ("kind", "values", "count", "wanted"),
    [
        (f"{LOGIC}/Detect Change", {"vinit": "1"}, 1, lambda u: u != before(u, 1.0)),
        (f"{LOGIC}/Detect Increase", {}, 1, lambda u: u > before(u)),
        (f"{LOGIC}/Detect Decrease", {}, 1, lambda u: u < before(u)),
        (f"{LOGIC}/Detect Rise Positive", {}, 1, lambda u: (u > 0) & ~(before(u) > 0)),
        (f"{LOGIC}/Detect Rise Nonnegative", {"vinit": "1"}, 1, lambda u: (u >= 0) & ~(before(u) >= 0)),
        (f"{LOGIC}/Detect Fall Negative", {}, 1, lambda u: (u < 0) & ~(before(u) < 0)),
        (f"{LOGIC}/Detect Fall Nonpositive", {"vinit": "1"}, 1, lambda u: (u <= 0) & ~(before(u) <= 0)),
        (f"{LOGIC}/Interval Test", {"uplimit": "1", "IntervalClosedRight": "off"}, 1, lambda u: (u >= -0.5) & (u < 1)),
        (f"{EDGES}/Saturation Dynamic", {}, 3, lambda a, u, b: np.where(u > a, a, np.where(u < b, b, u))),
        (f"{EDGES}/Dead Zone Dynamic", {}, 3, lambda a, u, b: np.where(u > a, u - a, np.where(u < b, u - b, 0.0))),
        ("simulink/Additional Discrete/Unit Delay External IC", {}, 2, lambda u, first: np.r_[first[0], u[:-1]]),
        ("simulink/Additional Math/Increment Real World", {}, 1, lambda u: u + 1),
        (f"{EDGES}/Wrap To Zero", {"Threshold": "1"}, 1, lambda u: np.where(u > 1, 0, u)),
        (
            f"{EDGES}/Coulomb & Viscous Friction",
            {"offset": ".5", "gain": "3"},
            1,
            lambda u: np.sign(u) * (3 * abs(u) + 0.5),
        ),
        (
            f"{EDGES}/Rate Limiter Dynamic",
            {},
            3,
            recurrent(lambda a, u, b, y: again((a * DT if u - y > a * DT else max(b * DT, u - y)) + y), 0.0),
        ),
        (
            "RateLimiter",
            {"RisingSlewLimit": "2", "FallingSlewLimit": "-3", "SampleTimeMode": "inherited"},
            1,
            recurrent(lambda u, y: again(y + 0.02 if u - y > 0.02 else y - 0.03 if u - y < -0.03 else u), 0.0),
        ),
        ("Quantizer", {"QuantizationInterval": ".5"}, 1, lambda u: away(u / 0.5) * 0.5),
        (
            "Backlash",
            {"BacklashWidth": "1", "InitialOutput": "2"},
            1,
            recurrent(lambda u, y: again(u + 0.5 if u < y - 0.5 else y if u <= y + 0.5 else u - 0.5), 2.0),
        ),
        ("simulink/Discrete/Difference", {"ICPrevInput": "3"}, 1, lambda u: u - before(u, 3.0)),
        ("Derivative", {}, 1, lambda u: np.r_[0.0, (u[1:] - u[:-1]) / DT]),
        ("InitialCondition", {"Value": "5"}, 1, lambda u: np.r_[5.0, u[1:]]),
        (
            "simulink/Discrete/Transfer Fcn First Order",
            {"PoleZ": ".9"},
            1,
            recurrent(lambda u, y: again((1 - 0.9) * u + 0.9 * y), 0.0),
        ),
        ("simulink/Discrete/Transfer Fcn Real Zero", {"ZeroZ": ".5"}, 1, lambda u: u - 0.5 * before(u)),
        ("Fcn", {"Expr": "2*u(1)^2 - u[1]"}, 1, lambda u: 2 * u**2 - u),
        ("ManualSwitch", {"sw": "0"}, 2, lambda a, b: b),
        ("ManualSwitch", {"sw": "1"}, 2, lambda a, b: a),
        ("simulink_extras/Transformations/Degrees to Radians", {}, 1, lambda u: np.pi / 180 * u),
        ("simulink/Math Operations/Slider Gain", {"gain": "3"}, 1, lambda u: 3 * u),
        ("Logic", {"Operator": "AND"}, 2, lambda a, b: (a != 0) & (b != 0)),
        ("ArithShift", {"BitShiftNumber": "3", "BitShiftDirection": "Left"}, 1, lambda u: 8 * u),
        ("ArithShift", {"BitShiftNumberSource": "Input port"}, 2, lambda u, v: u * 2.0 ** np.floor(-v)),
        (
            "HitCross",  # a crossing in the step after one is not seen
            {"HitCrossingOffset": "9e-3"},
            1,
            recurrent(lambda u, s: (hit := s[0] * (u - 9e-3) < 0 and not s[1], (u - 9e-3, hit)), (0.0, False)),
        ),
        (
            "DiscreteFir",
            {"Coefficients": "[.5 -2 3]", "InitialStates": "4"},
            1,
            lambda u: 0.5 * u - 2.0 * before(u, 4.0) + 3.0 * before(before(u, 4.0), 4.0),
        ),
        (
            "MultiPortSwitch",
            {"Inputs": "2"},
            3,
            lambda n, a, b: np.where(np.trunc(n) == 1, a, b),
        ),
        (
            "MultiPortSwitch",
            {"Inputs": "2", "DataPortOrder": "Specify indices", "DataPortIndices": "{[-1 2],3}"},
            3,
            lambda n, a, b: np.where(np.isin(np.trunc(n), [-1, 2]), a, b),
        ),
    ],
)
def test_a_block_is_its_definition(
    tmp_path: Path, kind: str, values: dict[str, str], count: int, wanted: Wanted
) -> None:
    found = one_block(tmp_path, kind, values, ("double",) * count)
    given = list(DRAWN[:count])
    if "Limiter Dynamic" in kind:
        given = [abs(given[0]) * 20, given[1], -abs(given[2]) * 20]
    assert np.array_equal(run(found, given), wanted(*given))


TABLE = np.array([[1.0, 2.5, 0.3, 4.0], [2.0, -1.0, 6.0, 0.7], [0.1, 3.0, 5.0, -2.0]])
ROWS, COLUMNS = np.array([-1.0, 0.5, 2.0]), np.array([-2.0, -1.0, 0.0, 3.0])


def look(table: np.ndarray, points: list[np.ndarray], at: tuple[float, ...], method: str, clip: bool) -> float:
    """The value of a table, along its first dimension first, as MathWorks' look1_ and look2_ functions have it."""
    places, shares = [], []
    for value, grid in zip(at, points, strict=True):
        i = min(max(int(np.searchsorted(grid, value, "right")) - 1, 0), len(grid) - 2)
        share = (value - grid[i]) / (grid[i + 1] - grid[i])
        if clip:
            share = 0.0 if value <= grid[0] else share if value < grid[-1] else 1.0
        places.append(i)
        shares.append(share)
    if method == "flat":
        places = [i + (share >= 1.0) for i, share in zip(places, shares, strict=True)]
        return float(table[tuple(places)])

    def between(left: float, right: float, share: float) -> float:
        return (right - left) * share + left

    if table.ndim == 1:
        return between(table[places[0]], table[places[0] + 1], shares[0])
    (i, j), (a, b) = places, shares
    return between(between(table[i, j], table[i + 1, j], a), between(table[i, j + 1], table[i + 1, j + 1], a), b)


@pytest.mark.parametrize("clip", [True, False])
@pytest.mark.parametrize("method", ["linear", "flat"])
@pytest.mark.parametrize("count", [1, 2])
def test_a_table_is_looked_up_as_mathworks_code_does(tmp_path: Path, count: int, method: str, clip: bool) -> None:
    values = {
        "NumberOfTableDimensions": str(count),
        "Table": "[1 2.5 .3 4; 2 -1 6 .7; .1 3 5 -2]" if count == 2 else "[1 2.5 .3 4]",
        "BreakpointsForDimension1": "[-1 .5 2]" if count == 2 else "[-2 -1 0 3]",
        "BreakpointsForDimension2": "[-2 -1 0 3]",
        "InterpMethod": "Linear point-slope" if method == "linear" else "Flat",
        "ExtrapMethod": "Clip" if clip else "Linear",
    }
    found = run(one_block(tmp_path, "Lookup_n-D", values, ("double",) * count), list(DRAWN[:count]))
    table, points = (TABLE, [ROWS, COLUMNS]) if count == 2 else (TABLE[0], [COLUMNS])
    held = clip or method == "flat"
    wanted = [look(table, points, tuple(row), method, held) for row in DRAWN[:count].T]
    assert np.array_equal(found, wanted)


def test_a_table_of_doubles_takes_a_boolean_and_a_whole_number(tmp_path: Path) -> None:
    values = {"NumberOfTableDimensions": "2", "Table": "[1 2.5 .3 4; 2 -1 6 .7; .1 3 5 -2]",
              "BreakpointsForDimension1": "[-1 .5 2]", "BreakpointsForDimension2": "[-2 -1 0 3]",
              "OutDataTypeStr": "double"}  # fmt: skip
    on, whole = DRAWN[0] > 0, np.round(DRAWN[1]).astype(np.int8)
    found = run(one_block(tmp_path, "Lookup_n-D", values, ("boolean", "int8")), [on, whole])
    wanted = [
        look(TABLE, [ROWS, COLUMNS], (float(a), float(b)), "linear", False) for a, b in zip(on, whole, strict=True)
    ]
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize("clip", [True, False])
@pytest.mark.parametrize("count", [1, 2])
def test_a_table_is_looked_up_at_places_found_apart(tmp_path: Path, count: int, clip: bool) -> None:
    points = ["[-1 .5 2]", "[-2 -1 0 3]"] if count == 2 else ["[-2 -1 0 3]"]
    held = {"ExtrapMethod": "Clip" if clip else "Linear"}
    table = "[1 2.5 .3 4; 2 -1 6 .7; .1 3 5 -2]" if count == 2 else "[1 2.5 .3 4]"
    values = {"NumberOfTableDimensions": str(count), "Table": table, "Ports": f"[{2 * count}, 1]", **held}
    blocks: Blocks = [("Interpolation_n-D", "value", values), ("Outport", "y", {})]
    lines = [("value", "y")]
    for k, one in enumerate(points, start=1):
        blocks += [("Inport", f"u{k}", {"Port": str(k), "OutDataTypeStr": "double"})]
        blocks += [("PreLookup", f"place{k}", {"BreakpointsData": one, "Ports": "[1, 2]", **held})]
        lines += [(f"u{k}", f"place{k}"), (f"place{k}:1", f"value:{2 * k - 1}"), (f"place{k}:2", f"value:{2 * k}")]
    found = run(import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT), list(DRAWN[:count]))
    grid = [ROWS, COLUMNS] if count == 2 else [COLUMNS]
    wanted = [look(TABLE if count == 2 else TABLE[0], grid, tuple(row), "linear", clip) for row in DRAWN[:count].T]
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize(
    ("method", "wanted"),
    [
        ("Interpolation-Extrapolation", lambda u: look(TABLE[0], [COLUMNS], (u,), "linear", False)),
        ("Interpolation-Use End Values", lambda u: look(TABLE[0], [COLUMNS], (u,), "linear", True)),
        ("Use Input Below", lambda u: look(TABLE[0], [COLUMNS], (u,), "flat", True)),
        ("Use Input Above", lambda u: TABLE[0][min(np.searchsorted(COLUMNS, u), 3)]),
        ("Use Input Nearest", lambda u: TABLE[0][3 - np.argmin(abs(COLUMNS - u)[::-1])]),
    ],
)
def test_a_table_of_signals_is_looked_up(tmp_path: Path, method: str, wanted: Wanted) -> None:
    table = {"SourceBlock": "simulink/Lookup Tables/Lookup Table Dynamic", "LookUpMeth": method, "Ports": "[3, 1]"}
    blocks: Blocks = [
        ("Inport", "u1", {"OutDataTypeStr": "double"}),
        ("Constant", "points", {"Value": "[-2 -1 0 3]"}),
        ("Constant", "table", {"Value": "[1 2.5 .3 4]"}),
        ("Reference", "block", table),
        ("Outport", "y", {}),
    ]
    lines = [("u1", "block:1"), ("points", "block:2"), ("table", "block:3"), ("block", "y")]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)
    assert np.array_equal(run(found, [DRAWN[0]]), [wanted(u) for u in DRAWN[0]])


@pytest.mark.parametrize(
    ("kind", "name", "wanted"),
    [
        ("Sqrt", "signedSqrt", lambda u: np.sign(u) * np.sqrt(abs(u))),
        ("Sqrt", "rSqrt", lambda u: 1.0 / np.sqrt(u)),
        ("Math", "log10", np.log10),
        ("Math", "sqrt", lambda u: np.sign(u) * np.sqrt(abs(u))),
        ("MATLABFcn", "sinc", np.sinc),
    ],
)
def test_functions_of_numbers_are_numpys(tmp_path: Path, kind: str, name: str, wanted: Wanted) -> None:
    given = DRAWN[0] if name in ("signedSqrt", "sqrt") else abs(DRAWN[0]) + 0.1
    found = run(one_block(tmp_path, kind, {"Operator": name, "MATLABFcn": name}, ("double",)), [given])
    assert np.allclose(found, wanted(given), rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize(("name", "at_0"), [("rem", np.nan), ("mod", 5.0)])
def test_remainders_are_exact_and_say_what_simulink_says_of_0_and_infinity(
    tmp_path: Path, name: str, at_0: float
) -> None:
    wanted = {"rem": np.fmod, "mod": np.mod}[name]  # numpy's mod rounds once more than C, none of these sums does
    u, v = np.round(1e6 * DRAWN[0]) / 8.0, np.round(abs(DRAWN[1]) * 64.0 + 1.0) / 8.0
    u[:3], v[:3] = [5.0, 5.0, np.inf], [0.0, np.inf, 2.0]
    found = run(one_block(tmp_path, "Math", {"Operator": name}, ("double", "double")), [u, v])
    assert np.array_equal(found[:3], [at_0, 5.0, np.nan], equal_nan=True)
    assert np.array_equal(found[3:], wanted(u[3:], v[3:]))


def test_a_random_source_has_the_distribution_of_its_dialog(tmp_path: Path) -> None:
    source, uniform = "dspsrcs4/Random Source", {"SrcType": "Uniform", "MinVal": "2", "MaxVal": "5"}
    normal = run(one_block(tmp_path, source, {"SrcType": "Gaussian", "MeanVal": "3", "VarVal": "4"}, ()), [])
    assert abs(normal.mean() - 3.0) < 4.0 * 2.0 / STEPS**0.5
    assert abs(normal.std() - 2.0) < 4.0 * 2.0 / (2.0 * STEPS) ** 0.5
    drawn = run(one_block(tmp_path, source, uniform, ()), [])
    assert 2.0 <= drawn.min() < 2.2
    assert 4.8 < drawn.max() <= 5.0
    (line,) = one_block(tmp_path, source, {**uniform, "SampFrame": "2"}, ()).refused
    assert line.why == "SampFrame = '2' is not translated"


ROTATIONS = Rotation.from_rotvec(DRAWN.T)
QUATERNIONS = ROTATIONS.as_quat()[:, [3, 0, 1, 2]]
MATRICES = ROTATIONS.as_matrix() + 0.5 * np.eye(3)


@pytest.mark.parametrize(
    ("kind", "inputs", "wanted"),
    [
        ("aerolibutil/Quaternion Rotation", [QUATERNIONS, DRAWN.T], ROTATIONS.inv().apply(DRAWN.T)),
        ("aerolibutil/Quaternion Inverse", [QUATERNIONS], QUATERNIONS * [1, -1, -1, -1]),
        ("aerolibutil/Quaternion Conjugate", [QUATERNIONS], QUATERNIONS * [1, -1, -1, -1]),
        ("aerolibutil/Quaternion Normalize", [2.0 * QUATERNIONS], QUATERNIONS),
        (
            "aerolibutil/Quaternion Multiplication",
            [QUATERNIONS, 2.0 * QUATERNIONS * [1, -1, -1, -1]],
            np.tile([2.0, 0.0, 0.0, 0.0], (STEPS, 1)),
        ),
        ("Rod2Quat", [QUATERNIONS[:, 1:] / QUATERNIONS[:, :1]], QUATERNIONS * np.sign(QUATERNIONS[:, :1])),
        ("sharedutil/3x3 Cross Product", [DRAWN.T, DRAWN.T[::-1]], np.cross(DRAWN.T, DRAWN.T[::-1])),
        ("sharedutil/Create 3x3 Matrix", [*MATRICES.reshape(STEPS, 9).T], MATRICES),
        ("dspmtrx3/Create Diagonal Matrix", [DRAWN.T], DRAWN.T[:, :, None] * np.eye(3)),
        ("aerolibutil/Invert  3x3 Matrix", [MATRICES], np.linalg.inv(MATRICES)),
        ("sharedutil/Determinant of 3x3 Matrix", [MATRICES], np.linalg.det(MATRICES)),
        ("Switch", [MATRICES, DRAWN[0], -MATRICES], np.where((DRAWN[0] >= 0)[:, None, None], MATRICES, -MATRICES)),
        ("Switch", [MATRICES, MATRICES, DRAWN[0]], np.where(MATRICES >= 0.0, MATRICES, DRAWN[0][:, None, None])),
        (
            "MultiPortSwitch",
            [np.clip(DRAWN[0], 1, 3), MATRICES, DRAWN[1], 2.0 * MATRICES],
            np.choose(
                np.clip(DRAWN[0], 1, 3).astype(int)[:, None, None] - 1,
                [MATRICES, DRAWN[1][:, None, None] + 0.0 * MATRICES, 2.0 * MATRICES],
            ),
        ),
        ("DataTypeConversion", [MATRICES], MATRICES),
        ("RelationalOperator", [MATRICES, DRAWN[0]], DRAWN[0][:, None, None] <= MATRICES),
    ],
)
def test_quaternions_and_matrices_of_toolboxes(
    tmp_path: Path, kind: str, inputs: list[np.ndarray], wanted: np.ndarray
) -> None:
    sizes = ["1" if one.ndim == 1 else str([*one.shape[1:]]) for one in inputs]
    said = [{"Port": str(k), "OutDataTypeStr": "double", "PortDimensions": one} for k, one in enumerate(sizes, start=1)]
    blocks: Blocks = [*(("Inport", f"u{one['Port']}", one) for one in said), ("Outport", "y", {})]
    own = kind if "/" not in kind else "Reference"
    blocks.append((own, "block", {"SourceBlock": kind, "Ports": f"[{len(inputs)}, 1]"}))
    lines = [*((f"u{k}", f"block:{k}") for k in range(1, len(inputs) + 1)), ("block", "y")]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)
    assert np.allclose(run(found, inputs), wanted, rtol=1e-9, atol=1e-9)


def test_a_truth_table_and_a_row_times_a_matrix(tmp_path: Path) -> None:
    blocks: Blocks = [
        *(("Inport", f"u{k}", {"Port": str(k), "OutDataTypeStr": "double"}) for k in (1, 2)),
        ("Mux", "both", {"Inputs": "2", "Ports": "[2, 1]"}),
        ("CombinatorialLogic", "truth", {"TruthTable": "[0 1 0; 1 1 1; 0 0 1; 1 0 1]"}),
        ("Gain", "row", {"Gain": "[1 2 3; 4 5 6]", "Multiplication": "Matrix(u*K)"}),
        *(("Outport", name, {"Port": str(k)}) for k, name in enumerate(("y", "z"), start=1)),
    ]
    lines = [("u1", "both:1"), ("u2", "both:2"), ("both", "truth"), ("both", "row"), ("truth", "y"), ("row", "z")]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)
    assert found.diagram is not None, found.refused
    u = np.where(abs(DRAWN[:2]) < 1.0, 0.0, DRAWN[:2])
    out = build(found.diagram, dt=DT).machine().run(STEPS, {"u1": u[0], "u2": u[1]})
    rows = np.array([[0, 1, 0], [1, 1, 1], [0, 0, 1], [1, 0, 1]])
    assert np.array_equal(out["y"], rows[2 * (u[0] != 0) + (u[1] != 0)])
    assert np.array_equal(out["z"], np.outer(u[0], [1.0, 2.0, 3.0]) + np.outer(u[1], [4.0, 5.0, 6.0]))


def test_older_tables_and_even_breakpoints_are_read(tmp_path: Path) -> None:
    older = {"InputValues": "[-2 -1 0 3]", "Table": "[1 2.5 .3 4]", "LookUpMeth": "Interpolation-Use End Values"}
    even = {"NumberOfTableDimensions": "1", "BreakpointsSpecification": "Even spacing",
            "BreakpointsForDimension1FirstPoint": "-1",
            "BreakpointsForDimension1Spacing": ".5", "ExtrapMethod": "Clip", "Table": "[1 2 4 3]"}  # fmt: skip
    u = DRAWN[0]
    assert np.array_equal(
        run(one_block(tmp_path, "Lookup", older, ("double",)), [u]),
        [look(TABLE[0], [COLUMNS], (v,), "", True) for v in u],
    )
    grid = np.array([-1.0, -0.5, 0.0, 0.5])
    assert np.array_equal(
        run(one_block(tmp_path, "Lookup_n-D", even, ("double",)), [u]),
        [look(np.array([1.0, 2.0, 4.0, 3.0]), [grid], (v,), "", True) for v in u],
    )


@pytest.mark.parametrize("real", [np.float64, np.float32])
@pytest.mark.parametrize(("clip", "last"), [(False, False), (True, False), (True, True)])
def test_even_breakpoints_are_found_by_their_distance(tmp_path: Path, clip: bool, last: bool, real: type) -> None:
    """Places and shares as MathWorks' code of R2023b computes them, which a search would round otherwise."""
    values = {"NumberOfTableDimensions": "1", "BreakpointsForDimension1": "[-.3 -.2 -.1 0 .1]",
              "Table": "[1 2.5 .3 4 .1]", "IndexSearchMethod": "Evenly spaced points",
              "ExtrapMethod": "Clip" if clip else "Linear",
              "UseLastTableValue": "on" if last else "off"}  # fmt: skip
    table, (first, second), one = np.array([1.0, 2.5, 0.3, 4.0, 0.1], real), np.array([-0.3, -0.2], real), real(1.0)
    wanted, step, drawn = [], second - first, (DRAWN[0] / 5.0).astype(real)
    for u in drawn:
        inverse = one / step
        place = (u - first) * inverse
        i = int(place) if 0.0 < place < 4 else 0 if place <= 0.0 else 3
        share = (u - (real(i) * step + first)) * inverse if u > first else (u - first) / step
        if clip and not first < u:
            share = real(0.0)
        elif clip and place >= 4:
            share = one
        between = (table[i + 1] - table[i]) * share + table[i]
        wanted.append(table[4] if last and place >= 4 else between)
    assert np.array_equal(run(one_block(tmp_path, "Lookup_n-D", values, ("double",)), [drawn], real.__name__), wanted)


def square(turns: np.ndarray) -> np.ndarray:
    return np.where(1.0 - (turns - np.floor(turns)) >= 0.5, 1.0, -1.0)


def sample(values: list[float]) -> np.ndarray:
    return np.resize(np.array(values), STEPS)


@pytest.mark.parametrize(
    ("kind", "values", "wanted"),
    [
        (
            "DiscretePulseGenerator",
            {"PulseType": "Sample based", "Period": "5", "PulseWidth": "2", "PhaseDelay": "3", "Amplitude": "4"},
            np.r_[0.0, 0.0, 0.0, sample([4.0, 4.0, 0.0, 0.0, 0.0])[:-3]],
        ),
        (
            "DiscretePulseGenerator",
            {"PulseType": "Time based", "Period": ".1", "PulseWidth": "30"},
            sample([1.0] * 3 + [0.0] * 7),
        ),
        ("simulink/Sources/Repeating Sequence Stair", {"OutValues": "[3 1 4]"}, sample([3.0, 1.0, 4.0])),
        ("simulink/Sources/Counter Free-Running", {"NumBits": "3"}, sample(list(range(8)))),
        ("simulink/Sources/Counter Limited", {"uplimit": "4"}, sample(list(range(5)))),
        ("simulink/Sources/Ramp", {"start": ".5", "slope": "2"}, np.where(TIME < 0.5, 0.0, 2 * (TIME - 0.5))),
        ("SignalGenerator", {"WaveForm": "square", "Frequency": "12.5"}, square(12.5 * TIME)),
    ],
)
def test_a_source_follows_its_clock(tmp_path: Path, kind: str, values: dict[str, str], wanted: np.ndarray) -> None:
    found = run(one_block(tmp_path, kind, values, ()), [])
    assert np.allclose(found, wanted, rtol=0.0, atol=1e-12)
    if "Ramp" not in kind:
        assert np.array_equal(found, wanted)


def test_a_repeating_sequence_and_sines_follow_the_time(tmp_path: Path) -> None:
    values = {"rep_seq_t": "[0 .3 .4]", "rep_seq_y": "[1 4 0]"}
    found = run(one_block(tmp_path, "simulink/Sources/Repeating Sequence", values, ()), [])
    phase = TIME - np.floor(TIME / 0.4) * 0.4
    assert np.allclose(found, np.interp(phase, [0.0, 0.3, 0.4], [1.0, 4.0, 0.0]), rtol=0.0, atol=1e-12)
    many = {"Amplitude": "[2 3]", "Frequency": "[5; 7]", "Phase": ".1", "Bias": "1"}
    found = run(one_block(tmp_path, "Sin", many, ()), [])
    wanted = np.sin(np.outer(TIME, [5.0, 7.0]) + 0.1) * [2.0, 3.0] + 1.0
    assert np.allclose(found, wanted, rtol=1e-13, atol=1e-15)


def test_a_delay_with_taps_or_an_enable_remembers(tmp_path: Path) -> None:
    values = {"NumDelays": "3", "vinit": "7", "DelayOrder": "Newest", "includeCurrent": "on"}
    found = run(one_block(tmp_path, "simulink/Discrete/Tapped Delay", values, ("double",)), [DRAWN[0]])
    padded = np.r_[[7.0] * 3, DRAWN[0]]
    assert np.array_equal(found, np.c_[padded[3:], padded[2:-1], padded[1:-2], padded[:-3]])
    enabled = one_block(tmp_path, "hdlsllib/Discrete/Unit Delay Enabled", {"vinit": "2"}, ("double", "boolean"))
    on = DRAWN[1] > 0
    wanted = recurrent(lambda u, e, x: (x, u if e else x), 2.0)(DRAWN[0], on)
    assert np.array_equal(run(enabled, [DRAWN[0], on]), wanted)


def test_polar_numbers_become_cartesian_and_again_polar(tmp_path: Path) -> None:
    blocks: Blocks = [("Inport", "x", {}), ("Inport", "y", {"Port": "2"})]
    for name, kind in (("polar", "Cartesian to\nPolar"), ("again", "Polar to\nCartesian")):
        values = {"SourceBlock": f"simulink_extras/Transformations/{kind}", "Ports": "[2, 2]"}
        blocks += [("Reference", name, values)]
    blocks += [("Outport", name, {"Port": str(k)}) for k, name in enumerate(("r", "a", "u", "v"), start=1)]
    lines = [("x", "polar:1"), ("y", "polar:2"), ("polar:1", "again:1"), ("polar:2", "again:2")]
    lines += [("polar:1", "r"), ("polar:2", "a"), ("again:1", "u"), ("again:2", "v")]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)
    assert found.diagram is not None, found.refused
    got = build(found.diagram, dt=DT).machine().run(STEPS, {"x": DRAWN[0], "y": DRAWN[1]})
    wanted = {"r": np.hypot(*DRAWN[:2]), "a": np.arctan2(DRAWN[1], DRAWN[0]), "u": DRAWN[0], "v": DRAWN[1]}
    for name, one in wanted.items():
        assert np.allclose(got[name], one, rtol=1e-14, atol=1e-14)


def test_a_library_of_the_users_is_not_taken_for_simulinks(tmp_path: Path) -> None:
    library = '<ModelInformation><Library><System><Block BlockType="Gain" Name="Difference" SID="1">'
    library += '<P Name="Gain">9</P></Block></System></Library></ModelInformation>'
    slx({"simulink/blockdiagram.xml": library}, tmp_path / "mine.slx")
    blocks: Blocks = [
        ("Inport", "u1", {"OutDataTypeStr": "double"}),
        ("Reference", "block", {"SourceBlock": "mine/Difference", "Ports": "[1, 1]"}),
        ("ComboBox", "choice", {}),
        ("Outport", "y", {}),
    ]
    path = model_of(blocks, [*pairwise(["u1", "block", "y"])], tmp_path / "m.slx")
    found = import_system(read_model(path), "", {}, [tmp_path], DT)
    assert np.array_equal(run(found, [DRAWN[0]]), 9 * DRAWN[0])
    assert [line.path for line in found.report if line.status == "dropped"] == ["choice"]


@pytest.mark.parametrize(
    ("criteria", "threshold", "taken"),
    [
        ("u2 > Threshold", "0", lambda on: on),
        ("u2 >= Threshold", "0", lambda on: on | True),
        ("u2 > Threshold", "1", lambda on: on & False),
        ("u2 ~= 0", "7", lambda on: on),
    ],
)
def test_a_switch_compares_a_boolean_as_0_or_1_and_takes_a_boolean_beside_a_double(
    tmp_path: Path, criteria: str, threshold: str, taken: Wanted
) -> None:
    values = {"Criteria": criteria, "Threshold": threshold}
    found = one_block(tmp_path, "Switch", values, ("double", "boolean", "boolean"))
    on, other = DRAWN[1] > 0, DRAWN[2] > 0
    assert np.array_equal(run(found, [DRAWN[0], on, other]), np.where(taken(on), DRAWN[0], other.astype(float)))


def test_a_switch_without_its_three_inputs_is_refused(tmp_path: Path) -> None:
    (refused,) = one_block(tmp_path, "Switch", {}, ()).refused
    assert refused.why == "it has 0 inputs; a Switch has 3"


# --- blocks of toolboxes


def windows(u: np.ndarray, size: int) -> np.ndarray:
    """The last samples at each, the oldest first; 0 before the start."""
    return np.lib.stride_tricks.sliding_window_view(np.r_[np.zeros(size - 1), u], size)


def estimated(y: np.ndarray, turns: int = 0) -> np.ndarray:
    """What a Kalman filter of position and speed gives after `turns` samples at 0, by its definition."""
    a, c, q, r = np.array([[1.0, DT], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.diag([1e-3, 1e-1]), 0.5
    x, p, found = np.array([[0.3], [0.0]]), 2.0 * np.eye(2), []
    for _ in range(turns):
        p = a @ (p - p @ c.T @ c @ p / (c @ p @ c.T + r)) @ a.T + q
    for measured in y:
        gain = p @ c.T / (c @ p @ c.T + r)
        x, p = x + gain * (measured - c @ x), (np.eye(2) - gain @ c) @ p
        found.append(x.flatten())
        x, p = a @ x, a @ p @ a.T + q
    return np.array(found)


KALMAN = {"TimeDomain": "Discrete-Time", "ModelSource": "Individual A, B, C, D matrices", "A": "[1 .01; 0 1]",
          "C": "[1 0]", "X0": "[.3; 0]", "P0": "2", "Q": "[1e-3; .1]", "R": ".5", "UseGH": "off",
          "AddInputPort": "off"}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "values", "wanted"),
    [
        ("dspstat3/Median Filter", {"WindowLength": "6"}, lambda u: np.median(windows(u, 6), axis=1)),
        ("dspstat3/Median Filter", {"WindowLength": "7"}, lambda u: np.median(windows(u, 7), axis=1)),
        ("dspstat3/Moving Average", {"WindowLength": "5"}, lambda u: windows(u, 5).mean(axis=1)),
        ("dspstat3/Moving Average", {"WindowLength": "2"}, lambda u: windows(u, 2).mean(axis=1)),
        ("dspbuff3/Delay Line", {"siz": "3", "directfeed": "off"}, lambda u: windows(before(u), 3)),
        ("ctrlSharedLib/Kalman Filter", KALMAN, lambda u: estimated(u, 5000)),
        ("ctrlSharedLib/Kalman Filter", {**KALMAN, "UseCurrentEstimator": "off"},
         lambda u: np.vstack([[0.3, 0.0], (estimated(u, 5000) @ [[1.0, 0.0], [DT, 1.0]])[:-1]])),
    ],
)  # fmt: skip
def test_a_block_of_a_toolbox_is_its_definition(
    tmp_path: Path, kind: str, values: dict[str, str], wanted: Wanted
) -> None:
    found = run(one_block(tmp_path, kind, values, ("double",)), [DRAWN[0]])
    assert np.allclose(found, wanted(DRAWN[0]), rtol=1e-12, atol=1e-12)


def test_a_kalman_filter_with_a_covariance_that_varies_computes_its_gain_in_each_sample(tmp_path: Path) -> None:
    found = one_block(tmp_path, "ctrlSharedLib/Kalman Filter", {**KALMAN, "TimeInvariantR": "off"}, ("double",) * 2)
    assert np.allclose(run(found, [DRAWN[0], np.full(STEPS, 0.5)]), estimated(DRAWN[0]), rtol=1e-12, atol=1e-12)


def test_a_kalman_filter_with_an_input_predicts_alone_where_it_is_not_enabled(tmp_path: Path) -> None:
    values = {"A": "1", "B": ".01", "C": "1", "D": "0", "X0": "0", "Q": "1e-4", "R": "1", "AddInputPort": "on",
              "AddEnablePort": "on"}  # fmt: skip
    found = one_block(tmp_path, "ctrlSharedLib/Kalman Filter", KALMAN | values, ("double", "double", "boolean"))
    p = (1e-4 + np.sqrt(1e-8 + 4e-4)) / 2.0  # P^2 = Q (P + R)
    gain, on = p / (p + 1.0), DRAWN[2] > 0.0

    def step(u: float, y: float, enabled: bool, x: float) -> tuple[float, float]:
        now = x + gain * (y - x) if enabled else x
        return now, now + 0.01 * u

    measured = np.where(on, DRAWN[1], np.nan)
    wanted = recurrent(step, 0.0)(DRAWN[0], measured, on)
    assert np.allclose(run(found, [DRAWN[0], measured, on]), wanted, rtol=1e-12, atol=1e-12)


def test_a_line_is_fitted_to_the_last_samples(tmp_path: Path) -> None:
    blocks: Blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Reference", "line", {"SourceBlock": "dspbuff3/Delay Line", "siz": "5"}),
        ("Reference", "fit", {"SourceBlock": "dsppolyfun/Least Squares Polynomial Fit", "X": "(0:4)*.01", "N": "1"}),
        ("Outport", "y", {}),
    ]
    model = model_of(blocks, [("u", "line"), ("line", "fit"), ("fit", "y")], tmp_path / "m.slx")
    found = import_system(read_model(model), dt=DT)
    wanted = [np.polyfit(np.arange(5) * 0.01, one, 1) for one in windows(DRAWN[0], 5)]
    assert found.diagram is not None
    built = build(from_json(to_json(found.diagram)), dt=found.dt)
    assert np.allclose(built.machine().run(STEPS, {"u": DRAWN[0]})["y"], wanted, rtol=1e-9, atol=1e-9)


def test_a_delay_is_as_long_as_its_port_says(tmp_path: Path) -> None:
    count = np.random.default_rng(2).integers(0, 12, STEPS)
    values = {"DelayLengthSource": "Input port", "DelayLengthUpperLimit": "8", "InitialCondition": "-1"}
    found = run(one_block(tmp_path, "Delay", values, ("double", "uint32")), [DRAWN[0], count])
    past = np.r_[-np.ones(8), DRAWN[0]]
    assert np.array_equal(found, [past[k + 8 - min(n, 8)] for k, n in enumerate(count)])


def test_the_rest_of_a_toolbox_is_looked_for_in_files_and_other_forms_are_refused(tmp_path: Path) -> None:
    (line,) = one_block(tmp_path, "dspstat3/Variance", {}, ("double",)).refused
    assert line.why == "the library dspstat3 is not found: name its folder with --path"
    (line,) = one_block(tmp_path, "ctrlSharedLib/Kalman Filter", {**KALMAN, "N": "1"}, ("double",)).refused
    assert line.why.startswith("noises that depend on one another")


WHOLE = np.random.default_rng(9).integers(0, 256, (2, STEPS)).astype(np.uint8)
HDL = "hdlsllib/Logic and Bit Operations"
_FIELD = "Treat bit field as an integer"


def _wide(u: np.ndarray) -> np.ndarray:
    return u.astype(np.int64) if u.dtype == np.uint8 else u


@pytest.mark.parametrize(
    ("kind", "values", "wanted"),
    [
        (f"{HDL}/Bit Shift", {"mode": "Shift Left Logical", "N": "3"}, lambda a: a << 3 & 255),
        (f"{HDL}/Bit Shift", {"mode": "Shift Right Logical", "N": "2"}, lambda a: a >> 2),
        (f"{HDL}/Bit Slice", {"lidx": "6", "ridx": "3"}, lambda a: a >> 3 & 15),
        (f"{HDL}/Bit Concat", {}, lambda a, b: a << 8 | b),
        (
            f"{LOGIC}/Extract Bits",
            {"bitsToExtract": "Range of bits", "bitIdxRange": "[1 4]", "outScalingMode": _FIELD},
            lambda a: a >> 1 & 15,
        ),
        ("Switch", {"Criteria": "u2 ~= 0"}, lambda a, b, c: np.where(b, a, c)),
        (
            "MultiPortSwitch",
            {"Inputs": "2", "DataPortOrder": "Zero-based contiguous"},
            lambda a, b, c: np.where(a, c, b),
        ),
    ],
)
def test_bits_of_whole_numbers_are_taken_and_joined(
    tmp_path: Path, kind: str, values: dict[str, str], wanted: Wanted
) -> None:
    count = wanted.__code__.co_argcount
    given = [WHOLE[0], WHOLE[1], DRAWN[0]][:count]
    kinds = ("uint8", "uint8", "double")[:count]
    assert np.array_equal(run(one_block(tmp_path, kind, values, kinds), given), wanted(*map(_wide, given)))


def test_a_sine_takes_its_time_from_a_signal_and_a_delay_its_length_from_the_dialog(tmp_path: Path) -> None:
    values = {"TimeSource": "Use external signal", "Amplitude": "2", "Bias": "1", "Frequency": "3", "Phase": ".5"}
    found = run(one_block(tmp_path, "Sin", values, ("double",)), [DRAWN[0]])
    assert np.allclose(
        found, 2.0 * np.sin(3.0 * DRAWN[0] + 0.5) + 1.0, rtol=0.0, atol=1e-14
    )  # a few units in the last place
    late = one_block(tmp_path, "simulink/Discrete/Integer Delay", {"NumDelays": "3", "vinit": "7"}, ("double",))
    assert np.array_equal(run(late, [DRAWN[0]]), np.r_[7.0, 7.0, 7.0, DRAWN[0][:-3]])
