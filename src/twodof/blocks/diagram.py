"""Diagram: blocks, sub-diagrams and named connections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from twodof.blocks.block import Block
from twodof.blocks.conditions import EDGES
from twodof.blocks.datatypes.enumeration import Enumeration, Kind
from twodof.blocks.declarations import Param, Port, check_lists, check_name, located, unknown_name
from twodof.blocks.plain_data import plain_data
from twodof.errors import DiagramError, nearest, shown

MAX_DIVIDER = 2**31 - 1
MAX_NESTED = 2**256  # the product of the dividers of a part and of the diagrams around it


class Rate(NamedTuple):
    """When a part runs: at ticks with tick % divider == offset. Inside a part, rates count that part's own ticks."""

    divider: int = 1
    offset: int = 0

    def within(self, outer: Rate) -> Rate:
        """This rate, given relative to `outer`, relative to the base tick."""
        return Rate(self.divider * outer.divider, outer.offset + outer.divider * self.offset)

    def due(self, tick: int) -> bool:
        """Whether a part of this rate, relative to the base tick, runs at base tick `tick`."""
        return tick % self.divider == self.offset

    def check(self, path: str, most: int = MAX_DIVIDER) -> Rate:
        """This rate if it is possible and its divider at most `most`; else DiagramError."""
        whole = type(self.divider) is int and type(self.offset) is int
        if not (whole and 1 <= self.divider <= most and 0 <= self.offset < self.divider):
            raise DiagramError(
                f"rate {shown(tuple(self))} is impossible",
                path,
                f"divider >= 1 and at most {MAX_DIVIDER} (2^256 with those of all enclosing diagrams), "
                "0 <= offset < divider",
            )
        return self


BASE = Rate(1, 0)
CONDITIONS = ("enable", "reset", "trigger")
"""The arguments of `Diagram.add` that are sources of bools which decide over a sub-diagram."""


@dataclass
class Part:
    """A block or sub-diagram under a name. `enable`, `reset` and `trigger` are sources of bools in the same diagram.

    `params` binds parameters of the part to parameters of the diagram: inner name -> outer name.
    `disabled` is what outputs do while a sub-diagram is not enabled: "hold" or "reset" (0). `enabling` is what the
    states do once it and all around it are enabled again: "keep" their values, or "restart" from the initial ones.
    `initial` are the values of outputs before they are first computed, and where "reset" puts them, if that is not 0.
    With a `trigger` it acts at the ticks alone at which that has an `edge`: "rising", "falling" or "either".
    """

    name: str
    item: Block | Diagram
    rate: Rate = BASE
    params: dict[str, str] = field(default_factory=dict)
    enable: str | None = None
    reset: str | None = None
    trigger: str | None = None
    edge: str = "rising"
    disabled: str = "hold"
    enabling: str = "keep"
    initial: dict[str, Any] = field(default_factory=dict)
    position: tuple[float, float] | None = None


