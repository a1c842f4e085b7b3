"""Diagram: blocks, sub-diagrams and named connections."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from twodof.blocks.block import EDGES, Block
from twodof.blocks.bus import leaves_of
from twodof.blocks.declarations import Param, Port, Typed, check_lists, check_name, check_path, located, unknown_name
from twodof.blocks.enumeration import Enumeration, Kind, plain_data
from twodof.errors import DiagramError, listed, nearest, shown

MAX_DIVIDER = 2**31 - 1
MAX_NESTED = 2**256  # the product of the dividers of a part and of the diagrams around it


class Rate(NamedTuple):
    """Rate of a part, which runs at ticks with tick % divider == offset. Rates inside a part count its own ticks."""

    divider: int = 1
    offset: int = 0

    def within(self, outer: Rate) -> Rate:
        """Return this rate, given relative to `outer`, as a rate relative to the base tick."""
        return Rate(self.divider * outer.divider, outer.offset + outer.divider * self.offset)

    def due(self, tick: int) -> bool:
        """Return True if a part of this rate, relative to the base tick, runs at base tick `tick`."""
        return tick % self.divider == self.offset

    def check(self, path: str, most: int = MAX_DIVIDER) -> Rate:
        """Return this rate if it is possible and its divider at most `most`; else raise DiagramError."""
        whole = type(self.divider) is int and type(self.offset) is int
        if not (whole and 1 <= self.divider <= most and 0 <= self.offset < self.divider):
            raise DiagramError(
                f"rate {shown(tuple(self))} is impossible",
                path,
                f"use a divider from 1 to {MAX_DIVIDER} (2^256 with those of all enclosing diagrams) and an offset "
                "with 0 <= offset < divider",
            )
        return self


BASE = Rate(1, 0)
CONDITIONS = ("enable", "reset", "trigger")
"""Arguments of `Diagram.add` that name bool sources which enable, reset or trigger a sub-diagram."""


@dataclass
class Part:
    """A block or sub-diagram in a diagram.

    - `params`: the diagram's parameter to which each parameter of the part is bound.
    - `enable`, `reset`, `trigger`: names of bool sources in the same diagram.
    - `disabled`: the outputs while the part is disabled: "hold", "reset" (to `initial`, by default 0), or
      {output: value}.
    - `enabling`: its states when it and all diagrams around it are enabled again: "keep" or "restart".
    - `initial`: the outputs before they are first computed.
    - `edge`: with a `trigger` it runs only at a "rising", "falling" or "either" edge of that.
    - `position`: its place on the editor's sheet, where a `flipped` part has its inputs on the right side.
    - `commented`: such a sub-diagram stands for its first part: "out" has outputs of 0, "through" passes inputs on.
    """

    name: str
    item: Block | Diagram
    rate: Rate = BASE
    params: dict[str, str] = field(default_factory=dict)
    enable: str | None = None
    reset: str | None = None
    trigger: str | None = None
    edge: str = "rising"
    disabled: str | dict[str, Any] = "hold"
    enabling: str = "keep"
    initial: dict[str, Any] = field(default_factory=dict)
    position: tuple[float, float] | None = None
    flipped: bool = False
    commented: str = ""


class Diagram:
    """Blocks and sub-diagrams by name, and connections between ports.

    A source is written "part.port" (or "part" if it has one output), or it is the name of a diagram input. A
    destination is "part.port" (or "part" if it has one input), or the name of a diagram output. Either may be a bus,
    which is one connection, or a field of one, "part.port.field". An input that is a bus takes the fields that it names
    from the source. `input_positions` and `output_positions` are the places on the editor's sheet of inputs and outputs
    that were moved, by name.
    """

    def __init__(self, name: str, text: str = "") -> None:
        self.name = check_name(name, "diagram")
        self.text = text
        self.inputs: dict[str, Port] = {}
        self.outputs: dict[str, str | None] = {}  # name -> source
        self.params: dict[str, Param] = {}
        self.parts: dict[str, Part] = {}
        self.connections: dict[tuple[str, str], str] = {}  # (part, port, perhaps a bus or a field) -> source
        self.input_positions: dict[str, tuple[float, float]] = {}
        self.output_positions: dict[str, tuple[float, float]] = {}
        self._buses: set[str] = set()  # the paths of inputs that are buses

    def __repr__(self) -> str:
        ports = f"inputs {listed(self.inputs)}; outputs {listed(self.outputs)}"
        return f"<Diagram {self.name}: {len(self.parts)} parts; {ports}; parameters {listed(self.params)}>"

    def input(
        self,
        name: str,
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
        shape: tuple[int, int] | None = None,
    ) -> str:
        """Declare an input, and return its name, which is a source."""
        return self.declare(Port(name, kind, width, unit, shape))

    def declare(self, port: Port) -> str:
        """Declare the input `port`, and return its name, which is a source. A bus becomes its fields, "att.rates.p"."""
        for leaf in leaves_of(port):
            above = bus_paths(leaf.name)
            self._new(leaf.name, above)
            self._buses.update(above)
            self.inputs[leaf.name] = leaf
        return port.name

    def output(self, name: str, source: str | None = None) -> None:
        """Declare an output, fed by `source` (or connected later). Its type, width and unit are its source's."""
        if name in self.outputs:
            raise DiagramError(f"two outputs are named {name!r}", self.name, "rename one")
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
        disabled: str | Mapping[str, Any] = "hold",
        enabling: str = "keep",
        initial: Mapping[str, Any] | None = None,
        position: tuple[float, float] | None = None,
        inputs: Mapping[str, str] | None = None,
        **ports: str,
    ) -> str:
        """Add a part, connect its inputs by keyword (`u="source"`), and return its name. See `Part` for the arguments.

        `inputs` connects inputs too, also those with the name of an argument: {"reset": "source"}. Raises DiagramError
        for an item that is not a block or diagram, a name that is taken or illegal, and a rate that is not two whole
        numbers, divider >= 1 and offset in [0, divider).
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
                what = f"{argument}={shown(value)} is not a {argument}"
                raise DiagramError(what, path, _as_input(item, argument, value) or "see Diagram.add")
        held = _of_outputs(item, initial or {}, path, "start")
        if isinstance(disabled, Mapping):
            disabled = _of_outputs(item, disabled, path, "reset")
        known = {p.name for p in item.params} if isinstance(item, Block) else set(item.params)
        for inner, outer in (params or {}).items():
            if inner not in known:
                raise DiagramError(
                    f"no parameter named {shown(inner)} to bind", path, f"there are: {nearest(inner, sorted(known))}"
                )
            if not isinstance(outer, str):
                what = f"{inner!r} is bound to {shown(outer)}, which is not a name"
                raise DiagramError(what, path, "name a parameter of the diagram")
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
                        f"output {shown(destination)} has two sources", self.name, "remove one of the connections"
                    )
                self.outputs[destination] = source
                continue
            part, port = self._end(destination, "input")
            if self._fed(part, port):
                what = f"input {shown(destination)} has two sources"
                raise DiagramError(what, self.name, "remove one of the connections")
            self.connections[part, port] = source

    def _fed(self, part: str, port: str) -> bool:
        """Return True if an input, its bus, or a field of it has a source."""
        if any((part, path) in self.connections for path in (port, *bus_paths(port))):
            return True
        fields = (name for name in port_names(self.parts[part].item, "input") if name.startswith(f"{port}."))
        return any((part, path) in self.connections for name in fields for path in (name, *bus_paths(name)))

    def source(self, text: str) -> tuple[str | None, str]:
        """Return the (part, port) named by the source `text`, or (None, name) for an input of the diagram.

        The port may be a bus, or a field of one. Raises DiagramError if there is none.
        """
        if text in self.inputs or text in self._buses:
            return None, text
        top, _, field = text.partition(".")
        if top in self._buses:
            raise _unknown_field(top, field, [name for name in self.inputs if name.startswith(f"{top}.")], self.name)
        if top in self.inputs:
            raise _no_bus(top, field, self.name)
        return self._end(text, "output")

    def wire(self, part: str, port: str) -> tuple[str | None, str]:
        """Return an input's source and "", or the source of the bus around it and the path in it (".rates.p").

        The source is None if nothing is connected.
        """
        for path in (port, *bus_paths(port)):
            source = self.connections.get((part, path))
            if source is not None:
                return source, port[len(path) :]
        return None, ""

    def feed(self, part: str, port: str) -> str | None:
        """Return the source of a part's input, which may be a field of the bus around it; None without one."""
        source, field = self.wire(part, port)
        return None if source is None else self.field(source, field)

    def outlet(self, output: str) -> str | None:
        """Return the source of a diagram's output, or of a field "att.rates.p" of one; None without one."""
        name, dot, field = output.partition(".")
        source = self.outputs[name]
        return None if source is None else self.field(source, dot + field)

    def gives(self, path: str) -> bool:
        """Return True if `path` is an output of the diagram, or a field of one."""
        if path in self.outputs or path.partition(".")[0] not in self.outputs:
            return path in self.outputs
        try:
            return bool(carried_fields(self, path))
        except DiagramError:  # that of a part of this name
            return False

    def field(self, source: str, field: str) -> str:
        """Return the source of the field ".rates.p" of a source; the source itself for the field ""."""
        if not field:
            return source
        part, port = self.source(source)
        return f"{port}{field}" if part is None else f"{part}.{port}{field}"

    def _end(self, text: str, direction: str) -> tuple[str, str]:
        part, _, port = text.partition(".")
        if part not in self.parts:
            kind, outer = ("input", self.inputs) if direction == "output" else ("output", self.outputs)
            raise unknown_name(f"{kind} or part", part, [*self.parts, *outer], self.name)
        item = self.parts[part].item
        ports = port_names(item, direction)
        tops = list(dict.fromkeys(name.partition(".")[0] for name in ports))
        if not port and len(tops) == 1:
            return part, tops[0]
        passed = isinstance(item, Diagram) and direction == "output" and port.partition(".")[0] in item.outputs
        if port not in ports and not passed and not any(name.startswith(f"{port}.") for name in ports if port):
            if len(tops) == 1 and direction == "output" and carried_fields(item, f"{tops[0]}.{port}"):
                return part, f"{tops[0]}.{port}"  # the field of the only output
            top, _, field = port.partition(".")
            for path in bus_paths(port):
                if path in ports:
                    raise _no_bus(f"{part}.{path}", port.removeprefix(f"{path}."), self.name)
            if top in tops:
                inside = [name for name in ports if name.startswith(f"{top}.")]
                raise _unknown_field(f"{part}.{top}", field, [f"{part}.{name}" for name in inside], self.name)
            what = f"no {direction} {shown(port)}" if port else f"{len(tops)} {direction}s, so one must be named"
            raise DiagramError(f"{part!r} has {what}", self.name, f"{direction}s: {nearest(port, ports)}")
        return part, port

    def _new(self, name: str, above: Sequence[str] = ()) -> None:
        """Check that a name is free; that of a field is in the buses `above`."""
        check_path(name, self.name) if above else check_name(name, self.name)
        taken = name in self._buses or (above and (above[-1] in self.parts or above[-1] in self.params))
        taken = taken or any(path in self.inputs for path in above)
        if taken or name in self.parts or name in self.inputs or name in self.params:
            raise DiagramError(
                f"the name {name!r} is used twice", self.name, "give each part, input and parameter another name"
            )


