"""Subsystems that act at times only: enabled, triggered, called, resettable ones, and actions of If and Switch Case.

Edges are those of MathWorks' C: of a trigger by the signs before and after with the zero in between (`rt_ZCFcn`), of a
reset by the sign before (`PrevResetState`).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Port, State
from twodof.blocks.expressions.expr import int32, to_real, where
from twodof.blocks.library import CaseChoice, Constant, Convert, FirstTrue, Merge
from twodof.errors import DiagramError
from twodof.slx.matlab.function_block import MatlabFunction
from twodof.slx.matlab.parser import names_in
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import as_array
from twodof.slx.model import System, below
from twodof.slx.translation import Asked, Made, NotTranslated, Rule, Signal, plain

CONTROL_PORTS = {"EnablePort": "enable", "TriggerPort": "trigger", "ActionPort": "ifaction", "ResetPort": "reset"}
"""Block types that make their subsystem conditional, with the kind of pin that they give it."""
ITERATED = ("WhileIterator", "ForIterator")


@dataclass(frozen=True)
class Activation:
    """When a subsystem acts: the pin that says it, at which `edge` ("" while it is positive), and if it starts afresh.

    A subsystem with the pin `reset` always acts, and is initial at the edge.
    """

    pin: str
    edge: str
    restart: bool


def conditions_of(system: System) -> list[Activation]:
    """Return the conditions of a system. Raises NotTranslated for ones that have no equivalent."""
    found = []
    for block in system.blocks.values():
        if block.type not in CONTROL_PORTS or block.commented:
            continue
        if block.values.get("ShowOutputPort", "off") == "on" and block.type != "EnablePort":
            raise NotTranslated(f"ShowOutputPort of its {block.type} is not translated")
        own = {"TriggerPort": ("TriggerType", "rising"), "ResetPort": ("ResetTriggerType", "level")}
        edge = block.values.get(*own[block.type]) if block.type in own else ""
        if edge not in ("", "rising", "falling", "either", "function-call", "level", "level hold"):
            raise NotTranslated(f"TriggerType = {edge!r} is not translated")
        key = "InitializeStates" if block.type == "ActionPort" else "StatesWhenEnabling"
        restart = block.values.get(key, "held") == "reset" and block.type != "TriggerPort"
        found.append(Activation(CONTROL_PORTS[block.type], "" if edge == "function-call" else edge, restart))
    if len([one for one in found if one.pin != "reset"]) > 1:
        raise NotTranslated("a subsystem that is enabled and triggered is not translated")
    return found


def without_events(system: System, notes: list[str], path: str) -> System:
    """Return a system without the subsystems of events that never come in a step: reset, terminate, and empty ones."""
    blocks = dict(system.blocks)
    for sid, block in blocks.items():
        inside = [] if block.system is None else [*block.system.blocks.values()]
        event = next((one for one in inside if one.type == "EventListener"), None)
        if event is not None and (len(inside) == 1 or event.values.get("EventType", "Initialize") != "Initialize"):
            blocks[sid] = replace(block, values={**block.values, "Commented": "on"})
            notes.append(f"{below(path, block)} is left out: no step sends its event")
    return System(blocks, system.lines)


class ControlEdge(Block):
    """y is true where u, a signal of this kind, has an edge, or is positive (edge ""), or not 0 ("level hold").

    "rising", "falling" and "either" are edges of a trigger, from and to 0 too, but 0 in passing counts once. With
    `reset` they are those of a reset: from 0 or less to more, or back; "level" is u now or before. The first sample
    has no edge.
    """

    crossing = True

    def __init__(self, edge: str, kind: str = "real", reset: bool = False) -> None:
        self.edge, self.kind, self.reset = edge, kind, reset
        self.inputs = [Port("u", kind)]
        self.outputs = [Port("y", "bool")]
        if edge not in ("", "level hold"):
            self.states = [State("sign", 2, "int32"), State("passing", 0, "int32")]

    def _sign(self, u: Any) -> Any:
        value = u.u if self.kind == "real" else to_real(u.u)
        return where(value > 0.0, int32(1), where(value < 0.0, int32(-1), int32(0)))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Compare the sign with that of the sample before."""
        sign = self._sign(u)
        if self.edge == "":
            return sign > 0
        if self.edge == "level hold":
            return sign != 0
        if self.edge == "level":
            return (sign != 0) | (x.sign != 0)
        if self.reset:
            up, down = (sign > 0) & (x.sign <= 0), (sign <= 0) & (x.sign == 1)
        else:
            up = ((x.sign == 0) & (sign > 0) & (x.passing != 1)) | ((x.sign == -1) & (sign >= 0))
            down = ((x.sign == 0) & (sign < 0) & (x.passing != -1)) | ((x.sign == 1) & (sign <= 0))
        return up if self.edge == "rising" else down if self.edge == "falling" else up | down

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Keep the sign, and whether 0 was just reached from below (1) or above (-1)."""
        if self.edge in ("", "level hold"):
            return {}
        sign = self._sign(u)
        reached = (sign == 0) & (x.sign != 0) & (x.sign != 2)
        return {"sign": sign, "passing": where(reached, -x.sign, int32(0))}


def _if(c: Asked) -> Made:
    """Compute the expressions as a function in MATLAB's language; what they name is of the workspace."""
    if any(one.width is not None for one in c.inputs):
        raise NotTranslated("an input is a vector")
    expressions = [c.text("IfExpression", "u1 > 0"), *re.findall(r"[^,]+", c.text("ElseIfExpressions", ""))]
    ports = [f"u{k}" for k in range(1, len(c.inputs) + 1)]
    named = sorted({name for text in expressions for name in names_in(text) if name in c.names and name not in ports})
    results = [f"y{k}" for k in range(1, len(expressions) + 1)]
    code = f"function [{', '.join(results)}] = f({', '.join([*ports, *named])})\n"
    code += "\n".join(f"{name} = logical({text});" for name, text in zip(results, expressions, strict=True))
    d, conditions = Diagram("choice"), MatlabFunction(code, c.inputs, c.names, ports)
    for port in conditions.inputs:
        d.input(port.name, port.kind)
    d.add("conditions", conditions, inputs={port.name: port.name for port in conditions.inputs})
    first = FirstTrue(len(expressions))
    acts = {name: f"conditions.y{k + 1}" for k, name in enumerate(first.names)}
    return _chosen(d, first, acts, c.text("ShowElse", "on") == "on")


