"""Ports that Simulink draws otherwise: of single elements of a bus, and recorded data, which are inputs here.

Simulink draws one port of a subsystem as many blocks, each with the path of one element. The importer knows a port as
one block: here the blocks become selectors behind an Inport, or signals of a creator of buses in front of an Outport.
"""

from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import replace

import numpy as np

from twodof.blocks.bus import Bus
from twodof.slx.conditions import CONTROL_PORTS, ITERATED
from twodof.slx.data_types import field_name, kind_of
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import Value, as_array, scalar
from twodof.slx.model import Line, Pin, SimulinkBlock, System, Wire, port_number
from twodof.slx.network import Iteration
from twodof.slx.translation import NotTranslated


def with_bus_ports(system: System) -> System:
    """Return a system in which ports of elements are whole ports, with BusSelectors and BusCreators beside them."""
    groups: dict[tuple[str, int], list[SimulinkBlock]] = {}
    for block in system.blocks.values():
        if block.values.get("InterfaceIsComposite") == "1" and block.type in ("Inport", "Outport"):
            groups.setdefault((block.type, port_number(block)), []).append(block)
    if not groups:
        return system
    made = System(dict(system.blocks), list(system.lines))
    for (kind, number), ports in groups.items():
        first = ports[0].values
        sid = f"{kind} {number}"
        values = {key: text for key, text in first.items() if not key.startswith("Interface")}
        name = first.get("InterfacePortName", "") or ports[0].name
        made.blocks[sid] = SimulinkBlock(kind, name, sid, {**values, "Port": str(number)})
        for port in ports:
            element = port.values.get("InterfaceElement", "")
            selects = kind == "Inport" and element
            own = {"OutputSignals": element, "Position": port.values.get("Position", "")}
            made.blocks[port.sid] = replace(
                port,
                type="BusSelector" if selects else "SignalConversion",
                values=own,
                ports=(1, 1),
                signals={1: element.rpartition(".")[2]} if selects else port.signals,
            )
        if kind == "Inport":
            ways = [Wire([], Pin(port.sid, "in", 1), []) for port in ports]
            made.lines.append(Line("", Pin(sid, "out", 1), Wire([], None, ways)))
        else:
            paths = {port.values.get("InterfaceElement", ""): port.sid for port in ports}
            made.lines.append(_line("", _created(made, sid, paths), Pin(sid, "in", 1)))
    return made


def _created(system: System, prefix: str, elements: dict[str, str]) -> str:
    """Add creators of the bus with these elements, {path: block that gives it}, and return the outermost one."""
    if "" in elements:
        return elements[""]
    tops: dict[str, dict[str, str]] = {}
    for path, sid in elements.items():
        top, _, rest = path.partition(".")
        tops.setdefault(top, {})[rest] = sid
    creator = f"{prefix} bus"
    values = {"Inputs": str(len(tops)), "OutDataTypeStr": "Inherit: auto"}
    system.blocks[creator] = SimulinkBlock("BusCreator", f"{prefix} bus", creator, values, ports=(len(tops), 1))
    for number, (top, inside) in enumerate(tops.items(), start=1):
        source = _created(system, f"{prefix} {top}", inside)
        system.lines.append(_line(top, source, Pin(creator, "in", number)))
    return creator


def _line(name: str, source: str, sink: Pin) -> Line:
    return Line(name, Pin(source, "out", 1), Wire([], sink, []))


MOST_PARTS = 100
"""Most parts of a For Each."""


