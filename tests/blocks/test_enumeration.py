"""Enumerations: members, connections, names in and out, and refusals."""

import copy
import json
import pickle
from collections.abc import Callable
from enum import IntEnum
from typing import Any

import pytest

from tests.compile.typed_signals import Light, Mode, ModeLogic, enumerated
from twodof.blocks import Block, Diagram, Enumeration, Param, Port, State, int32, state_machine, to_enumeration, where
from twodof.blocks.library import Compare, CompareToConstant, Constant, Convert, Gain, UnitDelay
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build
from twodof.compile.program.check import check
from twodof.errors import DiagramError, ParameterError


def test_an_enumeration_of_ours_and_one_of_python_are_the_same() -> None:
    ours = Enumeration("Mode", {m.name: int(m) for m in Mode})
    assert Port("m", Mode) == Port("m", ours) == Port("m", enum=ours)
    assert ours.flying.value == Mode.flying
    assert ours["idle"] == int32(0)
    assert copy.deepcopy(ours) == pickle.loads(pickle.dumps(ours)) == ours != Light
    assert hash(copy.copy(ours)) == hash(ours)


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "no zero": (lambda: Enumeration("E", a=1), "no member is 0 (add one, such as none=0, for signals that were not"),
    "auto() begins at 1": (lambda: Port("p", IntEnum("E", ["a", "b"])), "no member is 0"),
    "two of one value": (lambda: Enumeration("E", a=0, b=2, c=2), "b and c are both 2"),
    "beyond int32": (lambda: Enumeration("E", a=0, b=2**31), "b = 2147483648 is not an int32 (write a whole number"),
    "a bool": (lambda: Enumeration("E", a=False), "a = False"),
    "a bad member": (lambda: Enumeration("E", {"a b": 0}), "'a b' is not a name"),
    "a bad name": (lambda: Enumeration("1", a=0), "'1' is not a name"),
    "no members": (lambda: Enumeration("E"), "0 members"),
    "changed": (lambda: setattr(Light, "green", 3), "enumeration Light: 'green' is assigned"),
    "an unknown member": (lambda: Light.gren, "Light has no member 'gren' (there are: green, red)"),
    "an unknown default": (lambda: Param("p", "gren", Light), "p: Light has no member 'gren' (there are: green, red)"),
    "a default of no member": (lambda: Param("p", 3, Light), "3 is not a member of Light (there are: 0 green, 1 red)"),
    "another type": (lambda: Port("p", "bool", enum=Light), "an enumeration cannot be 'bool'"),
    "not an enumeration": (lambda: Port("p", enum="Light"), "'Light' is not an enumeration"),
    "an order of modes": (lambda: Compare("<", Mode), "operation on an enumeration='<' is unknown (use one of ==, !=)"),
    "a gain": (lambda: to_enumeration("int32", 3), "'int32' is not an enumeration"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_an_enumeration_is_refused(name: str) -> None:
    make, text = REFUSED[name]
    with pytest.raises(DiagramError) as refused:
        make()
    assert text in str(refused.value)


class Given(Block):
    """Gives what the test says to an output that is a Light."""

    inputs = (Port("light", Light), Port("number", "int32"), Port("other", Mode), Port("three", Light, width=3))
    outputs = (Port("y", Light),)

    def __init__(self, gives: Callable[[Any], Any]) -> None:
        self.gives = gives

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.gives(u)


@pytest.mark.parametrize(
    "gives",
    [
        lambda u: u.number,
        lambda u: u.light + 1,
        lambda u: where(u.number == 0, u.light, u.number),
        lambda u: u.other,
        lambda u: int32(2),
    ],
)
def test_an_output_is_given_members_only(gives: Callable[[Any], Any]) -> None:
    with pytest.raises(DiagramError) as refused:
        _ = Given(gives).trace
    assert "Given.output" in str(refused.value)
    assert "test_enumeration.py" in str(refused.value)
    assert str(refused.value).endswith(
        "'y' is a Light, and is given an int32 that may be none of its members "
        "(give Light.green, ..., or to_enumeration(Light, value))"
    )


@pytest.mark.parametrize(
    "gives",
    [
        lambda u: Light.red,
        lambda u: where(u.number == 0, u.light, Light.green),
        lambda u: u.three[u.number],
        lambda u: to_enumeration(Light, u.number + u.other),
    ],
)
def test_what_is_a_member_in_any_case_is_taken(gives: Callable[[Any], Any]) -> None:
    assert Given(gives).trace.outputs["y"].kind == "int32"


def connected(source: Block, reader: Block) -> Diagram:
    d = Diagram("d")
    d.add("source", source)
    d.add("reader", reader, u="source")
    d.output("y", "reader")
    return d


CLASHES = {
    "two enumerations": (
        Constant("armed", Mode),
        UnitDelay(kind=Light),
        "it takes Light (0 green, 1 red) and source.y is Mode (0 idle, 1 armed, 5 flying, -2147483648 broken) (use",
    ),
    "two of one name": (
        Constant("red", Light),
        UnitDelay(kind=Enumeration("Light", green=0, red=2)),
        "it takes Light (0 green, 2 red) and source.y is Light (0 green, 1 red)",
    ),
    "a number": (
        Constant(1, "int32"),
        UnitDelay(kind=Light),
        'it takes Light and source.y is int32 (put Convert("int32", Light) between them)',
    ),
    "a real": (Constant(1.0), UnitDelay(kind=Light), "it takes Light and source.y is real"),
    "as a real": (Constant("red", Light), Gain(), "it takes real and source.y is Light (convert the signal"),
}


@pytest.mark.parametrize("name", CLASHES)
def test_what_does_not_fit_is_an_error_that_names_both(name: str) -> None:
    source, reader, text = CLASHES[name]
    d = connected(source, reader)
    for make in (build, Reference):
        with pytest.raises(DiagramError) as refused:
            make(d, 0.1)
        assert f"reader.u: {text}" in str(refused.value)
    assert text in str(check(d, 0.1).problems[0])


def test_a_member_is_an_int32_to_arithmetic() -> None:
    d = connected(Constant("flying", Mode), Convert("int32", "real"))
    assert Reference(d, 0.1).machine().step() == build(d, 0.1).machine().step() == {"y": 5.0}


def test_names_go_into_a_running_program_and_nothing_else_does() -> None:
    d = enumerated().case.diagram
    for machine in (Reference(d, 0.1).machine(), build(d, 0.1).machine()):
        machine.set("logic.after", "flying")
        machine.set_state("logic.last", "flying")
        assert machine.get("logic.after") == Mode.flying
        assert machine.step({"asked": "broken", "go": True})["mode"] == Mode.flying
        refused: tuple[tuple[Callable[..., Any], tuple[Any, ...], str], ...] = (
            (machine.set, ("logic.after", 2), "logic.after: 2 is not a member of Mode (there are: 0 idle"),
            (machine.set, ("logic.after", "fly"), "Mode has no member 'fly' (there are: flying"),
            (machine.step, ({"asked": 3},), "asked: 3 is not a member of Mode"),
            (machine.run, (2, {"asked": [0, 4]}), "asked: 4 is not a member of Mode"),
            (machine.set_state, ("logic.last", True), "logic.last: True is not a member of Mode"),
        )
        for call, arguments, text in refused:
            with pytest.raises((DiagramError, ParameterError)) as found:
                call(*arguments)
            assert text in str(found.value)


def test_the_c_reads_like_the_drawing() -> None:
    source = build(enumerated().case.diagram, 0.1).source
    members = "enumerated_Mode_idle = 0, enumerated_Mode_armed = 1, enumerated_Mode_flying = 5"
    assert f"enum {{ {members}, enumerated_Mode_broken = (-2147483647 - 1) }};" in source
    assert "int32_t asked; /* Mode (0 idle, 1 armed, 5 flying, -2147483648 broken) */" in source
    assert (
        "/* logic: ModeLogic; Mode (0 idle, 1 armed, 5 flying, -2147483648 broken); Light (0 green, 1 red) */" in source
    )


def test_a_file_keeps_the_names_and_a_wrong_one_is_refused() -> None:
    d = Diagram("d")
    d.add("logic", ModeLogic(), asked="asked", go="go")
    d.input("asked", Mode)
    d.input("go", "bool")
    d.param("start", "armed", kind=Mode)
    d.output("mode", "logic.mode")
    again = from_json(to_json(d))
    assert again.inputs["asked"].enum == d.inputs["asked"].enum
    assert again.params["start"] == d.params["start"]
    for members, text in (
        ({"idle": 1}, "no member is 0"),
        ({f"m{i}": i for i in range(1001)}, "1001 members"),
        ({"idle": 0.0}, "idle = 0.0"),
        ([0], "the members are [0]"),
    ):
        form = json.loads(to_json(d))
        form["diagram"]["inputs"][0]["enum"]["members"] = members
        changed = json.dumps(form)
        with pytest.raises(DiagramError) as refused:
            from_json(changed)
        assert text in str(refused.value)


def test_a_state_that_starts_from_a_parameter_has_its_enumeration() -> None:
    class Wrong(Block):
        states = (State("s", "p", Mode),)
        params = (Param("p", "red", Light),)

    with pytest.raises(DiagramError, match="starts from 'p', which is not a parameter of this type"):
        _ = Wrong().trace


def test_a_constant_to_compare_with_is_a_parameter_by_name() -> None:
    d = connected(Constant("armed", Mode), CompareToConstant("!=", "armed", Mode))
    machine = build(from_json(to_json(d)), 0.1).machine()
    assert machine.step() == {"y": False}
    machine.set("source.value", "broken")
    assert machine.step() == {"y": True}


OURS = Enumeration("Speed", slow=0, quick=1)
COMPARED: dict[str, tuple[Callable[[Any], Any], str]] = {
    "a member of Python's": (lambda u: u.light == Mode.armed, "a Light is compared with a Mode"),
    "a member of ours": (lambda u: OURS.quick != u.other, "a Mode is compared with a Speed"),
    "two inputs": (lambda u: u.light == u.other, "a Light is compared with a Mode"),
    "a choice": (lambda u: where(u.number > 0, u.light, Light.red) == Mode.armed, "a Light is compared with a Mode"),
    "an element": (lambda u: u.three[u.number] == OURS.slow, "a Light is compared with a Speed"),
    "an order": (lambda u: u.light < OURS.quick, "a Light is compared with a Speed"),
}


@pytest.mark.parametrize("name", COMPARED)
def test_members_of_two_enumerations_are_not_compared(name: str) -> None:
    compares, text = COMPARED[name]
    with pytest.raises(DiagramError) as refused:
        _ = Given(lambda u: where(compares(u), Light.red, Light.green)).trace
    assert str(refused.value).startswith(f"block Given.output, {__file__}:{compares.__code__.co_firstlineno}: {text} (")
    assert "compare it with a member of" in str(refused.value)


@pytest.mark.parametrize(
    "compares",
    [
        lambda u: u.light == Light.red,
        lambda u: u.number == Mode.armed,
        lambda u: u.light == int(Mode.armed),
        lambda u: u.light == OURS.quick.value,
        lambda u: u.light == u.number,
        lambda u: Light.red == u.three[1],
        lambda u: (u.light == Light.red) == (u.other == Mode.idle),
        lambda u: where(u.other == Mode.idle, u.light, Light.red) == Light.red,
    ],
)
def test_members_are_compared_with_their_own_and_with_numbers(compares: Callable[[Any], Any]) -> None:
    assert Given(lambda u: where(compares(u), Light.red, Light.green)).trace


def test_a_guard_does_not_compare_members_of_two_enumerations() -> None:
    class Watch(state_machine.StateMachine):
        inputs = (Port("light", Light),)
        outputs = (Port("mode", "int32"),)
        modes: Any = (state_machine.Mode("a"), state_machine.Mode("b"))
        transitions: Any = (state_machine.Transition("a", "b", lambda u: u.light == Mode.armed),)

    with pytest.raises(DiagramError, match="a Light is compared with a Mode"):
        _ = Watch().trace