def _unknown_field(bus: str, field: str, paths: Iterable[str], where: str) -> DiagramError:
    there = nearest(field, [path.removeprefix(f"{bus}.") for path in paths])
    return DiagramError(f"the bus {bus!r} has no field {field!r:.120}", where, f"there are: {there}")


def _no_bus(signal: str, field: str, where: str) -> DiagramError:
    what = f"{signal!r} is not a bus, and so does not have the field {field!r:.120}"
    return DiagramError(
        what, where, "make a bus of its fields with BusCreate, or connect the input's fields one by one"
    )


def no_parameter(outer: str, diagram: Diagram, path: str) -> DiagramError:
    """Return the error for a part bound to a parameter that its diagram does not have."""
    there = f"declare it with Diagram.param; there are: {nearest(outer, diagram.params)}"
    return DiagramError(f"no parameter named {outer!r} to bind to", path, there)


def not_connected(end: str, path: str) -> DiagramError:
    """Return the error for an "input" or "output" (`end`) at `path` without a source."""
    return DiagramError(f"the {end} {path.rpartition('.')[2]} is not connected", path, "connect it or remove it")


def check_condition(signal: Typed, source: str, what: str, path: str) -> None:
    """Raise DiagramError if the `source` of a sub-diagram's condition, such as `what` "enable", is not a bool."""
    if signal.kind != "bool" or signal.width is not None:
        what = f"its {what} signal {source!r} is not a bool"
        raise DiagramError(what, path, "make a bool of it, for example by comparing it with a number")


