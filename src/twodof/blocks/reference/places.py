"""Where things stand in a hierarchy: blocks, their output ports, and diagrams, with what a source means in each."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from twodof.blocks.block import Block
from twodof.blocks.declarations import Port, State
from twodof.blocks.diagram import BASE, Diagram, Rate
from twodof.errors import DiagramError, nearest


@dataclass(eq=False)
class Cell:
    """One block in its place. `drivers`: input -> who feeds it; `parameters`: own name -> path where it is set."""

    path: str
    block: Block
    rate: Rate
    levels: tuple[DiagramLevel, ...]  # the enclosing sub-diagrams with conditions, outermost first
    drivers: dict[str, PortOf | str] = field(default_factory=dict)
    parameters: dict[str, str] = field(default_factory=dict)
    initial: dict[str, Any] = field(default_factory=dict)  # output -> what it holds at first, if that is not 0
    disabled: dict[str, Any] = field(default_factory=dict)  # output -> what it is reset to, if that is another value

    @property
    def discrete(self) -> list[State]:
        """Its states that change by `update`."""
        return [s for s in self.block.states if not s.continuous]

    @property
    def continuous(self) -> list[State]:
        """Its states that change by `derivative` and `project`."""
        return [s for s in self.block.states if s.continuous]


@dataclass(frozen=True)
class PortOf:
    """An output port of a cell."""

    cell: Cell
    port: str

    @property
    def declared(self) -> Port:
        """The port as its block declares it."""
        return next(p for p in self.cell.block.outputs if p.name == self.port)

    def __str__(self) -> str:
        return f"{self.cell.path}.{self.port}"


@dataclass(eq=False)
class DiagramLevel:
    """A diagram in its place: the root, or a sub-diagram within `parent`."""

    diagram: Diagram
    path: str
    parent: DiagramLevel | None
    part: str
    children: dict[str, DiagramLevel | Cell] = field(default_factory=dict)
    enable: PortOf | str | None = None
    reset: PortOf | str | None = None
    trigger: PortOf | None = None  # true where its trigger has an edge
    resets_outputs: bool = False
    rate: Rate = BASE
    restart: PortOf | None = None  # true where it and all around it are enabled again
    _buses: dict[str, dict[str, PortOf | str]] = field(default_factory=dict)  # what was spread

    @property
    def signals(self) -> list[PortOf | str]:
        """What decides over it."""
        return [s for s in (self.enable, self.reset, self.trigger, self.restart) if s is not None]

    @property
    def enables(self) -> list[PortOf | str]:
        """Without any one of these it does not act."""
        return [s for s in (self.enable, self.trigger) if s is not None]

    @property
    def around(self) -> list[DiagramLevel]:
        """The diagrams that it is in, outermost first."""
        return [] if self.parent is None else [*self.parent.around, self.parent]

    def resolve(self, source: str) -> PortOf | str:
        """The block's port, or the name of the root's input, that `source` stands for here. It is not a bus."""
        end = self._end(source)
        fields = _fields_of(end, self._root)
        if fields:
            names = [str(field).removeprefix(f"{end}.") for field in fields]
            what = f"a bus with the fields {nearest('', names)}"
            raise DiagramError(what, f"{self.path}.{source}", "name one of its fields")
        return end

    def field(self, source: str, field: str) -> PortOf | str:
        """What `field` of the bus `source` stands for here; a wide bus is asked a thousand times."""
        if source not in self._buses:
            self._buses[source] = self.spread("", source)
        found = self._buses[source].get(field)
        return self.resolve(self.diagram.field(source, field)) if found is None else found

    def spread(self, name: str, source: str) -> dict[str, PortOf | str]:
        """What `source` stands for here under `name`; of a bus each field under "name.field"."""
        end = self._end(source)
        fields = _fields_of(end, self._root)
        return {f"{name}{str(field).removeprefix(str(end))}": field for field in fields} or {name: end}

    @property
    def _root(self) -> DiagramLevel:
        return self if self.parent is None else self.parent._root

    def _end(self, source: str) -> PortOf | str:
        """What `source` leads to, which may be a bus."""
        level, text = self, source
        for _ in range(10_000):
            part, port = level.diagram.source(text)
            if part is None:
                if level.parent is None:
                    return port
                above = level.parent.diagram.feed(level.part, port)
                if above is None:
                    raise DiagramError("the input is not connected", f"{level.path}.{port}", "connect it or remove it")
                level, text = level.parent, above
                continue
            child = level.children[part]
            if isinstance(child, Cell):
                return PortOf(child, port)
            inner = child.diagram.outlet(port)
            if inner is None:
                raise DiagramError("the output is not connected", f"{child.path}.{port}", "connect it or remove it")
            level, text = child, inner
        raise DiagramError("a connection leads back to itself", f"{self.path}.{source}", "a loop needs a block in it")


def _fields_of(end: PortOf | str, root: DiagramLevel) -> list[PortOf | str]:
    """The ports that are the fields of a bus; none of what is not one."""
    if isinstance(end, str):
        return [] if end in root.diagram.inputs else [n for n in root.diagram.inputs if n.startswith(f"{end}.")]
    names = [port.name for port in end.cell.block.outputs]
    return [] if end.port in names else [PortOf(end.cell, n) for n in names if n.startswith(f"{end.port}.")]
