"""Builds a diagram from its JSON form and refuses, at the door, what would cost too much or is not what it says."""

import math
import unicodedata
from collections import Counter
from collections.abc import Container, Mapping
from dataclasses import fields
from types import NoneType
from typing import Any

from twodof.blocks import library
from twodof.blocks.block import REGISTRY, Block
from twodof.blocks.declarations import NAME, Param, Port, State, located
from twodof.blocks.diagram import CONDITIONS, Diagram
from twodof.blocks.expressions.expr import at_most
from twodof.blocks.expressions.graph import COPIED, MAX_OPERATIONS, MAX_SIZE, CostMeter, too_large
from twodof.blocks.schema.traced_block import (
    Fields,
    TracedBlock,
    TracedMachine,
    graph_from_json,
    machine_from_json,
    member,
    position,
    read,
)
from twodof.blocks.trace import SECTIONS
from twodof.errors import DiagramError, TwodofError, nearest, shown

MAX_DEPTH = 64  # of sub-diagrams
MAX_PARTS = 10_000
MAX_DECLARED = 100_000  # inputs, outputs, states and parameters of all parts
MAX_ELEMENTS = 1_000_000  # of their arrays, all together
MAX_NUMBERS = 100_000  # written out: tables, initial values, arguments of blocks
MAX_LIST_DEPTH = 4
MAX_PLAIN_DEPTH = 16  # of lists and objects, as the values of buses in buses have
MAX_TEXT = 10_000  # characters
MAX_TEXTS = 100_000  # characters of guards and actions written as texts
MAX_UNIT = 40
MAX_STRING = 1000  # an argument of a block
STAGES = 4  # evaluations of a derivative in a step of RK4
_LIMITS: Mapping[str, tuple[int, str, str]] = {
    "parts": (MAX_PARTS, "parts", "make the diagram smaller"),
    "declared": (MAX_DECLARED, "ports, states and parameters", "use arrays"),
    "elements": (MAX_ELEMENTS, "values", "make arrays and delays shorter"),
    "numbers": (MAX_NUMBERS, "numbers written out", "make tables shorter"),
    "characters": (MAX_TEXTS, "characters of guards and actions", "use blocks or variables"),
    "restarting": (
        MAX_DECLARED,
        "ports and states in diagrams that restart, counted for each such",
        "let fewer of the diagrams within one another restart",
    ),
}
"""What a diagram has in all: the limit, its name in an error, and the remedy."""