def check_base_rate(block: Block, rate: Rate, path: str) -> None:
    """Raise DiagramError for a block that must run at the base rate and does not."""
    moving = any(s.continuous for s in block.states)
    if (moving or block.trace.edges) and rate != BASE:
        what = "continuous states" if moving else "an edge inside the step"
        ticks = f"every {rate.divider} ticks from tick {rate.offset} on"
        raise DiagramError(f"it has {what}, and runs {ticks}", path, "let the block run at the base rate")


def declared_values(part: Part) -> dict[str, dict[str, Any]]:
    """Return the values that a part declares for its outputs: {"initial": {output: value}, "disabled": ...}."""
    return {"initial": part.initial, "disabled": part.disabled if isinstance(part.disabled, dict) else {}}


def two_values(what: str, signal: str, first: Any, second: Any) -> str:
    """Return the text of an error for two different `declared_values` of one signal."""
    verb, to = ("starts", "at") if what == "initial" else ("is reset", "to")
    return f"{signal} {verb} {to} {shown(first)} and {to} {shown(second)}"


def _of_outputs(item: Block | Diagram, values: Mapping[str, Any], path: str, what: str) -> dict[str, Any]:
    """Values by output; DiagramError for a name that is not an output of the part."""
    names = port_names(item, "output")
    for output in values:
        if (output.partition(".")[0] if isinstance(item, Diagram) else output) not in names:
            there = f"there are: {nearest(output, names)}"
            raise DiagramError(f"no output named {shown(output)} to {what}", path, there)
    return {n: plain_data(v, f"{path}.{n}") for n, v in values.items()}


