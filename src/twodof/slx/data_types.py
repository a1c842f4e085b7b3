"""Data types of Simulink as kinds of the block language, and the blocks that make, split and change buses.

A type is named by a text: `single`, `Bus: Sensors`, `Enum: Mode`, `fixdt(1,16,0)`, or the name of an alias. Buses and
aliases are values of the workspace. An enumeration is the int32 of its members.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block, Clock
from twodof.blocks.bus import Bus
from twodof.blocks.declarations import Port
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.arrays import matrix, vector
from twodof.blocks.library import BusAssign, BusCreate, BusSelect
from twodof.errors import DiagramError
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import NotComputed, Value, as_array, number
from twodof.slx.model import collapsed
from twodof.slx.translation import TYPES, Asked, Made, NotTranslated, Rule, Signal, plain

_FIXED = re.compile(r"(?:fixdt\(([01]),(8|16|32)(?:,0)?\)|([us])fix(8|16|32))")
SINGLE = "(single)"
"""A name that no script gives: where a workspace has it, single is float32, and not the build's precision."""
DEEPEST = 8
"""Types that name one another: buses in buses, and aliases of aliases."""


def kind_of(said: str, names: Mapping[str, Value], depth: int = 0) -> Kind:
    """Return the kind of a data type by its text. Raises NotTranslated for a type that has none."""
    text = collapsed(said)
    if text == "single" and SINGLE in names:
        return "float32"
    if text in TYPES:
        return TYPES[text]
    prefix, _, name = text.rpartition(":")
    name = name.strip()
    found = _FIXED.fullmatch(text.replace(" ", ""))
    if found is not None:
        unsigned = found[1] == "0" or found[3] == "u"
        return f"{'u' * unsigned}int{found[2] or found[4]}"
    if prefix == "Enum":
        return "int32"
    given = names.get(name)
    if depth > DEEPEST:
        raise NotTranslated(f"the type {name} is nested more than {DEEPEST} deep")
    if isinstance(given, Mapping) and isinstance(given.get("BaseType"), str):
        return kind_of(given["BaseType"], names, depth + 1)
    if isinstance(given, Mapping) and "Elements" in given:
        return _bus(name, given["Elements"], names, depth)
    if isinstance(given, Mapping) and given.get("DataTypeMode") in ("Double", "Single", "Boolean"):
        return kind_of(given["DataTypeMode"].lower(), names, depth + 1)
    if prefix == "Bus":
        raise NotTranslated(f"the bus {name} has no value: give it by --workspace, or its data dictionary by --path")
    raise NotTranslated(f"the data type {text!r} is not translated")


def _bus(name: str, elements: Any, names: Mapping[str, Value], depth: int) -> Bus:
    fields = []
    for one in elements if isinstance(elements, list) else [elements]:
        try:
            size = one.get("Dimensions", np.ones((1, 1)))
            size = as_array(number(evaluate(size, names) if isinstance(size, str) else size)).flatten()
            kind = kind_of(one.get("DataType", "double"), names, depth + 1)
            fields.append(sized(kind, [int(n) for n in size]).port(field_name(one["Name"])))
        except (DiagramError, NotComputed, KeyError, AttributeError, ValueError) as reason:
            raise NotTranslated(f"the bus {name}: {reason}") from None
    try:
        return Bus(field_name(name), fields)
    except DiagramError as reason:
        raise NotTranslated(f"the bus {name}: {reason.what}") from None


def field_name(name: str) -> str:
    """Return the legal name of a bus's element."""
    return re.sub(r"^(?![A-Za-z])", "b", re.sub(r"\W+", "_", collapsed(name), flags=re.ASCII))[:63]


def sized(kind: Kind, dimensions: list[int]) -> Signal:
    """Return the signal with these dimensions: 1 is a scalar, n or [n, 1] a vector, [r, c] a matrix."""
    many = [n for n in dimensions if n != 1]
    if len(dimensions) > 2 or any(n < 1 for n in dimensions):
        raise NotTranslated(f"the dimensions {dimensions} are not translated")
    if len(many) == 2:
        return Signal(kind, many[0] * many[1], (many[0], many[1]))
    return Signal(kind, many[0] if many else None)