class Diagram:
    """Blocks and sub-diagrams by name, and connections between ports.

    A source is written "part.port" (or "part" if it has one output), or it is the name of a diagram input. A
    destination is "part.port" (or "part" if it has one input), or the name of a diagram output.
    """

    def __init__(self, name: str, text: str = "") -> None:
        self.name = check_name(name, "diagram")
        self.text = text
        self.inputs: dict[str, Port] = {}
        self.outputs: dict[str, str | None] = {}  # name -> source
        self.params: dict[str, Param] = {}
        self.parts: dict[str, Part] = {}
        self.connections: dict[tuple[str, str], str] = {}  # (part, port) -> source

    def input(
        self,
        name: str,
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
        shape: tuple[int, int] | None = None,
    ) -> str:
        """Declare an input; returns its name, which is a source."""
        return self.declare(Port(name, kind, width, unit, shape))

    def declare(self, port: Port) -> str:
        """Declare the input `port`; returns its name, which is a source."""
        self._new(port.name)
        self.inputs[port.name] = port
        return port.name

    def output(self, name: str, source: str | None = None) -> None:
        """Declare an output, fed by `source` (or connected later). Its type, width and unit are its source's."""
        if name in self.outputs:
            raise DiagramError(f"two outputs are named {name!r}", self.name, "names are unique")
        check_name(name, self.name)
        self.outputs[name] = source

    def param(
        self,
        name: str,
        value: object = 0.0,
        *,
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
        low: float = -float("inf"),
        high: float = float("inf"),
        text: str = "",
        tunable: bool = True,
        shape: tuple[int, int] | None = None,
        enum: Enumeration | None = None,
    ) -> str:
        """Declare a parameter of the diagram, to which parameters of its parts may be bound (see `add`)."""
        self._new(name)
        with located(f"{self.name}.{name}"):
            self.params[name] = Param(name, value, kind, width, unit, low, high, text, tunable, shape, enum)
        return name

    def add(
        self,
        name: str,
        item: Block | Diagram,
        *,
        rate: Rate | tuple[int, int] = BASE,
        params: Mapping[str, str] | None = None,
        enable: str | None = None,
        reset: str | None = None,
        trigger: str | None = None,
        edge: str = "rising",
        disabled: str = "hold",
        enabling: str = "keep",
        initial: Mapping[str, Any] | None = None,
        position: tuple[float, float] | None = None,
        inputs: Mapping[str, str] | None = None,
        **ports: str,
    ) -> str:
        """Add a part and connect its inputs by keyword (`u="source"`); returns its name.

        `inputs` connects too: {"reset": "source"} is an input that has the name of one of these arguments.
        Raises DiagramError for an item that is not a block or diagram, and for a name that is taken or illegal. It also
        does so for a rate that is not two whole numbers, divider >= 1 and offset in [0, divider).
        """
        self._new(name)
        path = f"{self.name}.{name}"
        if not isinstance(item, (Block, Diagram)):
            remedy = "call the class: Gain() is a block" if isinstance(item, type) else "see function_block"
            raise DiagramError(f"{shown(item)} is not a block or a diagram", path, remedy)
        if isinstance(item, Block):
            check_lists(item, path)
        for argument, value in (("rate", rate), ("params", params), ("initial", initial), ("position", position)):
            if isinstance(value, str):
                raise DiagramError(
                    f"{argument}={shown(value)} is no {argument}", path, _as_input(item, argument, value) or "see add"
                )
        for output in initial or {}:
            if output not in port_names(item, "output"):
                there = nearest(output, port_names(item, "output"))
                raise DiagramError(f"there is no output {shown(output)} to start", path, f"there are: {there}")
        held = {n: plain_data(v, f"{path}.{n}") for n, v in (initial or {}).items()}
        known = {p.name for p in item.params} if isinstance(item, Block) else set(item.params)
        for inner in params or {}:
            if inner not in known:
                raise DiagramError(
                    f"there is no parameter {shown(inner)} to bind", path, f"there are: {nearest(inner, sorted(known))}"
                )
        divider, offset = _pair(rate, path, "rate")
        checked = Rate(divider, offset).check(path)
        place = None if position is None else _pair(position, path, "position")
        part = Part(
            name, item, checked, dict(params or {}), enable, reset, trigger, edge, disabled, enabling, held, place
        )
        _check_conditions(part, path, by_keyword=inputs is None)
        self.parts[name] = part
        for port, source in {**(inputs or {}), **ports}.items():
            self.connect(source, f"{name}.{port}")
        return name

    def connect(self, source: str, *destinations: str) -> None:
        """Connect `source` to each destination. Raises DiagramError if a destination is unknown or already fed."""
        for destination in destinations:
            if destination in self.outputs:
                if self.outputs[destination] is not None:
                    raise DiagramError(
                        f"output {shown(destination)} is fed twice", self.name, "an input has one source"
                    )
                self.outputs[destination] = source
                continue
            part, port = self._end(destination, "input")
            if (part, port) in self.connections:
                raise DiagramError(f"input {shown(destination)} is fed twice", self.name, "an input has one source")
            self.connections[part, port] = source

    def source(self, text: str) -> tuple[str | None, str]:
        """(part, port) that a source names, or (None, name) of an input. Raises DiagramError if there is none."""
        if text in self.inputs:
            return None, text
        return self._end(text, "output")

    def _end(self, text: str, direction: str) -> tuple[str, str]:
        part, _, port = text.partition(".")
        if part not in self.parts:
            kind, outer = ("input", self.inputs) if direction == "output" else ("output", self.outputs)
            raise unknown_name(f"{kind} or part", part, [*self.parts, *outer], self.name)
        item = self.parts[part].item
        ports = port_names(item, direction)
        if not port and len(ports) == 1:
            return part, ports[0]
        if port not in ports:
            what = f"no {direction} {shown(port)}" if port else f"{len(ports)} {direction}s, so one must be named"
            raise DiagramError(f"{part!r} has {what}", self.name, f"{direction}s: {nearest(port, ports)}")
        return part, port

    def _new(self, name: str) -> None:
        check_name(name, self.name)
        if name in self.parts or name in self.inputs or name in self.params:
            raise DiagramError(
                f"the name {name!r} is used twice",
                self.name,
                "parts, inputs and parameters share one space of names",
            )


