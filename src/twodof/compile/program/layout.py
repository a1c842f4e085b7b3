"""The C structs of a program: P parameters, S states, U inputs, Y outputs, and where each path stands in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.kinds import BY_NAME, dtype_of
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import C_TYPES
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, FlatSignal, Node
from twodof.compile.program.holding import passing

WIDEST_LOCAL = 256  # a wider array that is computed at a tick stands in S, not on the stack


@dataclass(frozen=True)
class LaneShape:
    """How many lanes a struct holds: `vectors` vectors of `size` bytes (16, 32 or 64) of reals."""

    precision: str
    size: int
    vectors: int

    @property
    def each(self) -> int:
        """Lanes in a vector."""
        return self.size // (4 if self.precision == "float32" else 8)

    @property
    def lanes(self) -> int:
        """Lanes in a struct."""
        return self.each * self.vectors

    @property
    def bits(self) -> bool:
        """Whether a mask is one bit a lane, the lowest first, and no vector."""
        return self.size == 64


@dataclass(frozen=True)
class Member:
    """A struct's member: C name, type, and the path, unit and remark that its comment shows."""

    name: str
    kind: str
    width: int | None
    path: str = ""
    unit: str = ""
    remark: str = ""
    shared: bool = False  # one for all lanes

    def declaration(self, types: Mapping[str, str] = C_TYPES) -> str:
        """The member's line in the struct."""
        size = "" if self.width is None else f"[{self.width}]"
        return f"{(C_TYPES if self.shared else types)[self.kind]} {self.name}{size};"


@dataclass
class Struct:
    """Members with names of their own."""

    members: list[Member] = field(default_factory=list)
    names: CNames = field(default_factory=CNames)

    def add(self, wanted: Member) -> Member:
        """A new member; its name becomes unique within the struct."""
        self.members.append(replace(wanted, name=self.names.new(wanted.name)))
        return self.members[-1]


class MemoryLayout:
    """Which members hold the parameters, states, held signals, inputs and outputs of a program."""

    def __init__(self, program: FlatProgram) -> None:
        self.p, self.s, self.x, self.u, self.y = Struct(), Struct(), Struct(), Struct(), Struct()
        self.parameters: dict[FlatParameter, Member] = {}
        self.derived: dict[tuple[Node, str], Member] = {}
        self.states: dict[tuple[Node, str], Member] = {}
        self.stored: dict[FlatSignal, Member] = {}
        self.inputs: dict[FlatSignal, Member] = {}
        self.outputs: dict[str, Member] = {}
        self.s.names.taken.add("x")
        self.tick = self.s.add(Member("tick", "uint32", None, remark="base ticks since the start", shared=True))
        for path, q in program.parameters.items():
            d = q.declared
            self.parameters[q] = self.p.add(Member(path, d.kind, d.width, path, d.unit, _about(d, d.text)))
        for node in program.nodes:
            for o in node.block.derived:
                path = f"{node.path}.{o.name}"
                self.derived[node, o.name] = self.p.add(
                    Member(path, o.kind, o.width, path, o.unit, _about(o, "derived"))
                )
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

    def dtypes(self, precision: str, shape: LaneShape | None = None) -> dict[str, np.dtype[Any]]:
        """The numpy types of P, S, U and Y: their memory is that of the C structs, of one instance or of `shape`'s."""
        word = np.dtype(precision).itemsize * (shape.each if shape else 1)
        x = _struct_dtype([(m.name, *_place(m, precision, shape)) for m in self.x.members])
        made = {}
        for name, struct in (("P", self.p), ("S", self.s), ("U", self.u), ("Y", self.y)):
            places = [(m.name, *_place(m, precision, shape)) for m in struct.members]
            if name == "S" and self.x.members:
                places.append(("x", x, word))
            made[name] = _struct_dtype(places)
        return made


def _about(declared: Port | State | Param | FlatSignal, remark: str = "") -> str:
    """What a member's comment says: a remark, and what the values of an enumeration mean."""
    return " ".join(filter(None, (remark, "" if declared.enum is None else str(declared.enum))))


def _member(path: str, signal: FlatSignal | State, remark: str = "") -> Member:
    return Member(path, signal.kind, signal.width, path, signal.unit, remark)


def _place(m: Member, precision: str, shape: LaneShape | None) -> tuple[np.dtype[Any], int]:
    """A member's numpy type and its alignment [bytes].

    Of lanes the last axis is the lane, or, of bools whose masks are bits, a byte of eight lanes.
    """
    dims = () if m.width is None else (m.width,)
    if shape is None or m.shared:
        base = dtype_of(m.kind, precision)
        return np.dtype((base, dims)), base.itemsize
    if m.kind == "bool" and shape.bits:
        return np.dtype((np.uint8, (*dims, shape.lanes // 8))), shape.each // 8
    masks = "int32" if precision == "float32" else "int64"
    base = np.dtype(masks) if m.kind == "bool" else dtype_of(BY_NAME[m.kind].computes, precision)
    return np.dtype((base, (*dims, shape.lanes))), min(base.itemsize * shape.each, 64)


def _struct_dtype(places: Sequence[tuple[str, np.dtype[Any], int]]) -> np.dtype[Any]:
    """The numpy type of a C struct with members of a name, type and alignment. An empty one holds a byte."""
    if not places:
        return np.dtype({"names": ["none"], "formats": ["u1"]})
    offsets, end = [], 0
    for _, dtype, align in places:
        offsets.append(-(-end // align) * align)
        end = offsets[-1] + dtype.itemsize
    largest = max(align for _, _, align in places)
    names, formats = [name for name, _, _ in places], [dtype for _, dtype, _ in places]
    size = -(-end // largest) * largest
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
