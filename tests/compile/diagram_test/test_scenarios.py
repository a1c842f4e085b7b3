"""Scenarios run on every target, and judged as a written-out loop judges them."""

import math
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof.blocks import Block, Diagram, Port, maximum
from twodof.blocks.library import Convert, Gain, Logic, Sum, UnitDelay
from twodof.compile.diagram_test import (
    ExpectedTable,
    InputSignal,
    PointsInput,
    RampInput,
    Scenario,
    SineInput,
    StepInput,
    measure_coverage,
    run_scenario,
    table_of,
    to_junit,
)
from twodof.errors import DiagramError, ParameterError

DT = 0.01


def lag() -> Diagram:
    """y[k+1] = y[k] + k (r[k] - y[k]): a discrete first-order lag with a gain of one."""
    d = Diagram("lag")
    d.input("r")
    d.input("stop", "bool")
    d.param("k", 0.1, low=0.0, high=1.0)
    d.add("error", Sum("+-"), a="r", b="memory")
    d.add("gain", Gain(), u="error", params={"k": "k"})
    d.add("next", Sum("++"), a="memory", b="gain")
    d.add("memory", UnitDelay(), u="next")
    d.add("going", Logic("not"), a="stop")
    d.output("y", "memory")
    d.output("going", "going")
    return d


def test_the_lag_is_where_its_closed_form_says() -> None:
    """y[k] = 1 - .9^k: it passes .9 at tick 22, and is within .05 of 1 from tick 29 on."""
    scenario = Scenario(
        "step",
        1.0,
        {"r": 1.0},
        checks=[
            "y rises to 0.9 before 0.23",
            "y rises to 0.9 before 0.22",
            "y settles within 0.05 of 1 by 0.29",
            "y settles within 0.05 of 1 by 0.28",
            "going always equals true",
            "gain.y final value within 1e-3 of 0",
        ],
    )
    result = run_scenario(lag(), scenario, DT)
    assert [j.passed for j in result.judgements] == [True, False, True, False, True, True]
    assert [j.tick for j in result.judgements] == [None, 21, None, 28, None, None]
    assert result.judgements[2].text == "settled at 0.29 s"
    assert len(result.time) == 101
    assert str(result).splitlines()[1] == f"step: {scenario.checks[3]}: 0.947665 at 0.28 s is below 0.95 by 0.00233"
    fast = run_scenario(lag(), Scenario("fast", 1.0, {"r": 1.0}, {"k": 0.5}, ["y rises to 0.9 before 0.05"]), DT)
    assert fast.passed, fast


TIMES = np.arange(60) * DT


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        (StepInput(2.0, 0.105, before=-1.0), np.where(TIMES >= 0.105, 2.0, -1.0)),
        (RampInput(2.0, 0.1, 0.3, before=1.0), 1.0 + 2.0 * np.clip(TIMES - 0.1, 0.0, 0.2)),
        (SineInput(0.5, 7.0, 0.3, offset=1.0), 1.0 + 0.5 * np.sin(2 * math.pi * 7.0 * TIMES + 0.3)),
        (PointsInput([(0.1, 1.0), (0.2, 3.0)], "interpolate"), np.interp(TIMES, [0.1, 0.2], [1.0, 3.0])),
        (
            PointsInput([(0.0, 1.0), (0.2, 3.0), (0.255, 0.0)], "hold"),
            np.select([TIMES < 0.195, TIMES < 0.255], [1, 3]),
        ),
    ],
)
def test_a_signal_has_the_values_of_its_formula(signal: InputSignal, expected: np.ndarray) -> None:
    found = signal.values(60, DT)
    assert np.max(np.abs(found - expected)) < 1e-14


def rows_of(steps: int) -> dict[str, list[float | None]]:
    """The lag's columns, by a loop in Python."""
    y, columns = 0.0, {name: [] for name in ("time", "r", "y", "going")}
    for k in range(steps):
        r = 1.0 if k < 20 else -0.5
        for name, value in (("time", k * DT), ("r", r), ("y", y), ("going", True)):
            columns[name].append(value)
        y += 0.1 * (r - y)
    return columns


