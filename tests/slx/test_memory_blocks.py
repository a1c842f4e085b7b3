"""Integrators, delays and filters in the forms that Simulink gives them, beside the steps of MathWorks' C in numpy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.slx.files import Blocks, model_of
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.slx.importer import import_system
from twodof.slx.model import read_model

pytestmark = pytest.mark.slow
DT = 0.01
STEPS = 250
DRAWN = np.random.default_rng(7).normal(0.0, 2.0, (3, STEPS)).round(2)
CONTROL = np.random.default_rng(8).integers(-1, 2, STEPS).astype(float)


def run(
    tmp_path: Path, kind: str, values: dict[str, str], inputs: list[np.ndarray], outputs: int = 1
) -> dict[str, np.ndarray]:
    """Import a block with these inputs, doubles of their width or booleans, and run it."""
    blocks: Blocks = []
    for k, one in enumerate(inputs, start=1):
        width = {} if one.ndim == 1 else {"PortDimensions": str(one.shape[1])}
        said = "boolean" if one.dtype == bool else "double"
        blocks.append(("Inport", f"u{k}", {"Port": str(k), "OutDataTypeStr": said, **width}))
    blocks.append((kind, "block", {"Ports": f"[{len(inputs)}, {outputs}]", **values}))
    blocks += [("Outport", f"y{k}", {"Port": str(k)}) for k in range(1, outputs + 1)]
    lines = [(f"u{k}", f"block:{k}") for k in range(1, len(inputs) + 1)]
    lines += [(f"block:{k}", f"y{k}") for k in range(1, outputs + 1)]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)
    assert found.diagram is not None, found.refused
    given = {f"u{k}": one for k, one in enumerate(inputs, start=1)}
    return build(from_json(to_json(found.diagram)), dt=DT).machine().run(STEPS, given)


def resets(control: np.ndarray, edge: str) -> np.ndarray:
    """Return where an integrator starts afresh, by the sign that MathWorks' C keeps as PrevResetState."""
    before, found = 2, []
    for v in np.sign(control):
        up, down = v > 0 and before <= 0, v <= 0 and before == 1
        level = v != 0 or before != 0
        found.append({"rising": up, "falling": down, "either": up or down, "level": level, "level hold": v != 0}[edge])
        before = v
    return np.array(found)


EDGES = ["rising", "falling", "either", "level"]


@pytest.mark.parametrize("edge", [*EDGES, "sampled level"])
@pytest.mark.parametrize("method", ["Forward Euler", "Backward Euler", "Trapezoidal"])
@pytest.mark.parametrize("setting", ["Auto", "Output"])
def test_a_discrete_integrator_resets_limits_and_starts_from_a_signal(
    tmp_path: Path, setting: str, method: str, edge: str
) -> None:
    values = {
        "InitialConditionSetting": setting,
        "IntegratorMethod": f"Integration: {method}",
        "gainval": "3",
        "ExternalReset": edge,
        "InitialConditionSource": "external",
        "LimitOutput": "on",
        "UpperSaturationLimit": "1.5",
        "LowerSaturationLimit": "-1",
        "ShowSaturationPort": "on",
    }
    got = run(tmp_path, "DiscreteIntegrator", values, [DRAWN[0] * 10, CONTROL, DRAWN[1]], 2)
    step = 3.0 * DT * (0.5 if method == "Trapezoidal" else 1.0)
    wanted, limited, state = [], [], 0.0

    def held(value: float) -> float:
        return min(max(value, -1.0), 1.5)

    starts = resets(CONTROL, edge.replace("sampled level", "level hold"))
    for k, (u, x0) in enumerate(zip(DRAWN[0] * 10, DRAWN[1], strict=True)):
        state = x0 if starts[k] or k == 0 else state
        shown = method == "Forward Euler" or (setting == "Output" and (starts[k] or k == 0))
        y = held(state if shown else state + step * u)
        state = y if method == "Backward Euler" else held(y + step * u)
        wanted.append(y)
        limited.append(1.0 if y >= 1.5 else -1.0 if y <= -1.0 else 0.0)
    assert np.array_equal(got["y1"], wanted)
    assert np.array_equal(got["y2"], limited)
    assert 20 < np.count_nonzero(limited) < 230


