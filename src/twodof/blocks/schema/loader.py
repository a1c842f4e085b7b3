"""Builds a diagram from its JSON form and refuses, at the door, what would cost too much or is not what it says."""

import unicodedata
from collections.abc import Container, Mapping
from dataclasses import fields
from typing import Any

from twodof.blocks import library
from twodof.blocks.block import REGISTRY, Block
from twodof.blocks.declarations import NAME, Param, Port, State, check_shape, located
from twodof.blocks.diagram import CONDITIONS, Diagram
from twodof.blocks.expressions.expr import at_most
from twodof.blocks.expressions.graph import COPIED, MAX_OPERATIONS, MAX_SIZE, CostMeter, too_large
from twodof.blocks.schema.traced_block import TracedBlock, TracedMachine, graph_from_json, machine_from_json
from twodof.errors import DiagramError, TwodofError, nearest, shown

MAX_DEPTH = 64  # of sub-diagrams
MAX_PARTS = 10_000
MAX_DECLARED = 100_000  # inputs, outputs, states and parameters of all parts
MAX_ELEMENTS = 1_000_000  # of their arrays, all together
MAX_NUMBERS = 100_000  # written out: tables, initial values, arguments of blocks
MAX_LIST_DEPTH = 4
MAX_PLAIN_DEPTH = 16  # of lists and objects, as the values of buses in buses have
MAX_TEXT = 10_000  # characters
MAX_UNIT = 40
MAX_STRING = 1000  # an argument of a block
STAGES = 4  # evaluations of a derivative in a step of RK4

POSITIONS = ("input_positions", "output_positions")
_DIAGRAM = {"name", "text", "inputs", "params", "parts", "connections", "outputs", *POSITIONS}
_PART = {
    "name",
    "rate",
    "params",
    *CONDITIONS,
    "edge",
    "disabled",
    "enabling",
    "initial",
    "position",
    "flipped",
    "diagram",
    "block",
}
_SECTIONS = {"inputs", "outputs", "states", "params", "derived"}
_FIELDS = {cls: {field.name for field in fields(cls)} for cls in (Port, State, Param)}
MACHINE = "state_machine"
MACHINE_SECTIONS = ("inputs", "outputs", "variables", "params", "derived")
_MACHINE = {"type", "name", "crossing", "nodes", "prepare", "modes", "transitions", *MACHINE_SECTIONS}
_CUSTOM = {"type", "name", "crossing", "nodes", "prepare", "output", "edges", "update", "derivative", "project"}


def member(data: Mapping[str, Any], key: str, kind: type | tuple[type, ...], where: str, default: Any = None) -> Any:
    """`data[key]` (or `default`) if it is of the type `kind`; else DiagramError."""
    value = data.get(key, default)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is int):
        remedy = "see docs/reference/diagram-files.md"
        raise DiagramError(f"{key!r} is missing or of the wrong kind", where, remedy)
    return value


def only(data: Mapping[str, Any], known: set[str], where: str) -> None:
    """Raise DiagramError if `data` has a key that is not `known`: a slip of the pen would change a diagram silently."""
    for key in data:
        if key not in known:
            raise DiagramError(f"unknown key {shown(key)}", where, f"there may be: {nearest(key, sorted(known))}")


def text(value: str, most: int, where: str, lines: bool = False) -> str:
    """`value` if it has at most `most` characters, all visible ones (with `lines`, also line ends); else DiagramError.

    Control characters, halves of surrogate pairs, characters of no width and those that reorder a line are refused.
    They could make a text look like another one, or end what it stands in.
    """
    if len(value) > most:
        raise DiagramError(f"a text of {len(value)} characters", where, f"at most {most}")
    for c in value:
        if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp") and not (lines and c in "\n\t"):
            raise DiagramError(f"the character U+{ord(c):04X} in a text", where, "use visible characters")
    return value


