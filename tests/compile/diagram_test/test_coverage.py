"""Which sides of a diagram's decisions tests took: a diagram made by hand, and plain Python branches as the judge."""

import inspect
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof.blocks import Block, Diagram, Param, Port, State, fold, maximum, minimum, where
from twodof.blocks.elementary.functions import sin
from twodof.blocks.library import Constant, Gain, Integrator, Logic, Saturation
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile.diagram_test import PointsInput, Scenario, StepInput
from twodof.compile.diagram_test.coverage import Coverage, measure_coverage

DT = 0.01
Sides = dict[tuple[str, str], tuple[str, ...]]


def taken(coverage: Coverage) -> Sides:
    """The sides that were taken, by path and text of the decision."""
    return {(d.path, d.text): tuple(d.sides[i] for i in sorted(sides)) for d, sides in coverage.taken.items()}


class Chooser(Block):
    """Decisions within decisions, in a loop, of a state, and of bools."""

    inputs = (Port("u"), Port("a", "bool"), Port("b", "bool"))
    outputs = (Port("y"),)
    states = (State("x"),)
    params = (Param("k", 1.0),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        deep = where(u.u > 5.0, where(x.x < 3.0, 1.0, 2.0), minimum(u.u, p.k))
        steps = fold(3, [u.u], lambda i, s: [where(s < 2.0, s + 1.5, s)])[0]
        return where(u.a & ~u.b, deep, steps)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return maximum(u.u, x.x)


class Judge:
    """The same in plain Python: what is not executed does not decide."""

    def __init__(self) -> None:
        self.x = 0.0
        self.taken: dict[str, set[str]] = {}

    def asks(self, text: str, answer: bool, names: tuple[str, str] = ("true", "false")) -> bool:
        self.taken.setdefault(text, set()).add(names[0] if answer else names[1])
        return answer

    def step(self, u: float, a: bool, b: bool) -> None:
        self.asks("u.a", a)
        self.asks("u.b", b)
        if self.asks("u.a & ~u.b", a and not b):
            if self.asks("u.u > 5", u > 5.0):
                self.asks("x.x < 3", self.x < 3.0)
            else:
                self.asks("min(u.u, p.k)", u < 1.0, ("u.u", "p.k"))
        else:
            s = u
            for _ in range(3):
                if self.asks("s1 < 2", s < 2.0):
                    s += 1.5
        if self.asks("max(u.u, x.x)", self.x < u, ("u.u", "x.x")):
            self.x = u


STEP = st.tuples(st.sampled_from([-1.0, 0.5, 1.0, 2.5, 4.0, 6.0]), st.booleans(), st.booleans())


def chooser() -> Diagram:
    d = Diagram("choosers")
    d.input("u")
    d.input("a", "bool")
    d.input("b", "bool")
    d.add("chooser", Chooser(), u="u", a="a", b="b")
    d.output("y", "chooser")
    return d


@settings(max_examples=25)
@given(st.lists(STEP, min_size=1, max_size=6), st.booleans())
def test_the_sides_taken_are_those_of_python_branches(rows: list[tuple[float, bool, bool]], traced: bool) -> None:
    """The decisions of a block and of what JSON makes of it."""
    judge = Judge()
    for row in rows:
        judge.step(*row)
    points = [PointsInput([(k * DT, float(row[i])) for k, row in enumerate(rows)], "hold") for i in range(3)]
    inputs = dict(zip("uab", points, strict=True))
    scenario = Scenario("random", (len(rows) - 1) * DT, inputs, checks=["y never above 100"])
    d = from_json(to_json(chooser())) if traced else chooser()
    found = taken(measure_coverage(d, [scenario], DT))
    assert {text: set(sides) for (_, text), sides in found.items() if sides} == judge.taken
    assert len(found) == 8


def whole() -> Diagram:
    """Two limits, one of them in a sub-diagram that is enabled and reset and holds another one."""
    inner = Diagram("inner")
    inner.input("u")
    inner.add("limit", Saturation(-1.0, 1.0), u="u")
    inner.output("y", "limit")
    outer = Diagram("outer")
    outer.input("u")
    outer.input("go", "bool")
    outer.add("inner", inner, u="u", enable="go")
    outer.add("sum", Integrator(), u="inner.y")
    outer.output("y", "sum")
    d = Diagram("whole")
    for name, kind in (("u", "real"), ("on", "bool"), ("go", "bool"), ("clear", "bool")):
        d.input(name, kind)
    d.add("outer", outer, u="u", go="go", enable="on", reset="clear")
    d.add("limit", Saturation(-2.0, 2.0), u="outer.y")
    d.output("y", "limit")
    return d


def test_a_diagram_made_by_hand_has_the_sides_that_were_never_taken() -> None:
    """`on` is never true, so nothing inside decides; then it is, and `go` and `u` take one side each, then both."""
    d, claim = whole(), ["y never above 5"]
    one = Scenario("off", 0.1, {"u": 3.0, "go": True, "clear": True}, checks=claim)
    coverage = measure_coverage(d, [one], DT)
    assert coverage.sides == 14
    assert taken(coverage) == {
        ("outer.inner.limit", "min(p.high, u.u)"): (),
        ("outer.inner.limit", "max(p.low, min(p.high, u.u))"): (),
        ("limit", "min(p.high, u.u)"): ("u.u",),
        ("limit", "max(p.low, min(p.high, u.u))"): ("min(p.high, u.u)",),
        ("outer", "on"): ("off",),
        ("outer", "clear"): (),
        ("outer.inner", "go"): (),
    }
    assert coverage.share == 3 / 14
    two = Scenario("on", 0.1, {"u": 3.0, "go": True, "on": True}, checks=claim)
    both = measure_coverage(d, [one, two], DT)
    coverage.add(measure_coverage(d, [two], DT))
    assert coverage.taken == both.taken
    assert taken(both)["outer", "on"] == ("on", "off")
    assert taken(both)["outer", "clear"] == ("no reset",)
    assert taken(both)["outer.inner.limit", "min(p.high, u.u)"] == ("p.high",)
    never = {(decision.path, decision.text, side) for decision, side in both.missing}
    assert ("outer.inner", "go", "off") in never
    assert ("outer.inner.limit", "max(p.low, min(p.high, u.u))", "p.low") in never
    assert len(never) == 14 - 8


def test_a_trigger_has_edges_and_none() -> None:
    inner = Diagram("inner")
    inner.input("u")
    inner.add("limit", Saturation(-1.0, 1.0), u="u")
    inner.output("y", "limit")
    d = Diagram("triggered")
    d.input("u")
    d.input("go", "bool")
    d.add("inner", inner, u="u", trigger="go")
    d.output("y", "inner")

    def sides(*rows: bool) -> Sides:
        points = PointsInput([(k * DT, float(row)) for k, row in enumerate(rows)], "hold")
        scenario = Scenario("x", (len(rows) - 1) * DT, {"go": points, "u": 0.5}, checks=["y never above 5"])
        return taken(measure_coverage(d, [scenario], DT))

    assert sides(False, False) == {
        ("inner.limit", "min(p.high, u.u)"): (),
        ("inner.limit", "max(p.low, min(p.high, u.u))"): (),
        ("inner", "go"): ("no edge",),
    }
    assert sides(False, True)["inner", "go"] == ("edge", "no edge")
    assert sides(False, True)["inner.limit", "min(p.high, u.u)"] == ("u.u",)


@pytest.mark.parametrize("operation", ["and", "or", "nor"])
def test_each_operand_of_and_and_or_has_two_sides(operation: str) -> None:
    d = Diagram("logic")
    for name in "abc":
        d.input(name, "bool")
    d.add("logic", Logic(operation, 3), a="a", b="b", c="c")
    d.output("y", "logic")
    scenario = Scenario("x", 0.02, {"a": True, "b": StepInput(1, 0.02)}, checks=["y always within [0, 1]"])
    sign = {"and": "&", "or": "|", "nor": "|"}[operation]
    assert taken(measure_coverage(d, [scenario], DT)) == {
        ("logic", "u.a"): ("true",),
        ("logic", "u.b"): ("true", "false"),
        ("logic", f"u.a {sign} u.b"): ("true", "false") if operation == "and" else ("true",),
        ("logic", "u.c"): ("false",),
    }


class Everywhere(Block):
    """A decision in each method, of a continuous state and of a derived parameter."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("v", continuous=True),)
    params = (Param("k", 2.0),)
    derived = (Port("gain"),)

    def prepare(self, p: Any, t: Any) -> Any:
        return where(p.k > 1.0, 1.0, 0.5)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(x.v > 0.035, p.gain, x.v)

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(x.v < 0.025, u.u, 1.0)

    def project(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(x.v > 0.055, 0.0, x.v)


def test_every_method_and_stage_counts_and_names_the_line() -> None:
    """v = t: .025 is passed within a stage of the integration, .035 between two, .055 by the last step."""
    d = Diagram("everywhere")
    d.input("u")
    d.add("block", Everywhere(), u="u")
    d.output("y", "block")

    def sides(duration: float, k: float) -> Sides:
        scenario = Scenario("run", duration, {"u": 1.0}, {"k": k}, ["y never above 5"])
        renamed = replace(scenario, parameters={"block.k": k})
        return {at[1:]: side for at, side in taken(measure_coverage(d, [renamed], DT)).items()}

    assert sides(0.01, 2.0) == {
        ("p.k > 1",): ("true",),
        ("x.v > 0.035",): ("false",),
        ("x.v < 0.025",): ("true",),
        ("x.v > 0.055",): ("false",),
    }
    longer = sides(0.05, 0.5)
    assert longer["p.k > 1",] == ("true", "false")  # the default, and what the test sets
    assert longer["x.v > 0.035",] == longer["x.v < 0.025",] == longer["x.v > 0.055",] == ("true", "false")
    assert sides(0.02, 2.0)["x.v < 0.025",] == ("true", "false")  # at a stage of the step from .02 to .03
    lines, first = inspect.getsourcelines(Everywhere)
    decisions = measure_coverage(d, [Scenario("x", 0.0, checks=["y never above 5"])], DT).taken
    for decision in decisions:
        file, line = decision.place.split(":")
        assert file == "test_coverage.py"
        assert "where(" in lines[int(line) - first]


class Split(Block):
    """`early` does not need u, `late` does: the block is computed at two places of the order."""

    inputs = (Port("u"),)
    outputs = (Port("early"), Port("late"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"early": t.dt * 100.0, "late": where(u.u > 0.5, 1.0, 2.0)}


def test_an_input_that_is_not_known_yet_decides_nothing() -> None:
    """At its first place the input still has the value of the last tick, 0 before the first; it is 1 always."""
    d = Diagram("split")
    d.add("split", Split(), u="gain")
    d.add("gain", Gain(1.0), u="split.early")
    d.output("y", "split.late")
    found = taken(measure_coverage(d, [Scenario("x", 0.02, checks=["y always equals 1"])], DT))
    assert found == {("split", "u.u > 0.5"): ("true",)}


class BeforeLoop(Block):
    """The sine does not change in the loop, so it is computed before it, whether a turn uses it or not."""

    inputs = (Port("u"), Port("a", "bool"))
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return fold(3, [0.0], lambda i, s: [s + where(u.a, sin(where(u.u > 0.0, u.u, 1.0)), 0.0)])[0]


def test_what_is_computed_before_a_loop_counts_where_a_turn_uses_it() -> None:
    d = Diagram("before")
    d.input("a", "bool")
    d.add("one", Constant(1.0))
    d.add("loop", BeforeLoop(), u="one", a="a")
    d.output("y", "loop")

    def sides(a: bool) -> Sides:
        return taken(measure_coverage(d, [Scenario("x", 0.0, {"a": a}, checks=["y never above 5"])], DT))

    assert sides(False) == {("loop", "u.a"): ("false",), ("loop", "u.u > 0"): ()}
    assert sides(True) == {("loop", "u.a"): ("true",), ("loop", "u.u > 0"): ("true",)}
