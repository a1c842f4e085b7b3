"""The C structs of a program: P parameters, S states, U inputs, Y outputs, and where each path stands in them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.kinds import dtype_of
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import C_TYPES
from twodof.compile.program.block_kinds import BlockKind
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, FlatSignal, Node
from twodof.compile.program.holding import passing

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
        """The member's line in the struct."""
        size = "" if self.width is None else f"[{self.width}]"
        return f"{types[self.kind]} {self.name}{size};"


@dataclass
class Struct:
    """Members with names of their own."""

    members: list[Member] = field(default_factory=list)
    names: CNames = field(default_factory=CNames)

    def add(self, wanted: Member) -> Member:
        """A new member; its name becomes unique within the struct."""
        self.members.append(replace(wanted, name=self.names.new(wanted.name)))
        return self.members[-1]


@dataclass
class BlockKindLayout:
    """The structs of one copy of a kind, and the name of the arrays in P and S that hold them.

    `prefix` begins the names in C of its types and functions.
    """

    kind: BlockKind
    name: str
    prefix: str
    p: Struct = field(default_factory=Struct)
    s: Struct = field(default_factory=Struct)
    members: dict[str, Member] = field(default_factory=dict)  # by the block's own name of a parameter or state

    def structs(self) -> Iterable[tuple[str, Struct]]:
        """Those that have members, by the struct of the program in which they stand."""
        return [(which, struct) for which, struct in (("P", self.p), ("S", self.s)) if struct.members]


class MemoryLayout:
    """Which members hold the parameters, states, held signals, inputs and outputs of a program.

    The copies of `kinds` stand in arrays of structs behind the other members: theirs are called `array[copy].member`.
    """

    def __init__(self, program: FlatProgram, kinds: Iterable[BlockKind] = ()) -> None:
        self.p, self.s, self.x, self.u, self.y = Struct(), Struct(), Struct(), Struct(), Struct()
        self.parameters: dict[FlatParameter, Member] = {}
        self.derived: dict[tuple[Node, str], Member] = {}
        self.states: dict[tuple[Node, str], Member] = {}
        self.stored: dict[FlatSignal, Member] = {}
        self.inputs: dict[FlatSignal, Member] = {}
        self.outputs: dict[str, Member] = {}
        self.s.names.taken.add("x")
        self.tick = self.s.add(Member("tick", "uint32", None, remark="base ticks since the start"))
        kinds = list(kinds)
        copied = {n for kind in kinds for n in kind.nodes}
        inside = {n.parameters[name] for kind in kinds for n in kind.nodes for name in kind.own}
        for path, q in program.parameters.items():
            if q not in inside:
                self.parameters[q] = self.p.add(_parameter(path, q))
        for node in program.nodes:
            if node in copied:
                continue
            for o in node.block.derived:
                path = f"{node.path}.{o.name}"
                self.derived[node, o.name] = self.p.add(_derived(path, o))
            for state in node.block.states:
                path = f"{node.path}.{state.name}"
                struct = self.x if state.continuous else self.s
                self.states[node, state.name] = struct.add(_member(path, state, _about(state)))
        self.passing = passing(program)
        for group in program.tick:
            for action in group.actions:
                for signal in action.signals:
                    if signal in self.passing:
                        continue
                    wide = signal.width is not None and signal.width > WIDEST_LOCAL
                    if (not group.guard.always and not group.needs) or wide:
                        remark = "work" if group.guard.always else "held"
                        self.stored[signal] = self.s.add(_member(signal.path, signal, remark))
        for name, signal in program.inputs.items():
            self.inputs[signal] = self.u.add(_member(name, signal, _about(signal)))
        for path, signal in program.outputs.items():
            self.outputs[path] = self.y.add(_member(path, signal, _about(signal)))

        self.block_kinds = [self._kind(kind, program.name) for kind in kinds]
        self.of = {n: (k, i) for k in self.block_kinds for i, n in enumerate(k.kind.nodes)}

    def _kind(self, kind: BlockKind, program: str) -> BlockKindLayout:
        """The structs of a kind's copies, and the members that stand for each copy's parameters and states."""
        name = CNames(self.p.names.taken | self.s.names.taken | {"x"}).new(kind.name)
        self.p.names.taken.add(name)
        self.s.names.taken.add(name)
        made = BlockKindLayout(kind, name, f"{program}_{name}")
        first = kind.first
        for own in kind.own:
            made.members[own] = made.p.add(replace(_parameter(own, first.parameters[own]), path="", remark=""))
        for o in first.block.derived:
            made.members[o.name] = made.p.add(replace(_derived(o.name, o), path=""))
        for state in first.block.states:
            made.members[state.name] = made.s.add(replace(_member(state.name, state, _about(state)), path=""))
        for i, node in enumerate(kind.nodes):
            at = {own: f"{name}[{i}].{m.name}" for own, m in made.members.items()}
            for own in kind.own:
                q = node.parameters[own]
                self.parameters[q] = replace(_parameter(q.path, q), name=at[own])
            for o in node.block.derived:
                self.derived[node, o.name] = replace(_derived(f"{node.path}.{o.name}", o), name=at[o.name])
            for state in node.block.states:
                path = f"{node.path}.{state.name}"
                member = _member(path, state, _about(state))
                self.states[node, state.name] = replace(member, name=at[state.name])
        return made

    def members(self, struct: str) -> list[Member]:
        """All members of P or S, except those of X."""
        own = (self.p if struct == "P" else self.s).members
        copies: list[Member] = []
        for k in self.block_kinds:
            for node in k.kind.nodes:
                if struct == "P":
                    copies += [self.parameters[node.parameters[name]] for name in k.kind.own]
                    copies += [self.derived[node, o.name] for o in node.block.derived]
                else:
                    copies += [self.states[node, state.name] for state in node.block.states]
        return [*own, *copies]

    def dtypes(self, precision: str) -> dict[str, np.dtype[Any]]:
        """The numpy types of P, S, U and Y: their memory is that of the C structs."""
        word = np.dtype(precision).itemsize

        def laid(struct: Struct) -> list[_Place]:
            return [_place(m, precision) for m in struct.members]

        x = _struct_dtype(laid(self.x))
        made = {}
        for name, struct in (("P", self.p), ("S", self.s), ("U", self.u), ("Y", self.y)):
            places: list[_Place | _Copies] = [*laid(struct)]
            for k in self.block_kinds:
                places += [
                    _Copies(k.name, laid(inner), len(k.kind.nodes)) for which, inner in k.structs() if which == name
                ]
            if name == "S" and self.x.members:
                places.append(_Place("x", x, word))
            made[name] = _struct_dtype(places)
        return made