def _pair(value: object, path: str, argument: str) -> tuple[Any, Any]:
    """Return the two numbers of an argument of `add`; raise DiagramError for anything else."""
    pair = plain_data(value, path)
    if not isinstance(pair, list) or len(pair) != 2 or not all(type(n) in (int, float) for n in pair):
        what = f"{argument}={shown(value)} is not two numbers"
        raise DiagramError(what, path, f"give {argument}=(number, number)")
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
            what = f"{argument}= is both an input of the sub-diagram and what makes it {_PAST[argument]}"
            raise DiagramError(what, path, f"{as_input}; with inputs={{...}}, {argument}= means the condition")
    for argument, choices in _CHOICES.items():
        choice = getattr(part, argument)
        if argument == "disabled" and isinstance(choice, dict):
            if part.enable is None:
                raise DiagramError("it has values for disabled=, and is never disabled", path, "give enable= too")
            continue
        if choice not in choices:
            remedy = _as_input(part.item, argument, choice) or f"use one of {', '.join(choices)}"
            raise DiagramError(f"{argument}={shown(choice)} is unknown", path, remedy)
    if part.edge != "rising" and part.trigger is None:
        raise DiagramError(f"edge={shown(part.edge)} without a trigger", path, "give trigger= too")
    if part.enabling == "restart" and isinstance(part.item, Block):
        raise DiagramError("a block cannot be restarted", path, "put it into a sub-diagram")


def _as_input(item: Block | Diagram, name: str, source: str) -> str:
    """How to connect an input that has the name of an argument of `add`; "" if there is none of that name."""
    return f"connect the input with inputs={{{name!r}: {shown(source)}}}" if name in port_names(item, "input") else ""


def port_names(item: Block | Diagram, direction: str) -> list[str]:
    """Return the names of the inputs or outputs (`direction` "input" or "output") of a block or diagram."""
    if isinstance(item, Block):
        return [p.name for p in (item.inputs if direction == "input" else item.outputs)]
    return list(item.inputs if direction == "input" else item.outputs)


def bus_paths(path: str) -> list[str]:
    """Return the buses around a field, the innermost first: "att.rates" and "att" for "att.rates.p"."""
    return [path[:i] for i in range(len(path) - 1, 0, -1) if path[i] == "."]


def carried(item: Block | Diagram, output: str) -> Port | None:
    """Return the port from which an output, or a field of one, comes; None for a bus, or without a source."""
    return carried_fields(item, output).get("")


def carried_fields(item: Block | Diagram, output: str) -> dict[str, Port]:
    """Return the ports an output comes from, by field "rates.p", or "" if it is not a bus; empty without a source."""
    for _ in range(64):
        if isinstance(item, Block):
            return fields_of(item.outputs, output)
        name = output.partition(".")[0]
        source = item.outlet(output) if item.outputs.get(name) is not None else None
        if source is None:
            return {}
        part, port = item.source(source)
        if part is None:
            return fields_of(item.inputs.values(), port)
        item, output = item.parts[part].item, port
    return {}


def fields_of(ports: Iterable[Port], name: str) -> dict[str, Port]:
    """Return {"": port} for the port `name`, or the ports that are fields of a bus of this name, by field."""
    return {p.name[len(name) + 1 :]: p for p in ports if p.name == name or p.name.startswith(f"{name}.")}
