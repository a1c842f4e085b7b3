"""Diagrams over enumerations, and beside each a loop that says in Python what it does."""

from __future__ import annotations

import random
from collections import deque
from enum import IntEnum
from typing import Any

from tests.compile.differential import Case
from tests.compile.semantics import STEPS, Told, told
from tests.compile.semantics import TOLD as TOLD
from twodof.blocks import Block, Diagram, Enumeration, Param, Port, State, to_enumeration, where
from twodof.blocks.action_group import action_group
from twodof.blocks.library import (
    CompareToConstant,
    Constant,
    Convert,
    DataStore,
    Delay,
    MultiportSwitch,
    Mux,
    StoreRead,
    StoreWrite,
    Switch,
    UnitDelay,
)


class Mode(IntEnum):
    """Modes whose values have gaps."""

    idle = 0
    armed = 1
    flying = 5
    broken = -(2**31)


Light = Enumeration("Light", green=0, red=1)


class ModeLogic(Block):
    """Armed flies when told to go; broken stays broken until told twice."""

    inputs = (Port("asked", Mode), Port("go", "bool"))
    outputs = (Port("mode", Mode), Port("light", Light), Port("two", Mode, width=2))
    states = (State("last", Mode.idle, Mode), State("light", kind=Light))
    params = (Param("after", "armed", Mode),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        free = where(u.go & (u.asked == Mode.armed), Mode.flying, u.asked)
        mode = where((x.last == Mode.broken) & ~u.go, x.last, where(x.last == Mode.flying, p.after, free))
        light = to_enumeration(Light, mode // 2)
        return {"mode": mode, "light": where(u.go, light, Light.red), "two": [mode, x.last]}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"last": self.output(u, x, p, t)["mode"]}


def constant(name: str, mode: Mode) -> Diagram:
    """A sub-diagram whose output is a mode."""
    d = Diagram(name)
    d.add("one", Constant(mode, Mode))
    d.output("mode", "one")
    return d


@told
def enumerated() -> Told:
    """Modes computed, converted, delayed, held, stored, chosen and merged."""
    d = Diagram("enumerated")
    d.input("number", "int32")
    d.input("go", "bool")
    d.input("asked", Mode)
    d.add("convert", Convert("int32", Mode), u="number")
    d.add("logic", ModeLogic(), asked="convert", go="go")
    d.add("late", Delay(2, initial=Mode.armed, kind=Mode), u="logic.mode")
    d.add("chosen", Switch(Mode), condition="go", a="late", b="asked")
    d.add("group", action_group("group", {"a": constant("a", Mode.armed), "b": constant("b", Mode.flying)}))
    d.connect("go", "group.if_a")
    d.add("flies", CompareToConstant("==", Mode.flying, Mode), u="late")
    d.connect("flies", "group.if_b")
    held = Diagram("held")
    held.input("u", Mode)
    held.add("past", UnitDelay("idle", Mode), u="u")
    held.output("y", "past")
    d.add("held", held, u="logic.mode", enable="go", initial={"y": "broken"})
    d.add("store", DataStore(Mode.flying, Mode))
    d.add("write", StoreWrite("store", Mode), u="chosen")
    d.add("read", StoreRead("store", Mode))
    d.add("any", MultiportSwitch(3, Mode), index="number", a="read", b="held.y", c="group.mode")
    d.add("both", Mux(2, Mode), a="any", b="logic.mode")
    outputs = {"mode": "logic.mode", "light": "logic.light", "two": "logic.two", "late": "late", "chosen": "chosen"}
    for name, source in {**outputs, "held": "held.y", "group": "group.mode", "both": "both"}.items():
        d.output(name, source)
    r = random.Random(7)
    inputs: list[dict[str, Any]] = []
    expected: list[dict[str, Any]] = []
    last, shown, past, merged = 0, int(Mode.broken), 0, 0
    stored, late = int(Mode.flying), deque([1, 1])
    for _ in range(STEPS):
        number, go, asked = r.choice((0, 1, 2, 5, 5, -(2**31), 7)), r.random() < 0.6, int(r.choice(list(Mode)))
        inputs.append({"number": number, "go": go, "asked": asked})
        converted = number if number in list(Mode) else 0
        free = 5 if go and converted == 1 else converted
        mode = last if last == Mode.broken and not go else (1 if last == 5 else free)
        light = (1 if int(mode / 2) == 1 else 0) if go else 1
        delayed = late[0]
        chosen = delayed if go else asked
        merged = 1 if go else 5 if delayed == 5 else merged
        shown, past = (past, mode) if go else (shown, past)
        any_ = (stored, shown, merged)[min(max(number, 0), 2)]
        expected.append(
            {"mode": mode, "light": light, "two": [mode, last], "late": delayed, "chosen": chosen, "held": shown}
            | {"group": merged, "both": [any_, mode]}
        )
        late.popleft()
        late.append(mode)
        last, stored = mode, chosen
    return Told(Case(d, [], inputs, {}), expected)