class Loader:
    """Builds one diagram and counts what it costs."""

    def __init__(self) -> None:
        self.parts = self.declared = self.elements = self.numbers = self.restarting = 0
        self.size = self.prepared = self.tick = self.stage = self.edges = 0
        self.integrates = False
        self.meter = CostMeter()

    def diagram(self, data: dict[str, Any], path: str = "", depth: int = 0) -> Diagram:
        """Return the diagram that `data` describes, at `path` and `depth` within another one. Raises DiagramError."""
        if depth > MAX_DEPTH:
            raise DiagramError(f"sub-diagrams are nested more than {MAX_DEPTH} deep", path, "flatten the diagram")
        only(data, _DIAGRAM, path or "diagram")
        name = member(data, "name", str, path or "diagram")
        d = Diagram(name, text(member(data, "text", str, path, ""), MAX_TEXT, path or "diagram", lines=True))
        path = path or d.name
        for port in self._declarations(Port, data, "inputs", path):
            d.declare(port)
        for param in self._declarations(Param, data, "params", path):
            d.param(**vars(param))
        parts = member(data, "parts", list, path, [])
        self.parts += len(parts)
        if self.parts > MAX_PARTS:  # counted before the first is made, which costs more than reading them
            raise DiagramError(f"more than {MAX_PARTS} parts", path, "make the diagram smaller")
        for form in parts:
            self._part(d, form, path, depth)
        for pair in member(data, "connections", list, path, []):
            if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(s, str) for s in pair)):
                raise DiagramError(f"{shown(pair)} is not a connection", path, 'write ["source", "part.port"]')
            d.connect(*pair)
        for pair in member(data, "outputs", list, path, []):
            named = isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str)
            if not named or not isinstance(pair[1], (str, type(None))):
                raise DiagramError(f"{shown(pair)} is not an output", path, 'write ["name", "source"]')
            self._count(1, 0, path)
            d.output(*pair)
        inputs = {name.partition(".")[0] for name in d.inputs}  # a bus has one place
        d.input_positions = _positions(data, "input_positions", inputs, path)
        d.output_positions = _positions(data, "output_positions", d.outputs, path)
        return d

    def _part(self, d: Diagram, form: Any, path: str, depth: int) -> None:
        if not isinstance(form, dict):
            raise DiagramError(f"{shown(form)} is not a part", path, "a part is an object with a name")
        name = member(form, "name", str, path)
        where = f"{path}.{name:.80}"
        only(form, _PART, where)
        item: Block | Diagram
        if "diagram" in form:
            before = self.declared
            item = self.diagram(member(form, "diagram", dict, where), where, depth + 1)
            if form.get("enabling") == "restart":  # each such diagram sets the states of all that is inside
                self.restarting += self.declared - before
                if self.restarting > MAX_DECLARED:
                    what = f"more than {MAX_DECLARED} ports and states in diagrams that restart, counted for each such"
                    raise DiagramError(what, where, "let fewer of the diagrams within one another restart")
        else:
            item = self.block(member(form, "block", dict, where), where)
        rate = member(form, "rate", list, where, [1, 0])
        if len(rate) != 2 or not all(type(r) is int for r in rate):
            raise DiagramError(f"rate {shown(rate)}", where, "write [divider, offset]")
        bound = member(form, "params", dict, where, {})
        if not all(isinstance(v, str) for v in bound.values()):
            raise DiagramError("params binds something that is not a name", where, 'write {"inner": "outer"}')
        position = form.get("position")
        d.add(
            name,
            item,
            rate=(rate[0], rate[1]),
            params=bound,
            enable=member(form, "enable", (str, type(None)), where),
            reset=member(form, "reset", (str, type(None)), where),
            trigger=member(form, "trigger", (str, type(None)), where),
            edge=member(form, "edge", str, where, "rising"),
            disabled=self._disabled(form, where),
            enabling=member(form, "enabling", str, where, "keep"),
            initial={n: self._plain(v, where) for n, v in member(form, "initial", dict, where, {}).items()},
            position=None if position is None else _position(position, where),
            inputs={},
        )
        d.parts[name].flipped = member(form, "flipped", bool, where, False)

    def _disabled(self, form: dict[str, Any], where: str) -> str | dict[str, Any]:
        told = member(form, "disabled", (str, dict), where, "hold")
        return {n: self._plain(v, where) for n, v in told.items()} if isinstance(told, dict) else told

    def block(self, form: dict[str, Any], where: str) -> Block:
        """Return the block that `form` describes, of the part at the path `where`. Raises DiagramError."""
        kind = member(form, "type", str, where)
        if kind == "custom":
            block: Block = self._custom(form, where)
        elif kind == MACHINE:
            block = self._machine(form, where)
        elif kind in REGISTRY:
            only(form, {"type", "config"}, where)
            config = self._plain(member(form, "config", dict, where, {}), where)
            try:
                block = REGISTRY[kind](**config)
                declared: list[Any] = [*block.inputs, *block.outputs, *block.states, *block.params, *block.derived]
                self._count(len(declared), sum(item.width or 1 for item in declared), where)
                with at_most(2 * MAX_SIZE):
                    _ = block.trace
            except TwodofError as error:
                argument = error.where.partition(".")[2]
                place = f"{where}.{argument}" if argument in config else where
                raise DiagramError(error.what, place, error.remedy) from error
            except (TypeError, ValueError, ArithmeticError, LookupError) as error:
                problem = f"{kind} cannot be made: {error!s:.200}"
                raise DiagramError(problem, where, "see docs/reference/blocks.md") from error
            for item in declared:
                _visible(item.unit, getattr(item, "text", ""), where)
        else:
            known = nearest(kind, REGISTRY, most=5)
            remedy = f"there are those of {library.__name__}: {known}"
            raise DiagramError(f"unknown block type {shown(kind)}", where, remedy)
        with located(where):
            self._measure(block)
        return block

    def _custom(self, form: dict[str, Any], where: str) -> TracedBlock:
        only(form, _CUSTOM | _SECTIONS, where)
        kinds: dict[str, type] = {"inputs": Port, "outputs": Port, "states": State, "params": Param, "derived": Port}
        declared = {k: self._declarations(cls, form, k, where) for k, cls in kinds.items()}
        crossing = member(form, "crossing", bool, where, False)
        block = TracedBlock(member(form, "name", str, where), declared, crossing)
        graph_from_json(block, form, where)
        return block

    def _machine(self, form: dict[str, Any], where: str) -> TracedMachine:
        only(form, _MACHINE, where)
        kinds = dict(zip(MACHINE_SECTIONS, (Port, Port, State, Param, Port), strict=True))
        declared = {k: self._declarations(cls, form, k, where) for k, cls in kinds.items()}
        crossing = member(form, "crossing", bool, where, False)
        machine = TracedMachine(member(form, "name", str, where), declared, crossing)
        machine_from_json(machine, form, where)
        try:
            with at_most(2 * MAX_SIZE):
                _ = machine.trace
        except TwodofError as error:
            raise DiagramError(error.what, f"{where}, {error.where}", error.remedy) from error
        own = machine.states[len(machine.variables) :]
        self._count(len(own), len(own), where)
        return machine

    def _measure(self, block: Block) -> None:
        """Count what a block adds to what is compiled and to what a step computes, at any rates."""
        t = block.trace
        # Port by port, since each may be computed on its own.
        outputs = [self.meter.measure([e]) for e in t.outputs.values()]
        edges = [self.meter.measure(pair) for pair in t.edges.values()]
        once = [self.meter.measure(t.update.values()), self.meter.measure(t.project.values())]
        slope, prepare = self.meter.measure(t.derivative.values()), self.meter.measure(t.prepare.values())
        arrays: list[Any] = [*block.outputs, *block.states]
        copied = sum((item.width or 0) // COPIED for item in arrays)
        moving = any(s.continuous for s in block.states)
        self.tick += copied + sum(e.operations for e in [*outputs, *edges, *once])
        self.stage += slope.operations
        if moving or not block.states:  # what an integration may evaluate anew
            self.stage += sum(e.operations for e in outputs)
        self.integrates = self.integrates or moving
        self.edges += len(edges)
        self.prepared += prepare.operations
        self.size += sum(e.size for e in [*outputs, *edges, *once, slope, prepare])
        if self.size > MAX_SIZE:
            raise too_large()
        step = self.tick + (STAGES * (self.edges + 1) * self.stage if self.integrates else 0)
        if max(step, self.prepared) > MAX_OPERATIONS:
            raise DiagramError(
                f"a step of more than {MAX_OPERATIONS} operations (of an integration {STAGES} times those of its "
                "derivatives for each edge inside the step)",
                "",
                "make loops and arrays shorter",
            )

    def _declarations(self, cls: type[Any], data: dict[str, Any], key: str, where: str) -> list[Any]:
        forms = member(data, key, list, where, [])
        if self.declared + len(forms) > MAX_DECLARED:  # before the first is made, which costs more than reading them
            self._count(len(forms), 0, where)
        return [self._declaration(cls, form, where) for form in forms]

    def _declaration(self, cls: type[Any], form: Any, where: str) -> Any:
        if not isinstance(form, dict) or not set(form) <= _FIELDS[cls]:
            known = ", ".join(sorted(_FIELDS[cls]))
            raise DiagramError(f"{shown(form)} is no {cls.__name__.lower()}", where, f"it may have {known}")
        width = form.get("width")
        if width is not None and (type(width) is not int or width < 1):
            raise DiagramError(f"width {shown(width)}", where, "give an integer from 1, or leave it out")
        elements = width or 1
        if form.get("shape") is not None:
            rows, columns = check_shape(form["shape"], where)
            elements = rows * columns
        self._count(1, elements, where)
        values = {k: self._plain(v, where) if k in _NUMBERS else v for k, v in form.items()}
        return _typed(cls, values, where)

    def _count(self, declared: int, elements: int, where: str) -> None:
        self.declared += declared
        self.elements += elements
        if self.declared > MAX_DECLARED:
            raise DiagramError(f"more than {MAX_DECLARED} ports, states and parameters", where, "use arrays")
        if self.elements > MAX_ELEMENTS:
            raise DiagramError(f"more than {MAX_ELEMENTS} values", where, "make arrays and delays shorter")

    def _plain(self, value: Any, where: str, depth: int = 0, lists: int = 0) -> Any:
        """Return a value of a block's arguments with infinities and NaN decoded; count its numbers."""
        if isinstance(value, dict) and set(value) == {"float"} and value["float"] in ("inf", "-inf", "nan"):
            return float(value["float"])
        if isinstance(value, (dict, list)):
            if lists > MAX_LIST_DEPTH or depth > MAX_PLAIN_DEPTH:
                raise DiagramError(f"lists within more than {MAX_LIST_DEPTH} lists", where, "write a number or a table")
            if isinstance(value, dict):
                return {k: self._plain(v, where, depth + 1, lists) for k, v in value.items()}
            self.numbers += len(value)
            if self.numbers > MAX_NUMBERS:
                raise DiagramError(f"more than {MAX_NUMBERS} numbers written out", where, "make tables shorter")
            return [self._plain(v, where, depth + 1, lists + 1) for v in value]
        return text(value, MAX_STRING, where) if isinstance(value, str) else value


def _position(given: Any, where: str) -> tuple[float, float]:
    """[x, y] as numbers. Raises DiagramError for anything else, and for what is far off."""
    good = isinstance(given, list) and len(given) == 2 and all(type(c) in (int, float) for c in given)
    if not good or any(abs(c) > 1e6 for c in given):
        raise DiagramError(f"position {shown(given)}", where, "write [x, y], each within +-1e6")
    return float(given[0]), float(given[1])


def _positions(data: Mapping[str, Any], key: str, known: Container[str], where: str) -> dict[str, tuple[float, float]]:
    """Return the places of inputs or outputs, by name. Raises DiagramError for a name that is not there."""
    given = member(data, key, dict, where, {})
    for name in given:
        if name not in known:
            raise DiagramError(f"{key!r} has {shown(name)}, which is not there", where, "take it out of the file")
    return {name: _position(at, f"{where}.{name}") for name, at in given.items()}


_NUMBERS = ("initial", "value", "low", "high", "enum")
_PLAIN_FIELDS: dict[str, type] = {"name": str, "unit": str, "text": str, "tunable": bool, "continuous": bool}


def _typed(cls: type, given: Mapping[str, Any], where: str) -> Any:
    if "name" not in given:
        raise DiagramError("a declaration has no name", where, "name it")
    for key, kind in _PLAIN_FIELDS.items():  # the declaration itself checks its type, width, bounds and numbers
        if key in given and not isinstance(given[key], kind):
            raise DiagramError(f"{key!r} is {shown(given[key])}", where, "see docs/reference/diagram-files.md")
    _visible(given.get("unit", ""), given.get("text", ""), where)
    name = given["name"] if NAME.fullmatch(given["name"]) else ""
    with located(f"{where}.{name}".rstrip(".")):
        return cls(**given)


def _visible(unit: str, remark: str, where: str) -> None:
    """Raise DiagramError for a unit or a remark that is too long or not what it looks like."""
    text(remark, MAX_TEXT, where, lines=True)
    if unicodedata.normalize("NFKC", text(unit, MAX_UNIT, where)) != unit:
        raise DiagramError(f"the unit {shown(unit)}", where, "write it in its usual characters (Unicode's form NFKC)")
