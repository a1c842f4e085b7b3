"""The C of a state machine: a switch that reads like the drawing."""

from __future__ import annotations

import re

import pytest

from twodof.blocks import Diagram, Port, State
from twodof.blocks.library import Bias, Convert, Logic, UnitDelay, ZeroOrderHold
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


class TakenBack(StateMachine):
    """A machine whose transition overwrites the result of its exit action, so that the input is not needed."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    variables = (State("y"),)
    modes = (Mode("one", exit=lambda u: {"y": u.u}), Mode("other"))
    transitions = (Transition("one", "other", True, do={"y": 3.0}),)


@pytest.mark.parametrize("others", [True, False])
def test_inputs_of_overwritten_actions_are_not_needed(others: bool) -> None:
    d = Diagram("late")
    d.input("u")
    d.add("machine", TakenBack())
    d.add("zero", Bias(1.0), u="u")
    d.connect("zero", "machine.u")
    d.output("y", "machine.y")
    if others:
        d.output("z", "zero.y")
    expected, compiled = Reference(d, 0.01).machine(), build(d, 0.01).machine()
    for _ in range(3):
        assert compiled.step({"u": 5.0}) == expected.step({"u": 5.0})


def test_a_slow_machine_reads_what_a_fast_block_reads_too() -> None:
    """The base tick has computed the held input's value already, and no output of the machine is read."""
    inner = Diagram("inner")
    inner.input("on", "bool")
    inner.add("later", UnitDelay(kind="bool"), u="on")
    inner.output("on", "later")
    d = Diagram("slow")
    d.input("push", "bool")
    d.add("fast", Logic("not"), a="push")
    d.add("idle", inner, reset="push", on="fast")
    d.add("held", ZeroOrderHold("bool"), rate=(2, 1), u="push")
    d.add("door", Door(), rate=(2, 1), push="held", lock="held")
    d.output("idle", "idle.on")
    expected, compiled = Reference(d, 0.01).machine(), build(d, 0.01).machine()
    for k in range(6):
        row = {"push": k == 3}
        assert compiled.step(row) == expected.step(row)
    assert compiled.state("door.mode") == expected.state("door.mode") == 0
    assert compiled.state("door.elapsed") == expected.state("door.elapsed")


class Deaf(Door):
    """A door with an input that nothing reads."""

    inputs = (*Door.inputs, Port("unread"))


def test_an_unread_input_does_not_wake_its_source() -> None:
    inner = Diagram("inner")
    inner.input("u")
    inner.add("double", Bias(1.0), u="u")
    inner.output("y", "double")
    d = Diagram("house")
    for name, kind in (("u", "real"), ("on", "bool")):
        d.input(name, kind)
    d.add("asleep", inner, enable="on", u="u")
    d.add("door", Deaf(), push="on", lock="on", unread="asleep.y")
    d.output("open", "door.open")
    d.output("y", "asleep.y")
    expected, compiled = Reference(d, 0.01).machine(), build(d, 0.01).machine()
    for k in range(4):
        row = {"u": float(k), "on": k == 1}
        assert compiled.step(row) == expected.step(row)