def test_a_table_feeds_inputs_and_expects_outputs() -> None:
    columns = rows_of(40)
    exact = Scenario("table", table=ExpectedTable(table_of(columns), absolute=0.0, relative=1e-15))
    assert run_scenario(lag(), exact, DT).passed
    wrong = {**columns, "y": [*columns["y"][:30], columns["y"][30] + 0.003, *columns["y"][31:]]}
    for relative, absolute, passes in ((0.0, 0.002, False), (0.0, 0.0031, True), (0.2, 0.0, True), (0.1, 0.0, False)):
        table = ExpectedTable(table_of(wrong), absolute=absolute, relative=relative)
        found = run_scenario(lag(), Scenario("table", table=table), DT)
        assert found.passed == passes
        assert passes or found.failed[0].tick == 30


NUMBERS = st.sampled_from([-math.inf, -1.0, 0.0, 0.5, 0.75, 1.0, 2.0, math.inf, math.nan])


@settings(max_examples=60)
@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=5), st.sampled_from([0.0, 0.25, 0.5, 1.0]))
def test_what_is_expected_is_so_within_the_tolerance(rows: list[tuple[float, float]], tolerance: float) -> None:
    """The sums are exact, so the limit itself can be met: |v - e| <= t + t |e|. NaN and infinity are themselves."""
    table = table_of({"tick": range(len(rows)), "y": [expected for _, expected in rows]})
    column = ExpectedTable(table, "hold", tolerance, tolerance).expected("y", "y", False, len(rows), DT)

    def holds(value: float, expected: float) -> bool:
        if math.isnan(value) or math.isnan(expected):
            return math.isnan(value) and math.isnan(expected)
        if math.isinf(value) or math.isinf(expected):
            return value == expected
        return abs(value - expected) <= tolerance + tolerance * abs(expected)

    wrong = [k for k, row in enumerate(rows) if not holds(*row)]
    found = column.judge(np.array([value for value, _ in rows]), DT)
    assert (found.passed, found.tick) == (not wrong, wrong[0] if wrong else None)


def test_only_what_is_given_is_expected_at_rows_or_at_each_tick() -> None:
    """Rows every .1 s: at the rows the lag is exact, on the lines between them it is not, and empty cells pass."""
    columns = rows_of(41)
    sparse = {name: cells[::10] for name, cells in columns.items()}
    del sparse["going"]
    at_rows = ExpectedTable(table_of(sparse), "hold", 1e-15)
    assert run_scenario(lag(), Scenario("rows", table=at_rows), DT).passed
    lines = ExpectedTable(table_of(sparse), "interpolate", 1e-15, at="ticks")
    inputs = {name: cells for name, cells in sparse.items() if name != "y"}
    found = run_scenario(lag(), Scenario("lines", table=lines), DT)
    assert found.failed[0].tick == 1
    y = run_scenario(lag(), Scenario("none", table=ExpectedTable(table_of({**inputs, "y": [0.0, *[None] * 4]}))), DT)
    assert y.passed
    assert y.judgements[0].text.startswith("1 values")


