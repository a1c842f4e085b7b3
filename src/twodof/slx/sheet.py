"""A system of a Simulink model as the import asks it again and again: what drives a pin, and what stands behind one.

Types that a block inherits from behind, and the widths of ports that say none, are those that the blocks behind want.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.bus import Bus
from twodof.blocks.declarations import Port
from twodof.errors import DiagramError
from twodof.slx.data_types import field_name
from twodof.slx.matlab.function_block import last_index
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import NotComputed, Value, as_array, number
from twodof.slx.model import Pin, SimulinkBlock, SimulinkChart, System, below, collapsed, port_number
from twodof.slx.translation import Signal

KEEPS_TYPE = (
    *("Abs", "Bias", "Delay", "Gain", "Logic", "Memory", "Merge", "MinMax", "RateTransition", "Saturate", "Sum"),
    *("SignalConversion", "SignalSpecification", "Switch", "UnaryMinus", "UnitDelay", "ZeroOrderHold"),
)
"""Types of blocks whose output has the type of what they combine."""
KEEPS_WIDTH = (
    *(*KEEPS_TYPE, "DataTypeConversion", "DeadZone", "Derivative", "DiscreteIntegrator", "Integrator", "Product"),
    *("Quantizer", "RateLimiter", "Reshape", "Signum", "TransferFcn", "TransportDelay", "Trigonometry"),
)
"""Types of blocks whose output is as wide as their inputs."""
_JOINS = ("Concatenate", "Mux")
"""Types of blocks that want one type of all their inputs, side by side."""
_SIZED = {"CombinatorialLogic": ("TruthTable", "zeros(8, 2)"), "DiscreteStateSpace": ("B", "1"), "Gain": ("Gain", "1"),
          "StateSpace": ("B", "1")}  # fmt: skip
"""Types of blocks whose parameter says how wide their input is, with its default."""
BACKWARDS = "Inherit: Inherit via back propagation"
_TEXTS = {"real": "double", "float32": "single", "bool": "boolean", "float64": "uint64"}


class Sheet:
    """A system with what is asked of it again and again: what drives a pin, who has a port's number, or a tag."""

    def __init__(self, system: System, names: dict[str, Value], owner: tuple[str, str] | None) -> None:
        self.system, self.names, self.owner = system, names, owner
        self.diagram = Diagram("sheet")
        self.parts: dict[str, str] = {}
        self.helpers: dict[str, str] = {}
        self.sources: dict[Pin, Pin] = {}
        self.sinks: dict[Pin, list[Pin]] = {}
        self.inputs: dict[str, int] = {}
        for line in system.lines:
            for pin in line.wire.sinks():
                if pin.kind == "in":
                    self.inputs[pin.sid] = max(self.inputs.get(pin.sid, 0), pin.number)
                if line.source is not None:
                    self.sources[pin] = line.source
                    self.sinks.setdefault(line.source, []).append(pin)
        self.labels = {line.source: line.name for line in system.lines if line.source is not None and line.name}
        for sid, block in system.blocks.items():
            for output, name in block.signals.items():
                self.labels.setdefault(Pin(sid, "out", output), name)
        self.ports: dict[tuple[str, int], str] = {}
        self.tagged: dict[tuple[str, str], list[str]] = {}
        for sid, block in system.blocks.items():
            if block.type in ("Inport", "Outport"):
                self.ports[block.type, port_number(block)] = sid
            elif block.type in ("Goto", "From", "GotoTagVisibility") and not block.commented:
                self.tagged.setdefault((block.type, block.values.get("GotoTag", "A")), []).append(sid)


Sheets = Mapping[str, Sheet]
"""The systems of a model by path."""