def value_of(value: Value, signal: Signal) -> Any:
    """Return a number, an array or a structure as the parameter of a signal.

    Raises NotTranslated if it does not fit.
    """
    value = number(value)
    if isinstance(signal.kind, Bus):
        if isinstance(value, np.ndarray) and value.size == 1 and not value.any():
            return 0
        if signal.width is not None:
            values = value if isinstance(value, list) else [value] * signal.width
            if len(values) != signal.width:
                raise NotTranslated(f"{len(values)} structures are given for {signal.width} buses")
            return [value_of(one, Signal(signal.kind)) for one in values]
        if not isinstance(value, Mapping):
            raise NotTranslated("a structure is expected for a bus")
        given = {field_name(name): one for name, one in value.items()}
        made = {}
        for port in signal.kind.fields:
            if port.name not in given:
                raise NotTranslated(f"the structure has no field {port.name}")
            made[port.name] = value_of(given[port.name], signal_of(port))
        return made
    if not isinstance(value, np.ndarray):
        raise NotTranslated("a number is expected")
    if value.size == 1:
        one = plain(value.flat[0], signal.kind)
        wide = one if signal.width is None else [one] * signal.width
        return wide if signal.shape is None else [[one] * signal.shape[1]] * signal.shape[0]
    if value.size != (signal.width or 1):
        raise NotTranslated(f"{value.size} numbers are given for {signal.width or 1}")
    if signal.shape is None:
        return [plain(v, signal.kind) for v in value.flatten(order="F")]
    return [[plain(v, signal.kind) for v in row] for row in value.reshape(signal.shape, order="F")]


def signal_of(port: Port) -> Signal:
    """Return the type of a port."""
    return Signal(port.kind, port.width, port.shape)


# --- blocks


def _creator(c: Asked) -> Made:
    """Make a bus of the inputs: with the object's fields in their order, else with the names of the lines."""
    said = c.text("OutDataTypeStr", c.text("BusObject", "") if c.text("UseBusObject", "off") == "on" else "")
    if not said or said.startswith("Inherit"):
        text = c.values.get("Inputs", "4")
        given = re.findall(r"[^,']+", text) if not text.strip().isdigit() else []
        labels = [given[k].strip() if k < len(given) else label for k, label in enumerate(c.labels)]
        labels = [f"{one} (signal {k})" if labels.count(one) > 1 else one for k, one in enumerate(labels, start=1)]
        named = [field_name(label or f"signal{k + 1}") for k, label in enumerate(labels)]
        bus = Bus("bus", [one.port(name) for name, one in zip(named, c.inputs, strict=True)])
    else:
        kind = kind_of(said if ":" in said else f"Bus: {said}", c.names)
        if not isinstance(kind, Bus) or len(kind.fields) != len(c.inputs):
            raise NotTranslated(f"{said} does not have {len(c.inputs)} elements")
        bus = kind
        for k, (port, one) in enumerate(zip(bus.fields, c.inputs, strict=True)):
            if k + 1 not in c.loose and not signal_of(port).like(one):
                raise NotTranslated(f"the element {port.name} is {signal_of(port)} and the input {k + 1} {one}")
    return Made(BusCreate(bus), [Signal(bus)])


def _fields(c: Asked, parameter: str, bus: Bus) -> dict[str, Signal]:
    """Return the fields that a parameter names, by path, with their types."""
    found: dict[str, Signal] = {}
    for text in c.values.get(parameter, "").split(","):
        path = [field_name(part) for part in text.split(".")]
        at = Signal(bus)
        for name in path:
            ports = at.kind.fields if isinstance(at.kind, Bus) else ()
            port = next((one for one in ports if one.name == name), None)
            if port is None:
                raise NotTranslated(f"{parameter}: the bus {bus.name} has no element {text.strip()}")
            at = signal_of(port)
        found[".".join(path)] = at
    return found


