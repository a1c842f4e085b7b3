"""C structs of a program: P parameters, S states, U inputs, Y outputs, and the member of each path."""

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
    """A struct's member: its C name and type, the parts of its comment, and the path of its block."""

    name: str
    kind: str
    width: int | None
    path: str = ""
    unit: str = ""
    remark: str = ""
    block: str = ""

    def declaration(self, types: Mapping[str, str] = C_TYPES) -> str:
        """Return the member's line in the struct."""
        size = "" if self.width is None else f"[{self.width}]"
        return f"{types[self.kind]} {self.name}{size};"


@dataclass
class Struct:
    """Members of a C struct, with unique names."""

    members: list[Member] = field(default_factory=list)
    names: CNames = field(default_factory=CNames)

    def add(self, wanted: Member) -> Member:
        """Add a member, whose name becomes unique within the struct, and return it."""
        self.members.append(replace(wanted, name=self.names.new(wanted.name)))
        return self.members[-1]


class MemoryLayout:
    """Members that hold the parameters, states, held signals, inputs and outputs of a program."""

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
        own = {q: n.path for n in program.nodes for q in n.parameters.values() if q.path.startswith(f"{n.path}.")}
        for path, q in program.parameters.items():
            made = _member(path, q.declared, q.declared.text, own.get(q, ""))
            self.parameters[q] = self.p.add(replace(made, path=q.path))
        for node in program.nodes:
            for o in node.block.derived:
                self.derived[node, o.name] = self.p.add(_member(f"{node.path}.{o.name}", o, "derived", node.path))
            for state in node.block.states:
                struct = self.x if state.continuous else self.s
                made = _member(f"{node.path}.{state.name}", state, block=node.path)
                self.states[node, state.name] = struct.add(made)
        self.passing = _passing(program)
        for group in program.tick:
            for action in group.actions:
                for signal in action.signals:
                    if signal in self.passing:
                        continue
                    wide = signal.width is not None and signal.width > WIDEST_LOCAL
                    if not group.guard.always or wide:
                        remark = "work" if group.guard.always else "held"
                        s, path = signal, signal.path
                        made = Member(path, s.kind, s.width, path, s.unit, remark, action.node.path)
                        self.stored[signal] = self.s.add(made)
        for name, signal in program.inputs.items():
            self.inputs[signal] = self.u.add(_member(name, signal))
        for path, signal in program.outputs.items():
            self.outputs[path] = self.y.add(_member(path, signal))

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


def _member(name: str, declared: Port | State | Param | FlatSignal, remark: str = "", block: str = "") -> Member:
    """Return the member of a declaration; its remark has the enumeration, the bounds and the order of a matrix too."""
    about = " ".join(filter(None, (remark, "" if declared.enum is None else str(declared.enum))))
    bounds = _bounds(declared) if isinstance(declared, Param) else ""
    order = "" if declared.shape is None else "{} x {}, column after column".format(*declared.shape)
    text = "; ".join(filter(None, (about, bounds, order)))
    return Member(name, declared.kind, declared.width, name, declared.unit, text, block)


def _bounds(declared: Param) -> str:
    bounds = {"at least": declared.low, "at most": declared.high}
    words = [f"{word} {value:g}" for word, value in bounds.items() if abs(value) != float("inf")]
    value = declared.value if declared.width is None else None
    if isinstance(value, bool):
        words = [f"default {'true' if value else 'false'}"]
    elif value is not None:
        words = [f"default {float(value):g}", *words]
    return ", ".join(words)