POSITIONS = ("input_positions", "output_positions")
_NAME = (str, None)
_DIAGRAM: Fields = {
    "name": _NAME,
    "text": (str, ""),
    **dict.fromkeys(("inputs", "params", "parts", "connections", "outputs"), (list, [])),
    **dict.fromkeys(POSITIONS, (dict, {})),
}
SETTINGS: Fields = {
    "rate": (list, [1, 0]),
    "params": (dict, {}),
    **dict.fromkeys(CONDITIONS, ((str, NoneType), None)),
    "disabled": ((str, dict), "hold"),
    "edge": (str, "rising"),
    "enabling": (str, "keep"),
    "initial": (dict, {}),
    "position": ((list, NoneType), None),
    "flipped": (bool, False),
    "commented": (str, ""),
}
"""How a part runs and where it is drawn, in the order of a file."""
_PART: Fields = {"name": _NAME, **SETTINGS, **dict.fromkeys(("diagram", "block"), ((dict, NoneType), None))}
_LIBRARY: Fields = {"type": _NAME, "config": (dict, {})}
_TRACED: Fields = {"type": _NAME, "name": _NAME, "crossing": (bool, False), "nodes": (list, None)}
MACHINE = "state_machine"
DECLARED: Mapping[str, Mapping[str, type[Any]]] = {
    "custom": {"inputs": Port, "outputs": Port, "states": State, "params": Param, "derived": Port},
    MACHINE: {"inputs": Port, "outputs": Port, "variables": State, "params": Param, "derived": Port},
}
"""What a traced block declares, by its type and section."""
_GRAPHS: Mapping[str, Fields] = {
    "custom": dict.fromkeys(SECTIONS, (dict, {})),
    MACHINE: {"prepare": (dict, {}), "modes": (list, []), "transitions": (list, [])},
}
_WORDS: Fields = {"name": _NAME, **dict.fromkeys(("unit", "text"), (str, "")), "tunable": (bool, True)}
_PLAIN_FIELDS: Fields = {**_WORDS, "continuous": (bool, False)}
_FIELDS: Mapping[type, Fields] = {
    cls: {f.name: _PLAIN_FIELDS.get(f.name, (object, f.default)) for f in fields(cls)} for cls in (Port, State, Param)
}
_NUMBERS = ("initial", "value", "low", "high", "enum")


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
        self.counts = Counter[str]()
        self.size = self.prepared = self.tick = self.stage = self.edges = 0
        self.integrates = False
        self.meter = CostMeter()

    def diagram(self, data: dict[str, Any], path: str = "", depth: int = 0) -> Diagram:
        """Return the diagram that `data` describes, at `path` and `depth` within another one. Raises DiagramError."""
        if depth > MAX_DEPTH:
            raise DiagramError(f"sub-diagrams are nested more than {MAX_DEPTH} deep", path, "use fewer levels")
        given = read(data, "a diagram", _DIAGRAM, path or "diagram")
        d = Diagram(given["name"], text(given["text"], MAX_TEXT, path or "diagram", lines=True))
        path = path or d.name
        for port in self._declarations(Port, given["inputs"], path):
            d.declare(port)
        for param in self._declarations(Param, given["params"], path):
            d.param(**vars(param))
        self._count("parts", len(given["parts"]), path)  # before the first is made, which costs more than reading them
        for form in given["parts"]:
            self._part(d, form, path, depth)
        for pair in given["connections"]:
            if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(s, str) for s in pair)):
                raise DiagramError(f"{shown(pair)} is not a connection", path, 'write ["source", "part.port"]')
            d.connect(*pair)
        for pair in given["outputs"]:
            named = isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str)
            if not named or not isinstance(pair[1], (str, type(None))):
                raise DiagramError(f"{shown(pair)} is not an output", path, 'write ["name", "source"]')
            self._count("declared", 1, path)
            d.output(*pair)
        inputs = {name.partition(".")[0] for name in d.inputs}  # a bus has one place
        d.input_positions = _positions(given, "input_positions", inputs, path)
        d.output_positions = _positions(given, "output_positions", d.outputs, path)
        return d

    def _part(self, d: Diagram, form: Any, path: str, depth: int) -> None:
        named = isinstance(form, dict) and isinstance(form.get("name"), str)
        where = f"{path}.{form['name']:.80}" if named else path
        given = read(form, "a part", _PART, where)
        item: Block | Diagram
        if given["diagram"] is not None:
            before = self.counts["declared"]
            item = self.diagram(given["diagram"], where, depth + 1)
            if given["enabling"] == "restart":  # each such diagram sets the states of all that is inside
                self._count("restarting", self.counts["declared"] - before, where)
        else:
            item = self.block(member(form, "block", dict, where), where)
        if given["commented"] not in ("", "out", "through") or (given["commented"] and isinstance(item, Block)):
            raise DiagramError(
                f"commented: {shown(given['commented'])}", where, 'write "out" or "through", of a sub-diagram'
            )
        settings = {key: given[key] for key in SETTINGS if key not in ("flipped", "commented")}
        settings |= {key: self._plain(given[key], where) for key in ("initial", "disabled")}
        if given["position"] is not None:
            settings["position"] = position(given["position"], where)
        d.add(given["name"], item, inputs={}, **settings)
        part = d.parts[given["name"]]
        part.flipped, part.commented = given["flipped"], given["commented"]

    def block(self, form: dict[str, Any], where: str) -> Block:
        """Return the block that `form` describes, of the part at the path `where`. Raises DiagramError."""
        kind = member(form, "type", str, where)
        if kind in DECLARED:
            block = self._traced(kind, form, where)
        elif kind in REGISTRY:
            block = self._library(kind, form, where)
        else:
            known = nearest(kind, REGISTRY, most=5)
            remedy = f"there are those of {library.__name__}: {known}"
            raise DiagramError(f"unknown block type {shown(kind)}", where, remedy)
        with located(where):
            self._measure(block)
        return block

    def _library(self, kind: str, form: dict[str, Any], where: str) -> Block:
        config = self._plain(read(form, "a block", _LIBRARY, where)["config"], where)
        try:
            block = REGISTRY[kind](**config)
            declared: list[Any] = [*block.inputs, *block.outputs, *block.states, *block.params, *block.derived]
            self._count("declared", len(declared), where)
            self._count("elements", sum(item.width or 1 for item in declared), where)
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
        return block

    def _traced(self, kind: str, form: dict[str, Any], where: str) -> Block:
        sections = DECLARED[kind]
        given = read(form, "a block", {**_TRACED, **dict.fromkeys(sections, (list, [])), **_GRAPHS[kind]}, where)
        declared = {key: self._declarations(cls, given[key], where) for key, cls in sections.items()}
        if kind != MACHINE:
            block = TracedBlock(given["name"], declared, given["crossing"])
            graph_from_json(block, given, where)
            return block
        machine = TracedMachine(given["name"], declared, given["crossing"])
        machine_from_json(machine, given, where, lambda characters: self._count("characters", characters, ""))
        with located(where, keep=True), at_most(2 * MAX_SIZE):
            _ = machine.trace
        own = machine.states[len(machine.variables) :]
        self._count("declared", len(own), where)
        self._count("elements", len(own), where)
        return machine

    def _measure(self, block: Block) -> None:
        """Count the nodes and operations that a block adds to the program and to a step, at any rates."""
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
                f"a step of more than {MAX_OPERATIONS} operations (an integration counts {STAGES} times those of its "
                "derivatives for each edge inside the step)",
                "",
                "make loops and arrays shorter",
            )

    def _declarations(self, cls: type[Any], forms: list[Any], where: str) -> list[Any]:
        self._count("declared", len(forms), where)  # before the first is made, which costs more than reading them
        return [self._declaration(cls, form, where) for form in forms]

    def _declaration(self, cls: type[Any], form: Any, where: str) -> Any:
        given = read(form, f"a {cls.__name__.lower()}", _FIELDS[cls], where)
        shape = given["shape"]
        size = shape if isinstance(shape, list) and len(shape) == 2 else [given["width"]]  # others are refused below
        self._count("elements", math.prod(n for n in size if type(n) is int), where)
        given |= {key: self._plain(given[key], where) for key in _NUMBERS if key in given}
        _visible(given["unit"], given.get("text", ""), where)
        name = given["name"] if NAME.fullmatch(given["name"]) else ""
        with located(f"{where}.{name}".rstrip(".")):
            return cls(**given)

    def _count(self, what: str, number: int, where: str) -> None:
        """Add to a count of `_LIMITS`. Raises DiagramError beyond its limit."""
        self.counts[what] += number
        most, things, remedy = _LIMITS[what]
        if self.counts[what] > most:
            raise DiagramError(f"more than {most} {things}", where, remedy)

    def _plain(self, value: Any, where: str, depth: int = 0, lists: int = 0) -> Any:
        """Return a value of a block's arguments with infinities and NaN decoded; count its numbers."""
        if isinstance(value, dict) and set(value) == {"float"} and value["float"] in ("inf", "-inf", "nan"):
            return float(value["float"])
        if isinstance(value, (dict, list)):
            if lists > MAX_LIST_DEPTH or depth > MAX_PLAIN_DEPTH:
                raise DiagramError(f"lists within more than {MAX_LIST_DEPTH} lists", where, "write a number or a table")
            if isinstance(value, dict):
                return {k: self._plain(v, where, depth + 1, lists) for k, v in value.items()}
            self._count("numbers", len(value), where)
            return [self._plain(v, where, depth + 1, lists + 1) for v in value]
        return text(value, MAX_STRING, where) if isinstance(value, str) else value


def _positions(data: Mapping[str, Any], key: str, known: Container[str], where: str) -> dict[str, tuple[float, float]]:
    """Return the places of inputs or outputs, by name. Raises DiagramError for a name that is not there."""
    for name in data[key]:
        if name not in known:
            raise DiagramError(f"{key!r} has {shown(name)}, which is not there", where, "take it out of the file")
    return {name: position(at, f"{where}.{name}") for name, at in data[key].items()}


def _visible(unit: str, remark: str, where: str) -> None:
    """Raise DiagramError for a unit or a remark that is too long or not what it looks like."""
    text(remark, MAX_TEXT, where, lines=True)
    if unicodedata.normalize("NFKC", text(unit, MAX_UNIT, where)) != unit:
        raise DiagramError(f"the unit {shown(unit)}", where, "write it in its usual characters (Unicode's form NFKC)")