def _selector(c: Asked) -> Made:
    bus = _only_bus(c)
    fields = _fields(c, "OutputSignals", bus)
    select = BusSelect(bus, list(fields))
    if c.text("OutputAsBus", "off") != "on":
        return Made(select, list(fields.values()))
    made = Bus("bus", [one.port(path.rpartition(".")[2]) for path, one in fields.items()])
    d = Diagram("selected")
    d.input("bus", bus)
    d.add("fields", select, bus="bus")
    d.add("y", BusCreate(made))
    for path, port in zip(fields, made.fields, strict=True):
        d.connect(f"fields.{path.replace('.', '_')}", f"y.{port.name}")
    d.output("y", "y")
    return Made(d, [Signal(made)])


def _assignment(c: Asked) -> Made:
    bus = _only_bus(c)
    fields = _fields(c, "AssignedSignals", bus)
    for k, ((path, wanted), one) in enumerate(zip(fields.items(), c.inputs[1:], strict=False), start=2):
        if k not in c.loose and not wanted.like(one):
            raise NotTranslated(f"the element {path} is {wanted} and its input {one}")
    return Made(BusAssign(bus, list(fields)), [Signal(bus)])


def _only_bus(c: Asked) -> Bus:
    one = c.inputs[0]
    if not isinstance(one.kind, Bus) or one.width is not None:
        raise NotTranslated(
            f"its input is {one}, not a bus: give the bus object's type to the Inport that it comes from"
        )
    return one.kind


class BusArray(Block):
    """y = [u1, u2, ...]: an array of buses."""

    def __init__(self, bus: Bus, count: int) -> None:
        self.bus, self.names = bus, [f"u{k}" for k in range(1, count + 1)]
        self.inputs = [Port(name, bus) for name in self.names]
        self.outputs = [Port("y", bus, count)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Join the buses field by field."""
        return self._joined(self.bus, [u[name] for name in self.names])

    def _joined(self, bus: Any, given: list[Any]) -> Any:
        parts = {one.name: (one, [view[one.name] for view in given]) for one in bus.fields}
        return {
            name: self._joined(one.kind, many)
            if isinstance(one.kind, Bus)
            else (vector if one.width is None else matrix)(many)
            for name, (one, many) in parts.items()
        }


def bus_array(c: Asked) -> Made:
    """Return the array of buses of one type."""
    one, bus = c.inputs[0], _only_bus(c)
    if not all(one.like(other) for other in c.inputs) or any(leaf.shape is not None for leaf in bus.leaves):
        raise NotTranslated("its inputs are buses of other types, or hold matrices")
    return Made(BusArray(bus, len(c.inputs)), [Signal(bus, len(c.inputs))])


class BusParts(Block):
    """y1, y2, ... are the elements of the array of buses u."""

    def __init__(self, bus: Bus, count: int) -> None:
        self.bus, self.names = bus, [f"y{k}" for k in range(1, count + 1)]
        self.inputs = [Port("u", bus, count)]
        self.outputs = [Port(name, bus) for name in self.names]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Take the buses apart field by field."""
        return {name: self._part(self.bus, u.u, k) for k, name in enumerate(self.names)}

    def _part(self, bus: Any, view: Any, place: int) -> Any:
        return {
            one.name: self._part(one.kind, view[one.name], place)
            if isinstance(one.kind, Bus)
            else view[one.name][place]
            for one in bus.fields
        }


def bus_parts(c: Asked) -> Made:
    """Return the elements of an array of buses, one an output."""
    one = c.inputs[0]
    if not isinstance(one.kind, Bus) or one.width != int(c.scalar("Outputs", "4")):
        raise NotTranslated(f"an input that is {one} is not translated")
    return Made(BusParts(one.kind, one.width), [Signal(one.kind)] * one.width)


BUS_RULES: dict[str, Rule] = {"BusAssignment": _assignment, "BusCreator": _creator, "BusSelector": _selector}
"""Rules of the blocks of buses."""


def in_single(signal: Signal) -> Signal:
    """Return the signal whose doubles are single."""
    if isinstance(signal.kind, Bus):
        fields = [in_single(signal_of(one)).port(one.name) for one in signal.kind.fields]
        return replace(signal, kind=Bus(signal.kind.name, fields))
    return replace(signal, kind="float32") if signal.kind == "real" else signal