def test_an_accumulator_takes_no_period(tmp_path: Path) -> None:
    values = {"IntegratorMethod": "Accumulation: Backward Euler", "gainval": "0.7", "InitialCondition": "2"}
    wanted = [2.0]  # in the first step the output is the initial value
    for u in DRAWN[0][1:]:
        wanted.append(wanted[-1] + 0.7 * u)
    assert np.array_equal(run(tmp_path, "DiscreteIntegrator", values, [DRAWN[0]])["y1"], wanted)


@pytest.mark.parametrize("ported", [False, True])
def test_a_delay_begins_with_what_its_port_gives(tmp_path: Path, ported: bool) -> None:
    """Its first values, and those after a rising edge, are what the port gave then."""
    length = np.full(STEPS, 3.0)
    values = {"InitialConditionSource": "Input port", "ExternalReset": "Rising", "DelayLength": "3"}
    values |= {"DelayLengthSource": "Input port", "DelayLengthUpperLimit": "9"} if ported else {}
    wanted, kept = [], list[float]()
    for k, clear in enumerate(resets(CONTROL, "rising")):
        kept = [float(DRAWN[1][k])] * 3 if clear or not k else kept
        wanted.append(kept[0])
        kept = [*kept[1:], float(DRAWN[0][k])]
    found = run(tmp_path, "Delay", values, [DRAWN[0], *[length] * ported, CONTROL, DRAWN[1]])
    assert np.array_equal(found["y1"], wanted)


