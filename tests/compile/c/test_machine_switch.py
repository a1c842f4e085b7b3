"""The C of a state machine: a switch that reads like the drawing."""

import re

import pytest

from twodof.blocks import Diagram, Port, State
from twodof.blocks.library import Bias, Convert
from twodof.blocks.reference import Reference
from twodof.blocks.state_machine import Mode, StateMachine, Transition
from twodof.compile import build
from twodof.compile.builder import emit_program


class Door(StateMachine):
    """A door that locks itself."""

    inputs = (Port("push", "bool"), Port("lock", "bool"))
    outputs = (Port("open", "bool"),)
    modes = (
        Mode("closed", inner=[Mode("free"), Mode("locked")], during={"open": False}),
        Mode("ajar", during=lambda t: {"open": t.elapsed > 0}),
    )
    transitions = (
        Transition("free", "locked", lambda u: u.lock),
        Transition("free", "ajar", lambda u: u.push),
        Transition("locked", "free", lambda u: ~u.lock),
        Transition("ajar", "closed", lambda t: t.elapsed >= 5),
    )


def door() -> Diagram:
    d = Diagram("house")
    d.input("push", "bool")
    d.input("lock", "bool")
    d.add("door", Door(), push="push", lock="lock")
    d.output("open", "door.open")
    return d


def test_modes_are_cases_and_transitions_ifs() -> None:
    source = emit_program(door(), 0.01, "float64").source
    step = source[source.index("void house_advance") :]
    first, second = step.split("switch (s->door_mode) {")[1:]
    assert re.findall(r"case (\d): /\* ([\w.]+) \*/", first) == [
        ("0", "closed.free"),
        ("1", "closed.locked"),
        ("2", "ajar"),
    ]
    free = first.split("case 1")[0]
    assert re.findall(r"\bif \(([^)]*)\)|/\* (\w+ -> \w+) \*/", free) == [
        ("u->lock", ""),
        ("", "free -> locked"),
        ("u->push", ""),
        ("", "free -> ajar"),
    ]
    assert "} else if (u->push) {" in free
    assert len(re.findall(r"case \d|default", second)) == 3


class FedBack(StateMachine):
    """It passes on what others make of the mode that it gives in the same tick."""

    inputs = (Port("go", "bool"), Port("u"))
    outputs = (Port("mode", "int32"), Port("y"))
    variables = (State("sum"),)
    modes = (
        Mode("low", during=lambda u, x: {"y": u.u, "sum": x.sum + u.u}),
        Mode("high", during=lambda u, x: {"y": -u.u, "sum": x.sum - u.u}),
    )
    transitions = (Transition("low", "high", lambda u: u.go), Transition("high", "low", lambda u: ~u.go))


def test_feedback_of_the_mode_is_allowed() -> None:
    d = Diagram("round")
    d.input("go", "bool")
    d.add("machine", FedBack(), go="go", u="more")
    d.add("real", Convert("int32", "real"), u="machine.mode")
    d.add("more", Bias(3.0), u="real")
    d.output("y", "machine.y")
    rows = [{"go": k % 3 > 0} for k in range(12)]
    for program in (Reference(d, 0.01), build(d, dt=0.01)):
        machine = program.machine()
        # The mode is 0 or 1, and 3 is added.
        assert [machine.step(row)["y"] for row in rows] == [3.0 if k % 3 == 0 else -4.0 for k in range(12)]
        assert machine.state("machine.sum") == 4 * 3.0 - 8 * 4.0


class Waiting(StateMachine):
    """It starts outside the mode whose time it reads."""

    inputs = (Port("go", "bool"),)
    outputs = (Port("long", "bool"),)
    modes = (
        Mode("waiting", during={"long": False}),
        Mode("busy", inner=[Mode("one"), Mode("other")], during=lambda t: {"long": t.elapsed > 3}),
    )
    transitions = (
        Transition("waiting", "busy", lambda u: u.go),
        Transition("one", "other", lambda t: t.elapsed >= 2),
        Transition("other", "one"),
    )


@pytest.mark.parametrize("start", [-1, 77])
def test_all_clocks_are_0_at_the_start(start: int) -> None:
    """That of an outer mode too, which may be entered later; a mode that does not exist is the start as well."""
    d = Diagram("waits")
    d.input("go", "bool")
    d.add("machine", Waiting(), go="go")
    d.output("long", "machine.long")
    expected, compiled = Reference(d, 0.01).machine(), build(d, 0.01).machine()
    for stepper in (expected, compiled):
        stepper.set_state("machine.mode", start)
        stepper.set_state("machine.elapsed_outer", 9)
    clocks = []
    for k in range(12):
        assert compiled.step({"go": k == 3}) == expected.step({"go": k == 3})
        clocks.append(expected.state("machine.elapsed_outer"))
        assert compiled.state("machine.elapsed_outer") == clocks[-1]
    assert clocks == [0, 1, 2, 0, 1, 2, 3, 4, 5, 6, 7, 8]