def with_each(
    system: System, names: Mapping[str, Value], around: System, block: SimulinkBlock
) -> tuple[System, list[str]]:
    """Return a system that holds what is inside a For Each once for each part of its inputs, and the copies' names.

    `block` is the For Each, in the system `around`. Raises NotTranslated for parts other than elements side by side,
    and where their number is neither written nor declared by the bus or port that drives them.
    """
    said = next(one.values.get("SpecifiedNumIters", "-1") for one in system.blocks.values() if one.type == "ForEach")
    count = int(scalar(evaluate(said, names, "SpecifiedNumIters")))
    parted = [one for one in system.blocks.values() if one.values.get("Partition", "off") == "on"]
    widths = [int(scalar(evaluate(one.values.get("PartitionWidth", "1"), names, one.name))) for one in parted]
    for one, width in zip(parted, widths, strict=True):
        gap = int(scalar(evaluate(one.values.get("PartitionOffset", "0"), names, one.name)))
        if width < 1 or gap:
            raise NotTranslated(f"{one.name}: parts {width} wide with a gap of {gap} are not translated")
    if count < 0:
        sizes = [_declared_width(around, Pin(block.sid, "in", port_number(one)), names) for one in parted]
        counts = {size / width for size, width in zip(sizes, widths, strict=True) if size}
        if len(counts) > 1 or not all(number.is_integer() for number in counts):
            raise NotTranslated("the inputs of the For Each do not divide into the same number of parts")
        count = int(next(iter(counts), 0))
    if not 0 < count <= MOST_PARTS:
        raise NotTranslated(f"a For Each with SpecifiedNumIters = {said} is not translated")
    inner = System({sid: block for sid, block in system.blocks.items() if block.type != "ForEach"}, system.lines)
    copies = [f"each {k}" for k in range(1, count + 1)]
    ports = [block for block in inner.blocks.values() if block.type in ("Inport", "Outport")]
    sides = [sum(one.type == kind for one in ports) for kind in ("Inport", "Outport")]
    made = System({sid: SimulinkBlock("SubSystem", sid, sid, {}, ports=(sides[0], sides[1])) for sid in copies}, [])
    for sid in copies:
        made.blocks[sid].system = inner
    for port in ports:
        number, middle = port_number(port), f"{port.sid} parts"
        made.blocks[port.sid] = SimulinkBlock(port.type, port.name, port.sid, {"Port": str(number)})
        if {port.values.get(f"{name}Dimension", "1") for name in ("Partition", "Concatenation")} != {"1"}:
            raise NotTranslated(f"{port.name}: parts along another dimension than the first are not translated")
        if port.type == "Outport":
            made.blocks[middle] = SimulinkBlock("Concatenate", middle, middle, {"Mode": "Vector"}, ports=(count, 1))
            made.lines.append(_line("", middle, Pin(port.sid, "in", 1)))
        elif port.values.get("Partition", "off") == "on":
            made.blocks[middle] = SimulinkBlock("Demux", middle, middle, {"Outputs": str(count)}, ports=(1, count))
            made.lines.append(_line("", port.sid, Pin(middle, "in", 1)))
        for k, sid in enumerate(copies, start=1):
            if port.type == "Outport":
                made.lines.append(Line("", Pin(sid, "out", number), Wire([], Pin(middle, "in", k), [])))
                continue
            source = Pin(middle, "out", k) if middle in made.blocks else Pin(port.sid, "out", 1)
            made.lines.append(Line("", source, Wire([], Pin(sid, "in", number), [])))
    return made, copies


def _declared_width(system: System, pin: Pin, names: Mapping[str, Value]) -> int:
    """Return how many elements an Inport, or the bus of one by a selector, declares to drive a pin; 0 where none."""
    source = next((line.source for line in system.lines if pin in line.wire.sinks()), None)
    block = None if source is None else system.blocks.get(source.sid)
    if source is None or block is None:
        return 0
    if block.type == "BusSelector":
        port = next((line.source for line in system.lines if Pin(block.sid, "in", 1) in line.wire.sinks()), None)
        said = system.blocks[port.sid].values.get("OutDataTypeStr", "") if port is not None else ""
        bus, name = kind_of(said, names) if said.startswith("Bus") else None, block.values.get("OutputSignals", "")
        fields = {one.name: one.width or 1 for one in bus.fields} if isinstance(bus, Bus) else {}
        return fields.get(field_name(name.split(",")[source.number - 1]), 0)
    said = block.values.get("PortDimensions", "-1") if block.type == "Inport" else "0"
    return max(int(np.prod(as_array(evaluate(said, names, "PortDimensions")))), 0)


MOST_TURNS = 1000
"""Most turns of a subsystem that is iterated: a number that is not written is bounded by it."""


def with_iterated(system: System, names: Mapping[str, Value]) -> tuple[System, Iteration]:
    """Return a system that holds what is inside a For or While Iterator as `turn`, and how that is iterated.

    Inside, the number of the turn is an input more; what the iterator reads are outputs more. Raises NotTranslated for
    an iterator whose next number is an input.
    """
    sid, block = next((sid, one) for sid, one in system.blocks.items() if one.type in ITERATED)
    said, loops = block.values, block.type == "WhileIterator"
    if any(one.type in CONTROL_PORTS for one in system.blocks.values()) or said.get("ExternalIncrement", "off") == "on":
        raise NotTranslated(
            f"a {block.type} beside a control port, or whose next number is an input, is not translated"
        )
    text, kind = ("MaxIters" if loops else "IterationLimit"), said.get("IterationVariableDataType", "int32")
    outside = not loops and said.get("IterationSource", "internal") == "external"
    count = MOST_TURNS if outside else int(scalar(evaluate(said.get(text, "5"), names, text)))
    most = min(count if count >= 0 else MOST_TURNS, {"int8": 127, "uint8": 255}.get(kind, MOST_TURNS))
    if not loops and not outside and most != count:
        raise NotTranslated(f"{count} turns of a ForIterator are more than {most}")
    ports = [one for one in system.blocks.values() if one.type in ("Inport", "Outport")]
    sides = [sum(one.type == side for one in ports) for side in ("Inport", "Outport")]
    extra = int(outside) if not loops else 2 - (said.get("WhileBlockType", "while") == "do-while")
    made = System(
        {one.sid: SimulinkBlock(one.type, one.name, one.sid, {"Port": str(port_number(one))}) for one in ports}, []
    )
    inner = System(dict(system.blocks), deepcopy(system.lines))
    inner.blocks[sid] = SimulinkBlock("Inport", block.name, sid, {"Port": str(sides[0] + 1)})
    for k in range(1, extra + 1):
        inner.blocks[f"{sid} {k}"] = SimulinkBlock(
            "Outport", f"{block.name} {k}", f"{sid} {k}", {"Port": str(sides[1] + k)}
        )
    stack = [line.wire for line in inner.lines]
    while stack:
        wire = stack.pop()
        stack += wire.branches
        if wire.sink is not None and wire.sink.sid == sid:
            wire.sink = Pin(f"{sid} {wire.sink.number}", "in", 1)
    made.blocks["turn"] = SimulinkBlock("SubSystem", "turn", "turn", {}, ports=(sides[0] + 1, sides[1]), system=inner)
    made.blocks[sid] = SimulinkBlock("Constant", block.name, sid, {"OutDataTypeStr": kind}, ports=(0, 1))
    made.lines += [_line("", one.sid, Pin("turn", "in", port_number(one))) for one in ports if one.type == "Inport"]
    made.lines.append(_line("", sid, Pin("turn", "in", sides[0] + 1)))
    for one in ports:
        if one.type == "Outport":
            made.lines.append(Line("", Pin("turn", "out", port_number(one)), Wire([], Pin(one.sid, "in", 1), [])))
    first = int(said.get("IndexMode", "One-based") != "Zero-based")
    bounded = outside or count != most
    return made, Iteration(most, extra, first, loops, said.get("ResetStates", "held") == "held", bounded)