@pytest.mark.parametrize("edge", EDGES)
def test_an_integrator_starts_afresh_and_is_wrapped(tmp_path: Path, edge: str) -> None:
    values = {"ExternalReset": edge, "InitialCondition": "1", "WrapState": "on"}
    got = run(tmp_path, "Integrator", values, [DRAWN[0] * 200, CONTROL])["y1"]
    wanted, state = [], 1.0
    for u, again in zip(DRAWN[0] * 200, resets(CONTROL, edge), strict=True):
        state = 1.0 if again else state
        wanted.append((state + np.pi) % (2 * np.pi) - np.pi)
        state += DT * u
    # Four stages of a constant slope: some units in the last place.
    assert np.allclose(got, wanted, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("edge", EDGES)
def test_a_delay_and_a_pid_start_afresh(tmp_path: Path, edge: str) -> None:
    again = resets(CONTROL, edge)
    delayed = run(
        tmp_path, "Delay", {"DelayLength": "2", "InitialCondition": "9", "ExternalReset": edge}, [DRAWN[0], CONTROL]
    )
    wanted, kept = [], [9.0, 9.0]
    for u, now in zip(DRAWN[0], again, strict=True):
        kept = [9.0, 9.0] if now else kept
        wanted.append(kept[0])
        kept = [kept[1], u]
    assert np.array_equal(delayed["y1"], wanted)
    pid = {"SourceBlock": "slpidlib/PID Controller", "TimeDomain": "Discrete-time", "Controller": "PI", "P": "2",
           "I": "5", "ExternalReset": edge, "InitialConditionForIntegrator": ".5"}  # fmt: skip
    wanted, integral = [], 0.5
    for u, now in zip(DRAWN[0], again, strict=True):
        integral = 0.5 if now else integral
        wanted.append(2.0 * u + integral)
        integral += DT * (5.0 * u)
    assert np.array_equal(run(tmp_path, "Reference", pid, [DRAWN[0], CONTROL])["y1"], wanted)


def test_a_filter_of_a_vector_filters_each_element(tmp_path: Path) -> None:
    values = {"Numerator": "[1 .5]", "Denominator": "[1 -.3]"}
    alone = [run(tmp_path, "DiscreteFilter", values, [row])["y1"] for row in DRAWN]
    assert np.array_equal(run(tmp_path, "DiscreteFilter", values, [DRAWN.T.copy()])["y1"], np.array(alone).T)


def test_a_table_of_a_vector_looks_up_each_element(tmp_path: Path) -> None:
    values = {"InputValues": "[-2 0 3]", "Table": "[1 2.5 4]", "LookUpMeth": "Interpolation-Use End Values"}
    found = run(tmp_path, "Lookup", values, [DRAWN.T])["y1"]
    assert np.allclose(found, np.interp(DRAWN.T, [-2, 0, 3], [1, 2.5, 4]), rtol=1e-14)


def test_a_flip_flop_follows_its_table(tmp_path: Path) -> None:
    values = {"SourceBlock": "simulink_extras/Flip Flops/S-R Flip-Flop", "initial_condition": "1"}
    s, r = DRAWN[0] > 1.0, DRAWN[1] > 1.0
    got = run(tmp_path, "Reference", values, [s, r], 2)
    table = {(0, 0, 0): (0, 1), (0, 0, 1): (1, 0), (0, 1, 0): (0, 1), (0, 1, 1): (0, 1),
             (1, 0, 0): (1, 0), (1, 0, 1): (1, 0), (1, 1, 0): (0, 0), (1, 1, 1): (0, 0)}  # fmt: skip
    state, wanted = 1, []
    for row in zip(s, r, strict=True):
        both = table[int(row[0]), int(row[1]), state]
        state = both[0]
        wanted.append(both)
    assert np.array_equal(np.c_[got["y1"], got["y2"]], wanted)
    assert len(set(zip(s.tolist(), r.tolist(), strict=True))) == 4


def test_a_second_order_integrator_is_two_in_a_row(tmp_path: Path) -> None:
    """A constant acceleration, which the solver integrates without an error of its own."""
    got = run(tmp_path, "SecondOrderIntegrator", {"ICX": "1", "ICDXDT": "-2"}, [np.full(STEPS, 3.0)], 2)
    t = np.arange(STEPS) * DT
    assert np.allclose(got["y1"], 1.0 - 2.0 * t + 1.5 * t**2, rtol=0.0, atol=1e-12)
    assert np.allclose(got["y2"], -2.0 + 3.0 * t, rtol=0.0, atol=1e-12)


def test_a_pid_of_two_degrees_of_freedom_weighs_its_set_point_and_clamps_its_integral(tmp_path: Path) -> None:
    """P of b r - y, I of r - y; the integral stands still while the output is limited and the error goes further."""
    values = {"SourceBlock": "pid_lib/PID Controller (2DOF)", "TimeDomain": "Discrete-time", "Controller": "PI",
              "P": "2", "I": "50", "b": ".5", "LimitOutput": "on", "LowerSaturationLimit": "-3",
              "UpperSaturationLimit": "3", "AntiWindupMode": "clamping"}  # fmt: skip
    wanted, integral = [], 0.0
    for r, y in zip(*DRAWN[:2], strict=True):
        free, rate = 2.0 * (0.5 * r - y) + integral, 50.0 * (r - y)
        wanted.append(min(max(free, -3.0), 3.0))
        if not ((free > 3.0 and rate > 0.0) or (free < -3.0 and rate < 0.0)):
            integral += DT * rate
    assert np.array_equal(run(tmp_path, "Reference", values, [DRAWN[0], DRAWN[1]])["y1"], wanted)
    assert {-3.0, 3.0} < set(wanted)


@pytest.mark.parametrize("ported", [0, 1, 2])
def test_a_transposed_filter_filters_as_scipy_does(tmp_path: Path, ported: int) -> None:
    top, bottom = [0.5, 0.2, -0.1], [1.0, -1.2, 0.5]
    values = {"FilterStructure": "Direct form II transposed", "Denominator": str(bottom), "Numerator": str(top)}
    rows = [DRAWN[0]]
    for name, given in list(zip(("Numerator", "Denominator"), (top, bottom), strict=True))[:ported]:
        values[f"{name}Source"] = "Input port"
        rows.append(np.tile(given, (len(DRAWN[0]), 1)))
    found = run(tmp_path, "DiscreteFilter", values, rows)["y1"]
    assert np.allclose(found, lfilter(top, bottom, DRAWN[0]), rtol=0.0, atol=1e-12)  # scipy rounds in another order
