"""State machines as a user writes them: an error names the mode, the line and the remedy."""

from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Any

import pytest

from twodof.blocks import Diagram, Param, Port, State, to_real
from twodof.blocks.difference import difference
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.blocks.state_machine import Mode, StateMachine, Transition
from twodof.errors import DiagramError

HERE = Path(__file__).name


class Lamp(StateMachine):
    """A lamp that a button switches on for a while."""

    inputs = (Port("button", "bool"), Port("level"))
    outputs = (Port("power"),)
    variables = (State("times", 0, "int32"),)
    modes: Any = (
        Mode("off", during={"power": 0.0}),
        Mode("on", during={"power": 1.0}, entry=lambda x: {"times": x.times + 1}),
    )
    transitions: Any = (
        Transition("off", "on", lambda u: u.button),
        Transition("on", "off", lambda t: t.elapsed_time >= 0.5),
    )


def lamp(**changes: Any) -> StateMachine:
    made: StateMachine = type("Lamp", (Lamp,), {"__module__": __name__, **changes})()
    return made


OFF, ON = Lamp.modes
TO_ON, TO_OFF = Lamp.transitions
Guard = Callable[..., Any]


def between(*guards: Guard | bool) -> dict[str, Any]:
    """The lamp with these guards from off to on, in this order."""
    return {"transitions": [*(Transition("off", "on", guard) for guard in guards), TO_OFF]}


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no modes": ({"modes": ()}, "it has no modes (write modes = [Mode(...), ...]"),
    "modes that are text": ({"modes": "off"}, "modes are 'off' (write a list of Mode(...))"),
    "two modes of one name": ({"modes": (OFF, OFF)}, "two modes are named 'off'"),
    "an inner mode of the same name": ({"modes": (OFF, Mode("on", inner=[OFF]))}, "two modes are named 'off'"),
    "three levels": (
        {"modes": (OFF, Mode("a", inner=[Mode("b", inner=[Mode("c")])]))},
        "'b' is inside 'a' and has inner modes itself (modes have two levels",
    ),
    "a history of nothing": ({"modes": (OFF, Mode("on", history=True))}, "'on' has a history (only a mode with inner"),
    "an unknown target": (
        {"transitions": (TO_ON, Transition("on", "of"))},
        "the transition 'on' -> 'of' names no mode (there are: off, on)",
    ),
    "a mode that nothing leads to": (
        {"modes": (OFF, ON, Mode("dim", during={"power": 0.5}))},
        "no transition leads to dim from off, where the machine starts (add a transition to it, or remove it)",
    ),
    "an island": (
        {
            "modes": (OFF, ON, Mode("a", during={"power": 0.5}), Mode("b", during={"power": 0.5})),
            "transitions": (TO_ON, TO_OFF, Transition("a", "b"), Transition("b", "a")),
        },
        "no transition leads to a, b from off",
    ),
    "the same guard twice": (
        between(lambda u: u.button, lambda u: u.button),
        "off -> on comes before it, and holds whenever it does (put it before, or change one of the guards)",
    ),
    "a guard behind one that always holds": (between(True, lambda u: u.button), "off -> on is never taken: off -> on"),
    "a guard that an earlier one implies": (
        between(lambda u: u.button, lambda u: (u.level > 1.0) & u.button & (u.level < 2.0)),
        "off -> on is never taken: off -> on",
    ),
    "a guard behind one that asks less": (
        between(lambda u: (u.level > 1.0) | u.button, lambda u: u.level > 1.0),
        "off -> on is never taken: off -> on",
    ),
    "a guard that is never true": (between(False), "off -> on is never taken: its guard is never true"),
    "a guard behind one of the mode around it": (
        {
            "modes": (Mode("all", inner=(OFF, ON)), Mode("broken", during={"power": 0.0})),
            "transitions": (Transition("all", "broken", lambda u: u.button), TO_ON, TO_OFF),
        },
        "off -> on is never taken: all -> broken comes before it",
    ),
    "an entry that writes what is not declared": (
        {"modes": (OFF, Mode("on", during={"power": 1.0}, entry=lambda x: {"time": x.times + 1}))},
        f"block Lamp, entry of on, {HERE}: entry of on gives 'time', which is not declared (it may give: times)",
    ),
    "an entry that writes an output": (
        {"modes": (OFF, Mode("on", during={"power": 1.0}, entry={"power": 2.0}))},
        "block Lamp, entry of on: entry of on gives 'power', which is not declared (it may give: times)",
    ),
    "an output that a mode does not give": (
        {"modes": (OFF, Mode("on"))},
        "the output 'power' is not given in on (give it in `during` there, or declare a variable of this name",
    ),
    "a guard that is a number": (
        between(lambda u: u.level),
        f"block Lamp, when of off -> on, {HERE}: the guard gives a real (return a bool: a comparison",
    ),
    "a guard that asks for another input": (
        between(lambda u: u.lever > 1.0),
        f"block Lamp, when of off -> on, {HERE}: no input named 'lever' (there are: button, level)",
    ),
    "an action of another type": (
        {"modes": (OFF, Mode("on", during={"power": 1.0}, entry=lambda x: {"times": to_real(x.times)}))},
        f"block Lamp, entry of on, {HERE}: 'times' is given a real, and is a int32",
    ),
    "an if": (
        between(lambda u: u.level > 1.0 and u.button),
        f"block Lamp, when of off -> on, {HERE}: a recorded value has no truth yet",
    ),
    "a function of something else": (
        between(lambda height: height > 1.0),
        "when of off -> on takes 'height' (let it take any of u (inputs), x (variables), p and t)",
    ),
    "a continuous variable": (
        {"variables": (State("times", 0, "int32"), State("angle", continuous=True))},
        "block Lamp.angle: a variable of a state machine is continuous (integrate in another block",
    ),
    "variables that are text": ({"variables": ("times",)}, "variables is ('times',) (write variables = [State("),
    "a variable that takes the machine's own name": (
        {"variables": (State("times", 0, "int32"), State("mode", 0, "int32"))},
        "two states are named 'mode'",
    ),
    "states": ({"states": [State("a")]}, "block Lamp: a state machine writes states itself (declare variables"),
    "a method": ({"output": lambda self, u, x, p, t: 0.0}, "block Lamp: a state machine writes output itself"),
    "an enumeration in another order": (
        {"outputs": (Port("power"), Port("mode", IntEnum("Light", {"on": 0, "off": 1})))},
        "the mode 'off' is number 0, and Light (0 on, 1 off) says otherwise (name the members as the modes",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(name: str) -> None:
    changes, text = WRONG[name]
    with pytest.raises(DiagramError) as raised:
        _ = lamp(**changes).trace
    told = str(raised.value).replace('Mode("...")', "Mode(...)")
    for folder in (f"{Path(__file__).parent}/",):
        told = told.replace(folder, "")
    head, _, tail = text.partition(f"{HERE}:")
    assert head in told
    assert tail in told


def test_a_number_kept_outside_is_found_when_it_runs() -> None:
    seen: list[int] = []

    def count(x: Any) -> Any:
        seen.append(1)
        return {"times": x.times + len(seen)}

    d = Diagram("room")
    d.input("button", "bool")
    d.input("level")
    block = lamp(modes=(OFF, Mode("on", during={"power": 1.0}, entry=count)))
    d.add("lamp", block, button="button", level="level")
    with pytest.raises(DiagramError, match="computes another 'times' when it is traced again"):
        Reference(d, 0.01)


def test_a_later_guard_that_may_still_hold_is_not_refused() -> None:
    block = lamp(**between(lambda u: u.button & (u.level > 1.0), lambda u: u.button, True))
    assert len(block.trace.update) == 3


class Light(IntEnum):
    off = 0
    on = 1


def test_the_active_mode_is_a_member_of_an_enumeration() -> None:
    d = Diagram("room")
    d.input("button", "bool")
    d.input("level")
    block = lamp(outputs=(Port("power"), Port("mode", Light)), params=(Param("p"),))
    d.add("lamp", block, button="button", level="level")
    d.output("mode", "lamp.mode")
    assert not difference(d, from_json(to_json(d)))
    for diagram in (d, from_json(to_json(d))):
        machine = Reference(diagram, 0.25).machine()
        assert [machine.step({"button": k > 1})["mode"] for k in range(6)] == [0, 0, 1, 1, 0, 1]


def test_a_clock_of_a_mode_stands_when_it_is_full() -> None:
    d = Diagram("room")
    d.input("button", "bool")
    d.input("level")
    d.add("lamp", lamp(outputs=(Port("power"), Port("elapsed", "uint32"))), button="button", level="level")
    d.output("elapsed", "lamp.elapsed")
    machine = Reference(d, 0.01).machine()
    machine.step()
    machine.set_state("lamp.elapsed", 2**32 - 2)
    assert [machine.step()["elapsed"] for _ in range(3)] == [2**32 - 1] * 3
