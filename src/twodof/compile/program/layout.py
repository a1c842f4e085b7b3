"""The C structs of a program: P parameters, S states, U inputs, Y outputs, and where each path stands in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.numbers import dtype_of
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.statements import CNames
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, FlatSignal, Node

WIDEST_LOCAL = 256  # a wider array that is computed at a tick stands in S, not on the stack


@dataclass(frozen=True)
class Member:
    """A struct's member: C name, type, and the path, unit and remark that its comment shows."""

    name: str
    kind: str
    width: int | None
    path: str = ""
    unit: str = ""
    remark: str = ""

    def declaration(self, types: Mapping[str, str] = C_TYPES) -> str:
        """Return the member's line in the struct."""
        size = "" if self.width is None else f"[{self.width}]"
        return f"{types[self.kind]} {self.name}{size};"


@dataclass
class Struct:
    """Members with names of their own."""

    members: list[Member] = field(default_factory=list)
    names: CNames = field(default_factory=CNames)

    def add(self, wanted: Member) -> Member:
        """Add a member, whose name becomes unique within the struct, and return it."""
        self.members.append(replace(wanted, name=self.names.new(wanted.name)))
        return self.members[-1]


class MemoryLayout:
    """The members that hold the parameters, states, held signals, inputs and outputs of a program."""

    def __init__(self, program: FlatProgram) -> None:
        self.p, self.s, self.x, self.u, self.y = Struct(), Struct(), Struct(), Struct(), Struct()
        self.parameters: dict[FlatParameter, Member] = {}
        self.derived: dict[tuple[Node, str], Member] = {}
        self.states: dict[tuple[Node, str], Member] = {}
        self.stored: dict[FlatSignal, Member] = {}
        self.inputs: dict[FlatSignal, Member] = {}
        self.outputs: dict[str, Member] = {}
        self.s.names.taken.add("x")
        self.tick = self.s.add(Member("tick", "uint32", None, remark="base ticks since the start"))
        for path, q in program.parameters.items():
            self.parameters[q] = self.p.add(_parameter(path, q))
        for node in program.nodes:
            for o in node.block.derived:
                path = f"{node.path}.{o.name}"
                self.derived[node, o.name] = self.p.add(_derived(path, o))
            for state in node.block.states:
                path = f"{node.path}.{state.name}"
                struct = self.x if state.continuous else self.s
                self.states[node, state.name] = struct.add(_member(path, state, _about(state)))
        self.passing = _passing(program)
        for group in program.tick:
            for action in group.actions:
                for signal in action.signals:
                    if signal in self.passing:
                        continue
                    wide = signal.width is not None and signal.width > WIDEST_LOCAL
                    if not group.guard.always or wide:
                        remark = "work" if group.guard.always else "held"
                        self.stored[signal] = self.s.add(_member(signal.path, signal, remark))
        for name, signal in program.inputs.items():
            self.inputs[signal] = self.u.add(_member(name, signal, _about(signal)))
        for path, signal in program.outputs.items():
            self.outputs[path] = self.y.add(_member(path, signal, _about(signal)))

    def dtypes(self, precision: str) -> dict[str, np.dtype[Any]]:
        """Return the numpy types of P, S, U and Y, which have the memory layout of the C structs."""
        x = [("x", _struct(self.x, precision))] if self.x.members else []
        structs = {"P": self.p, "S": self.s, "U": self.u, "Y": self.y}
        return {name: _struct(struct, precision, x if name == "S" else []) for name, struct in structs.items()}


def _struct(struct: Struct, precision: str, more: Sequence[tuple[str, np.dtype[Any]]] = ()) -> np.dtype[Any]:
    """Return the numpy type of a C struct. An empty one holds a byte."""
    fields: list[Any] = [(m.name, dtype_of(m.kind, precision), m.width or ()) for m in struct.members]
    return np.dtype([*fields, *more] or [("none", "u1")], align=True)


def _passing(program: FlatProgram) -> set[FlatSignal]:
    """Return the numbers that are read only at the ticks at which they are computed: they need not be held."""
    readers: dict[FlatSignal, list[Node]] = {}
    seen = {*program.outputs.values(), *program.moving}
    inside = {action.node for group in program.stage for action in group.actions}
    for node in program.nodes:
        for s in node.drivers.values():
            readers.setdefault(s, []).append(node)
        for condition in node.conditions:
            seen.update(condition.signals)
    found = set()
    for group in program.tick:
        if group.guard.always:
            continue
        for s in (s for action in group.actions for s in action.signals):
            alike = all(n.guard == group.guard and not n.continuous and n not in inside for n in readers.get(s, ()))
            if alike and s not in seen and s.width is None and s.initial is None and s.disabled is None:
                found.add(s)
    return found


def _about(declared: Port | State | Param | FlatSignal, remark: str = "") -> str:
    """Return the text of a member's comment: a remark, and the values of an enumeration."""
    return " ".join(filter(None, (remark, "" if declared.enum is None else str(declared.enum))))


def _member(path: str, signal: FlatSignal | State, remark: str = "") -> Member:
    return Member(path, signal.kind, signal.width, path, signal.unit, remark)


def _parameter(name: str, q: FlatParameter) -> Member:
    d = q.declared
    return Member(name, d.kind, d.width, q.path, d.unit, _about(d, d.text))


def _derived(path: str, o: Port) -> Member:
    return Member(path, o.kind, o.width, path, o.unit, _about(o, "derived"))