def _about(declared: Port | State | Param | FlatSignal, remark: str = "") -> str:
    """What a member's comment says: a remark, and what the values of an enumeration mean."""
    return " ".join(filter(None, (remark, "" if declared.enum is None else str(declared.enum))))


def _member(path: str, signal: FlatSignal | State, remark: str = "") -> Member:
    return Member(path, signal.kind, signal.width, path, signal.unit, remark)


def _parameter(name: str, q: FlatParameter) -> Member:
    d = q.declared
    return Member(name, d.kind, d.width, q.path, d.unit, _about(d, d.text))


def _derived(path: str, o: Port) -> Member:
    return Member(path, o.kind, o.width, path, o.unit, _about(o, "derived"))


class _Place(NamedTuple):
    """A member's name in numpy, its type and its alignment [bytes]."""

    name: str
    dtype: np.dtype[Any]
    align: int


class _Copies(NamedTuple):
    """An array of structs."""

    name: str
    places: Sequence[_Place]
    number: int


def _place(m: Member, precision: str) -> _Place:
    """Where a member stands in numpy."""
    base = dtype_of(m.kind, precision)
    return _Place(m.name, np.dtype((base, () if m.width is None else (m.width,))), base.itemsize)


def _struct_dtype(places: Sequence[_Place | _Copies]) -> np.dtype[Any]:
    """The numpy type of a C struct with these members. An empty one holds a byte."""
    if not places:
        return np.dtype({"names": ["none"], "formats": ["u1"]})
    flat, offsets, end, largest = [], [], 0, 1
    for place in places:
        if isinstance(place, _Place):
            inner, starts, size, align = [place], [0], place.dtype.itemsize, place.align
        else:
            inner, starts, size, align = _array(place)
        begin = -(-end // align) * align
        flat += inner
        offsets += [begin + at for at in starts]
        end, largest = begin + size, max(largest, align)
    names, formats = [place.name for place in flat], [place.dtype for place in flat]
    size = -(-end // largest) * largest
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _array(copies: _Copies) -> tuple[list[_Place], list[int], int, int]:
    """The members of an array of structs, each with its offset, and the array's size and alignment [bytes]."""
    one = _struct_dtype(copies.places)
    fields: Mapping[str, Any] = one.fields or {}
    inner = [
        _Place(f"{copies.name}[{i}].{p.name}", p.dtype, p.align) for i in range(copies.number) for p in copies.places
    ]
    starts = [i * one.itemsize + fields[p.name][1] for i in range(copies.number) for p in copies.places]
    return inner, starts, copies.number * one.itemsize, max(p.align for p in copies.places)
