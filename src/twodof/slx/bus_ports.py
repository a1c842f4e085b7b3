"""Ports of single elements of a bus, "In Bus Element" and "Out Bus Element", as whole ports.

Simulink draws one port of a subsystem as many blocks, each with the path of one element. The importer knows a port as
one block: here the blocks become selectors behind an Inport, or signals of a creator of buses in front of an Outport.
"""

from dataclasses import replace

from twodof.slx.model import Line, Pin, SimulinkBlock, System, Wire, port_number


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