_RECORDED = {"FromWorkspace": "VariableName", "FromFile": "FileName"}
"""Sources of recorded data, with the parameter that names them."""


def with_ports(system: System, notes: list[str]) -> System:
    """Return a system in which recorded data are inputs, also those of its subsystems, and To Workspace outputs.

    `notes` gets a line for each input that is made so.
    """
    system, recorded = with_bus_ports(_with_elements(system)), list[SimulinkBlock]()
    blocks = dict(system.blocks)
    for sid, block in system.blocks.items():
        if block.system is not None and not block.commented:
            blocks[sid] = replace(block, system=with_recorded(block.system, recorded))
    own = [block for block in blocks.values() if block.type in _RECORDED and not block.commented]
    system = with_inputs(System(blocks, system.lines), [*own, *recorded], notes)
    blocks = system.blocks
    kept = [block for block in blocks.values() if block.type == "ToWorkspace" and not block.commented]
    count = sum(block.type == "Outport" for block in blocks.values())
    for number, block in enumerate(kept, start=count + 1):
        blocks[block.sid] = _port("Outport", block, number)
        blocks[block.sid].name = block.values.get("VariableName", "sim")
    return system


def with_inputs(system: System, recorded: Iterable[SimulinkBlock], notes: list[str]) -> System:
    """Return a system with an input for each source of recorded data; that of one elsewhere goes there by a tag."""
    blocks, lines = dict(system.blocks), list(system.lines)
    count = sum(block.type == "Inport" for block in blocks.values())
    for number, block in enumerate(recorded, start=count + 1):
        said, port = block.values.get(_RECORDED[block.type], ""), _port("Inport", block, number)
        port.name = said if said.isidentifier() else block.name
        notes.append(f"{block.type} {block.name}: its data are not read; they are the input {port.name}")
        if block.sid not in blocks:
            goto = f"{block.sid} goto"
            blocks[goto] = SimulinkBlock("Goto", goto, goto, {"GotoTag": goto, "TagVisibility": "global"})
            lines.append(_line("", port.sid, Pin(goto, "in", 1)))
        blocks[port.sid] = port
    return System(blocks, lines)


def _with_elements(system: System) -> System:
    """Return a system in which each element of a bus whose type no port says is an input of its own."""
    ports = {sid: b for sid, b in system.blocks.items() if b.type == "Inport" and b.values.get("InterfaceElement")}
    typed = {port_number(b) for b in ports.values() if b.values.get("OutDataTypeStr", "").startswith("Bus")}
    made = dict(system.blocks)
    for number, (sid, block) in enumerate(ports.items(), start=len(made) + 1):  # beyond those of other ports
        if port_number(block) not in typed:
            name = f"{block.values.get('InterfacePortName', block.name)}_{block.values['InterfaceElement']}"
            made[sid] = replace(
                block, name=name, values={**block.values, "InterfaceIsComposite": "0", "Port": str(number)}
            )
    return System(made, system.lines)


def _port(kind: str, block: SimulinkBlock, number: int) -> SimulinkBlock:
    kept = {name: text for name, text in block.values.items() if name in ("Position", "OutDataTypeStr")}
    return SimulinkBlock(kind, block.name, block.sid, {**kept, "Port": str(number)})


def with_recorded(system: System, recorded: list[SimulinkBlock], at: str = "") -> System:
    """Return a system at a path in which recorded data come From the top; their blocks are added to `recorded`."""
    blocks = dict(system.blocks)
    for sid, block in system.blocks.items():
        if block.type in _RECORDED and not block.commented:
            recorded.append(replace(block, sid=f"{at}:{sid} data"))
            blocks[sid] = replace(block, type="From", values={**block.values, "GotoTag": f"{at}:{sid} data goto"})
        elif block.system is not None and not block.commented:
            blocks[sid] = replace(block, system=with_recorded(block.system, recorded, at))
    return System(blocks, system.lines)