class Turned(Block):
    """The transpose of a matrix, with negative elements cut off."""

    inputs = (Port("a", shape=(2, 3)),)
    outputs = (Port("y", shape=(3, 2)),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return maximum(u.a.T, 0.0)


def test_matrices_are_fed_and_read_by_row_and_column() -> None:
    d = Diagram("matrices")
    d.input("a", shape=(2, 3))
    d.add("turned", Turned(), a="a")
    d.output("y", "turned")
    rows = [[1.0, 2.0, 3.0], [4.0, -5.0, StepInput(6.0, 0.01)]]
    checks = ["y[2,0] always equals 3", "y[ 1, 1 ] always equals 0", "y[2, 1] final value within 0 of 6"]
    scenario = Scenario("rows", 0.01, {"a": rows}, checks=[*checks, "y[2, 1] never above 5"])
    for target in ("native", "reference"):
        result = run_scenario(d, scenario, DT, target=target)
        assert [j.passed for j in result.judgements] == [True, True, True, False]
        assert result.signals["y"].shape == (2, 3, 2)
    coverage = measure_coverage(d, [scenario], DT)
    assert coverage.sides == 2  # a loop's turns are one decision
    assert not coverage.missing  # one element is cut off, the others are not
    table = table_of({"tick": [0, 1], "a[1,2]": [1.0, 7.0], "y[2,1]": [1.0, 7.0]})
    assert run_scenario(d, Scenario("table", table=ExpectedTable(table)), DT).passed
    for check in ("y never above 1", "y[0] never above 1", "y[0,2] never above 1"):
        with pytest.raises(DiagramError, match="array of 3 x 2"):
            run_scenario(d, Scenario("x", 0.02, checks=[check]), DT, target="reference")
    with pytest.raises(DiagramError, match="2 values for an array of 3"):
        run_scenario(d, Scenario("x", 0.02, {"a": [[1, 2], [3, 4]]}, checks=checks), DT, target="reference")


def test_integers_are_held_and_must_be_whole() -> None:
    d = Diagram("whole")
    d.input("n", "int32")
    d.add("same", Convert("int32", "real"), u="n")
    d.output("y", "same")
    points = PointsInput([(0.0, 1), (0.04, 5)], "interpolate")
    assert run_scenario(d, Scenario("held", 0.03, {"n": points}, checks=["y always equals 1"]), DT).passed
    with pytest.raises(DiagramError, match=r"0\.5 does not fit int32"):
        run_scenario(d, Scenario("half", 0.03, {"n": 0.5}, checks=["y always equals 1"]), DT)


@pytest.mark.parametrize(
    ("scenario", "what"),
    [
        (Scenario("x", 1.0, {"q": 1.0}, checks=["y never above 1"]), "no input named 'q'"),
        (Scenario("x", 1.0, checks=["z never above 1"]), "no output named 'z'"),
        (Scenario("x", 1.0, checks=["gain.z never above 1"]), "gain.z"),
        (Scenario("x", 1.0, {"r": 1.0}), "checks nothing"),
        (Scenario("x", checks=["y never above 1"]), "no duration"),
        (Scenario("x", 1e9, checks=["y never above 1"]), "run 1 to"),
        (Scenario("x", math.nan, checks=["y never above 1"]), "run 1 to"),
        (Scenario("x", 1.0, {"stop": 0.5}, checks=["y never above 1"]), "0.5 does not fit bool"),
        (Scenario("x", table=ExpectedTable(table_of({"time": [0.0], "r": [None], "y": [0]}))), "empty"),
        (Scenario("x", table=ExpectedTable(table_of({"time": [0.01], "r": [1], "y": [0]}))), "not at 0"),
        (Scenario("x", table=ExpectedTable(table_of({"time": [0.005], "y": [0]}))), "between two ticks"),
        (Scenario("x", 0.1, table=ExpectedTable(table_of({"time": [0.5], "y": [0]}))), "ends before"),
        (Scenario("x", 0.1, {"r": 1}, table=ExpectedTable(table_of({"time": [0], "r": [1], "y": [0]}))), "given twice"),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused(scenario: Scenario, what: str) -> None:
    with pytest.raises(DiagramError, match=what):
        run_scenario(lag(), scenario, DT, target="reference")


def test_a_parameter_is_set_before_the_states_begin() -> None:
    """The initial value of a state may be a parameter."""
    scenario = Scenario("begun", 0.0, {}, {"memory.initial": 2.0}, ["y always equals 2"])
    for target in ("native", "reference"):
        assert run_scenario(lag(), scenario, DT, target=target).passed


def test_a_mistake_names_its_scenario() -> None:
    for parameters, where in (({"k": 2.0}, "fast, k"), ({"k": "1"}, "fast, k"), ({"kp": 1.0}, "fast")):
        with pytest.raises(ParameterError) as caught:
            run_scenario(lag(), Scenario("fast", 1.0, {}, parameters, ["y never above 1"]), DT, target="reference")
        assert caught.value.where == where
    late = Scenario("slow", 0.1, checks=["y never above 1 until 3"])
    with pytest.raises(DiagramError) as late_claim:
        run_scenario(lag(), late, DT, target="reference")
    assert late_claim.value.where == "slow, y never above 1 until 3"


def test_junit_names_each_assertion() -> None:
    scenario = Scenario("a <b>", 0.1, {"r": 1.0}, checks=["y never above 0.1", "y never below 0"])
    document = ElementTree.fromstring(to_junit({"x.toml": [run_scenario(lag(), scenario, DT, target="reference")]}))
    (suite,) = document
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("x.toml", "2", "1")
    assert [(c.get("classname"), c.get("name"), len(c)) for c in suite] == [
        ("a <b>", "y never above 0.1", 1),
        ("a <b>", "y never below 0", 0),
    ]