def _pair(value: object, path: str, argument: str) -> tuple[Any, Any]:
    """The two numbers of an argument of `add`; DiagramError for anything else."""
    pair = plain_data(value, path)
    if not isinstance(pair, list) or len(pair) != 2 or not all(type(n) in (int, float) for n in pair):
        raise DiagramError(f"{argument}={shown(value)}", path, f"give {argument}=(number, number)")
    return pair[0], pair[1]


_PAST = {"enable": "enabled", "reset": "reset", "trigger": "triggered"}
_CHOICES = {"disabled": ("hold", "reset"), "enabling": ("keep", "restart"), "edge": EDGES}


def _check_conditions(part: Part, path: str, by_keyword: bool) -> None:
    """Raise DiagramError for conditions that a part cannot have; `by_keyword`: all its inputs were given so."""
    for argument in CONDITIONS:
        source = getattr(part, argument)
        if source is None:
            continue
        as_input = _as_input(part.item, argument, source)
        if isinstance(part.item, Block):
            raise DiagramError(f"a block cannot be {_PAST[argument]}", path, as_input or "put it into a sub-diagram")
        if by_keyword and argument in part.item.inputs:
            raise DiagramError(
                f"{argument}= is both an input of the sub-diagram and what makes it {_PAST[argument]}",
                path,
                f"{as_input}; with inputs={{...}}, {argument}= means the condition",
            )
    for argument, choices in _CHOICES.items():
        choice = getattr(part, argument)
        if choice not in choices:
            remedy = _as_input(part.item, argument, choice) or f"use one of {', '.join(choices)}"
            raise DiagramError(f"{argument}={shown(choice)}", path, remedy)
    if part.edge != "rising" and part.trigger is None:
        raise DiagramError(f"edge={shown(part.edge)} without a trigger", path, "give trigger= too")
    if part.enabling == "restart" and isinstance(part.item, Block):
        raise DiagramError("a block cannot be restarted", path, "put it into a sub-diagram")


def _as_input(item: Block | Diagram, name: str, source: str) -> str:
    """How to connect an input that has the name of an argument of `add`; "" if there is none of that name."""
    return f"connect the input with inputs={{{name!r}: {shown(source)}}}" if name in port_names(item, "input") else ""


def port_names(item: Block | Diagram, direction: str) -> list[str]:
    """The names of the inputs or outputs (`direction` "input" or "output") of a block or diagram."""
    if isinstance(item, Block):
        return [p.name for p in (item.inputs if direction == "input" else item.outputs)]
    return list(item.inputs if direction == "input" else item.outputs)


def carried(item: Block | Diagram, output: str) -> Port | None:
    """What comes out of an output; None if that leads nowhere in a sub-diagram."""
    for _ in range(64):
        if isinstance(item, Block):
            return next(p for p in item.outputs if p.name == output)
        source = item.outputs.get(output)
        if source is None:
            return None
        part, port = item.source(source)
        if part is None:
            return item.inputs[port]
        item, output = item.parts[part].item, port
    return None