def ends(sheets: Sheets, path: str, pin: Pin, depth: int = 0) -> Iterator[tuple[str, Pin, SimulinkBlock]]:
    """Yield the blocks that an output drives, with the pins, through Goto and From, into subsystems and out of them."""
    sheet = sheets[path]
    for sink in sheet.sinks.get(pin, ()) if depth < 20 else ():
        block = sheet.system.blocks.get(sink.sid)
        if block is None or sink.kind != "in" or block.commented:
            continue
        inner = below(path, block)
        port = sheets[inner].ports.get(("Inport", sink.number)) if inner in sheets else None
        if block.type == "Goto":
            tag, local = block.values.get("GotoTag", "A"), block.values.get("TagVisibility", "local") == "local"
            for at in [path] if local else sheets:
                for one in sheets[at].tagged.get(("From", tag), []):
                    yield from ends(sheets, at, Pin(one, "out", 1), depth + 1)
        elif port is not None:
            yield inner, Pin(port, "in", 1), sheets[inner].system.blocks[port]
            yield from ends(sheets, inner, Pin(port, "out", 1), depth + 1)
        else:
            yield path, sink, block
            if block.type == "Outport" and sheet.owner is not None:
                outer = Pin(sheet.owner[1], "out", port_number(block))
                yield from ends(sheets, sheet.owner[0], outer, depth + 1)


def width_wanted(
    sheets: Sheets,
    path: str,
    sid: str,
    code: Mapping[str, SimulinkChart],
    folders: Sequence[Path],
    hops: int = 10,
    output: int = 1,
) -> int:
    """Return how many elements the blocks behind an output want; 1 where none says it. `code` are MATLAB Functions.

    Behind at most `hops` blocks that are as wide as their inputs, if no scalar meets a vector there.
    """
    most = 1
    for at, pin, block in ends(sheets, path, Pin(sid, "out", output)):
        wanted = 1
        if block.type == "Demux":
            said = block.values.get("Outputs", "4")
            wanted = block.ports[1] if block.ports and said.isdigit() else int(said) if said.isdigit() else 1
        elif block.type == "Selector":
            said = block.values.get("InputPortWidth", "1")
            wanted = int(said) if said.isdigit() else 1
        elif block.type in _SIZED and (
            block.type != "Gain" or block.values.get("Multiplication", "").startswith("Matrix(K*u)")
        ):
            name, default = _SIZED[block.type]
            with suppress(DiagramError, NotComputed):
                found = as_array(number(evaluate(block.values.get(name, default), sheets[at].names, name)))
                wanted = found.shape[0].bit_length() - 1 if name == "TruthTable" else found.shape[1]
        elif block.type in KEEPS_WIDTH and hops and pin.number in _data(sheets[at], pin, block):
            wanted = width_wanted(sheets, at, pin.sid, code, folders, hops - 1)
        elif (one := code.get(below(at, block))) is not None:
            with suppress(DiagramError, NotComputed):
                size = argument(one, block, pin.number).get("props/array/size", "-1")
                wanted = int(np.prod(np.abs(as_array(evaluate(size, sheets[at].names, "size")))))
            if wanted == 1 and one.function:
                wanted = last_index(one.text, pin.number, folders)
        most = max(most, wanted)
    return most


def argument(chart: SimulinkChart, block: SimulinkBlock, number: int) -> Mapping[str, Any]:
    """Return what a chart or a MATLAB Function declares of its input of this number."""
    ports = block.system.blocks.values() if block.system is not None else ()
    name = next((collapsed(one.name) for one in ports if one.type == "Inport" and port_number(one) == number), "")
    data = [one for one in (chart.form or {}).get("inside", ()) if one["tag"] == "data" and one["name"] == name]
    return next((one["values"] for one in data if one["values"].get("scope") == "INPUT_DATA"), {})


def bus_wanted(
    sheets: Sheets, path: str, sid: str, code: Mapping[str, SimulinkChart], folders: Sequence[Path]
) -> Bus | None:
    """Return the bus of doubles with the elements that Bus Selectors behind an output take; None without one."""
    tree: dict[str, Any] = {}
    for at, pin, block in ends(sheets, path, Pin(sid, "out", 1)):
        taken = block.values.get("OutputSignals", "").split(",") if block.type == "BusSelector" else []
        for k, text in enumerate(filter(None, taken), start=1):
            *outer, last = [field_name(part) for part in text.split(".")]
            inner = tree
            for name in outer:
                if not isinstance(inner.setdefault(name, {}), dict):
                    inner[name] = {}  # selected whole, and by its elements
                inner = inner[name]
            inner.setdefault(last, width_wanted(sheets, at, pin.sid, code, folders, output=k))
    return _bus("bus", tree) if tree else None


