"""The C structs of a program: P parameters, S states, U inputs, Y outputs, and where each path stands in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twodof.blocks.declarations import State
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import C_TYPES
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, FlatSignal, Node

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

    def add(
        self,
        stem: str,
        kind: str,
        width: int | None,
        path: str = "",
        unit: str = "",
        remark: str = "",
        shared: bool = False,
    ) -> Member:
        """A new member; its name is unique within the struct."""
        member = Member(self.names.new(stem), kind, width, path, unit, remark, shared)
        self.members.append(member)
        return member


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
        self.tick = self.s.add("tick", "uint32", None, "", "", "base ticks since the start", True)
        for path, q in program.parameters.items():
            d = q.declared
            self.parameters[q] = self.p.add(path, d.kind, d.width, path, d.unit, d.text)
        for node in program.nodes:
            for o in node.block.derived:
                path = f"{node.path}.{o.name}"
                self.derived[node, o.name] = self.p.add(path, o.kind, o.width, path, o.unit, "derived")
            for state in node.block.states:
                self.states[node, state.name] = self._state(node, state)
        for group in program.tick:
            for action in group.actions:
                for signal in action.signals:
                    wide = signal.width is not None and signal.width > WIDEST_LOCAL
                    if not group.guard.always or wide:
                        remark = "work" if group.guard.always else "held"
                        self.stored[signal] = self.s.add(
                            signal.path, signal.kind, signal.width, signal.path, signal.unit, remark
                        )
        for name, signal in program.inputs.items():
            self.inputs[signal] = self.u.add(name, signal.kind, signal.width, name, signal.unit)
        for path, signal in program.outputs.items():
            self.outputs[path] = self.y.add(path, signal.kind, signal.width, path, signal.unit)

    def _state(self, node: Node, state: State) -> Member:
        path = f"{node.path}.{state.name}"
        struct = self.x if state.continuous else self.s
        return struct.add(path, state.kind, state.width, path, state.unit)

    def lane_dtypes(self, shape: LaneShape) -> dict[str, np.dtype[Any]]:
        """As `dtypes`, of structs that hold several lanes: see `lane_dtype`."""
        x = lane_dtype(self.x.members, shape)
        s = lane_dtype(self.s.members, shape, [("x", x)] if self.x.members else [])
        p, u, y = (lane_dtype(struct.members, shape) for struct in (self.p, self.u, self.y))
        return {"P": p, "S": s, "U": u, "Y": y}

    def dtypes(self, precision: str) -> dict[str, np.dtype[Any]]:
        """The numpy types of P, S, U and Y: their memory is that of the C structs."""
        x = struct_dtype(self.x.members, precision)
        s = struct_dtype(self.s.members, precision, [("x", x)] if self.x.members else [])
        return {
            "P": struct_dtype(self.p.members, precision),
            "S": s,
            "U": struct_dtype(self.u.members, precision),
            "Y": struct_dtype(self.y.members, precision),
        }


def struct_dtype(
    members: Sequence[Member], precision: str, last: Sequence[tuple[str, np.dtype[Any]]] = ()
) -> np.dtype[Any]:
    """The numpy type of a C struct; an empty one holds one byte, because C has no empty structs."""
    formats: list[tuple[str, Any]] = []
    for m in members:
        base: Any = np.dtype({"real": precision, "bool": "bool"}.get(m.kind, m.kind))
        formats.append((m.name, base if m.width is None else np.dtype((base, (m.width,)))))
    formats += last
    if not formats:
        formats = [("none", np.dtype("uint8"))]
    return np.dtype({"names": [n for n, _ in formats], "formats": [f for _, f in formats]}, align=True)


def lane_dtype(
    members: Sequence[Member], shape: LaneShape, last: Sequence[tuple[str, np.dtype[Any]]] = ()
) -> np.dtype[Any]:
    """The numpy type of a C struct of lanes; `itemsize` is a multiple of its alignment.

    A member's last axis is the lane, or, of bools whose masks are bits, a byte of eight lanes.
    """
    word = 4 if shape.precision == "float32" else 8
    bases: dict[str, Any] = {"real": shape.precision, "bool": f"int{8 * word}"}
    names, formats, offsets = [], [], []
    end, alignment = 0, 1
    for m in members:
        base = np.dtype(bases.get(m.kind, m.kind))
        dims = () if m.width is None else (m.width,)
        last_axis, align = shape.lanes, base.itemsize * shape.each
        if m.kind == "bool" and shape.bits:
            base, last_axis, align = np.dtype("uint8"), shape.lanes // 8, shape.each // 8
        if m.shared:
            align = base.itemsize
        place = np.dtype((base, dims if m.shared else (*dims, last_axis)))
        names.append(m.name)
        formats.append(place)
        offsets.append(-(-end // align) * align)
        end, alignment = offsets[-1] + place.itemsize, max(alignment, align)
    for name, inner in last:
        align = word * shape.each  # states are real
        names.append(name)
        formats.append(inner)
        offsets.append(-(-end // align) * align)
        end, alignment = offsets[-1] + inner.itemsize, max(alignment, align)
    if not names:
        return np.dtype({"names": ["none"], "formats": ["u1"]})
    size = -(-end // alignment) * alignment
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