def _switch_case(c: Asked) -> Made:
    kind = c.inputs[0].number
    if c.inputs[0].width is not None:
        raise NotTranslated("its input is a vector")
    try:
        cases = evaluate(c.text("CaseConditions", "{1}"), c.names)
    except DiagramError as reason:
        raise NotTranslated(f"parameter CaseConditions: {reason.what}") from None
    numbers = [[int(n) for n in as_array(one).flatten()] for one in (cases if isinstance(cases, list) else [cases])]
    d = Diagram("choice")
    source = d.input("u", kind)
    if kind != "int32":
        source = d.add("whole", Convert(kind, "int32", "trunc"), u="u")
    return _chosen(d, CaseChoice(numbers), {"u": source}, c.text("ShowDefaultCase", "on") == "on")


def _chosen(d: Diagram, choice: FirstTrue | CaseChoice, inputs: Mapping[str, str], otherwise: bool) -> Made:
    d.add("choice", choice, inputs=inputs)
    shown = [*choice.names, *(["otherwise"] if otherwise else [])]
    for name in shown:
        d.output(name, f"choice.{name}")
    return Made(d, [Signal("bool")] * len(shown))


def _merge(c: Asked) -> Made:
    """Return a Merge, whose inputs that say which part acts the importer connects."""
    if any(not one.like(c.inputs[0]) for one in c.inputs) or c.text("AllowUnequalInputPortWidths", "off") == "on":
        raise NotTranslated(f"its inputs have other types: {', '.join(map(str, c.inputs))}")
    one = c.inputs[0]
    c.notes.append("where two inputs act in the same step the first one counts, in Simulink the last one carried out")
    start = c.value("InitialOutput", "[]")
    values = [plain(v, one.kind) for v in start.flatten()] or [plain(0, one.kind)]
    initial = values[0] if len(values) == 1 else values
    return Made(Merge(len(c.inputs), initial, one.kind, one.width), [one])


def _called(c: Asked) -> Made:
    if c.text("numberOfIterations", "1") not in ("1", ""):
        raise NotTranslated("numberOfIterations other than 1 is not translated")
    return Made(Constant(np.True_.item(), "bool"))


CONDITION_RULES: dict[str, Rule] = {
    "Function-Call Generator": _called,
    "If": _if,
    "Merge": _merge,
    "SwitchCase": _switch_case,
}