def _bus(name: str, tree: Mapping[str, Any]) -> Bus:
    """Return the bus of a tree of names, whose leaves are widths."""
    ports = [
        Port(one, _bus(one, below)) if isinstance(below, Mapping) else Port(one, width=below if below > 1 else None)
        for one, below in tree.items()
    ]
    return Bus(name, ports)


def _data(sheet: Sheet, pin: Pin, block: SimulinkBlock) -> Sequence[int]:
    """Return the numbers of the inputs of a block that hold what it passes on."""
    return [1, 3] if block.type == "Switch" else range(1, sheet.inputs.get(pin.sid, 1) + 1)


def siblings(sheets: Sheets, path: str, sid: str, depth: int = 0) -> Iterator[tuple[str, Pin]]:
    """Yield the other inputs of the blocks behind an output that want one type of all their inputs."""
    for at, pin, block in ends(sheets, path, Pin(sid, "out", 1)):
        if block.type == "BusAssignment" and pin.number > 1:
            yield at, Pin(pin.sid, "in", 1)
        elif block.type in ("RelationalOperator", "Product", *_JOINS, *KEEPS_TYPE):
            data = _data(sheets[at], pin, block)
            if pin.number in data:
                yield from ((at, Pin(pin.sid, "in", k)) for k in data if k != pin.number)
            if (len(data) == 1 or block.type in _JOINS) and depth < 20:
                yield from siblings(sheets, at, pin.sid, depth + 1)


def type_declared(
    sheets: Sheets,
    path: str,
    sid: str,
    code: Mapping[str, SimulinkChart],
    known: Callable[[str, Pin], Signal | None] = lambda at, pin: None,
    depth: int = 0,
) -> str:
    """Return the data type that a port, a chart or the element of a bus behind an output declares; "" without one.

    `known` has the types of pins that are known already.
    """
    for at, pin, block in ends(sheets, path, Pin(sid, "out", 1)) if depth < 5 else ():
        found, said = "", collapsed(block.values.get("OutDataTypeStr", ""))
        initial = block.type == "DiscreteIntegrator" and pin.number > 1
        if (block.type in ("Inport", "Outport") or initial) and not said.startswith("Inherit"):
            found = said
        elif block.type == "BusCreator" and said.startswith("Bus:"):
            bus = sheets[at].names.get(said.partition(":")[2].strip())
            elements = bus.get("Elements", []) if isinstance(bus, Mapping) else []
            if isinstance(elements, list) and pin.number <= len(elements):
                found = str(elements[pin.number - 1].get("DataType", ""))
        elif block.type == "BusAssignment" and pin.number > 1:
            whole, names = known(at, Pin(pin.sid, "in", 1)), block.values.get("AssignedSignals", "").split(",")
            leaves = whole.kind.leaves if whole is not None and isinstance(whole.kind, Bus) else ()
            place = ".".join(map(field_name, names[pin.number - 2].split("."))) if pin.number - 2 < len(names) else ""
            found = next((type_text(Signal(one.kind)) for one in leaves if one.name == place), "")
        elif block.type in (*KEEPS_TYPE, *_JOINS, "Reshape") and (block.type != "Switch" or pin.number != 2):
            found = type_declared(sheets, at, pin.sid, code, known, depth + 1)
        elif (one := code.get(below(at, block))) is not None:
            said = argument(one, block, pin.number).get("dataType", "Inherit")
            found = "" if said.startswith("Inherit") else said
        if found:
            return found
    return ""


def type_text(signal: Signal) -> str:
    """Return the data type of a signal as a file writes it."""
    return (
        f"Bus: {signal.kind.name}" if isinstance(signal.kind, Bus) else _TEXTS.get(str(signal.kind), str(signal.kind))
    )
