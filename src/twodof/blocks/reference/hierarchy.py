"""The hierarchy of a diagram as the reference walks it: who drives whom, and in which order ports can be computed."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import Any

from twodof.blocks.block import Block, EnabledAgain, TriggerEdge, steady_trace
from twodof.blocks.declarations import Param, Port, State, check_initial, located, mismatch, narrowed, unknown_name
from twodof.blocks.diagram import (
    BASE,
    MAX_NESTED,
    Diagram,
    Rate,
    check_base_rate,
    check_condition,
    declared_values,
    fields_of,
    no_parameter,
    not_connected,
    two_values,
)
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.library.delays import StoreWrite, note_writer, stored
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
    parts: dict[str, DiagramLevel | Cell] = field(default_factory=dict)
    enable: PortOf | str | None = None
    reset: PortOf | str | None = None
    trigger: PortOf | None = None  # true where its trigger has an edge
    resets_outputs: bool = False
    rate: Rate = BASE
    restart: PortOf | None = None  # true where it and all around it are enabled again
    _ends: dict[str, dict[str, PortOf | str]] = field(default_factory=dict)  # of the sources that were followed

    @property
    def signals(self) -> list[PortOf | str]:
        """The signals that decide over the diagram."""
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
        """Return the block's port, or the name of the root's input, behind `source`. It is not a bus."""
        ends = self.ends(source)
        if "" not in ends:
            what = f"it is a bus, with the fields {nearest('', ends)}"
            raise DiagramError(what, f"{self.path}.{source}", "name one of its fields")
        return ends[""]

    def field(self, source: str, field: str) -> PortOf | str:
        """Return the port behind the field ".rates.p" of the bus `source`."""
        found = self.ends(source).get(field[1:])
        return self.resolve(self.diagram.field(source, field)) if found is None else found

    def spread(self, name: str, source: str) -> dict[str, PortOf | str]:
        """Return the port behind `source` under `name`; for a bus each field's under "name.field"."""
        return {f"{name}.{field}" if field else name: end for field, end in self.ends(source).items()}

    def ends(self, source: str) -> dict[str, PortOf | str]:
        """Return {"": port} for the port behind `source`, or the ports of a bus by field."""
        if source not in self._ends:  # a wide bus is asked a thousand times
            self._ends[source] = self._followed(source)
        return self._ends[source]

    def _followed(self, source: str) -> dict[str, PortOf | str]:
        level, text = self, source
        for _ in range(10_000):
            part, port = level.diagram.source(text)
            child = level.parent if part is None else level.parts[part]
            if child is None:
                return {field: p.name for field, p in fields_of(level.diagram.inputs.values(), port).items()}
            if isinstance(child, Cell):
                return {field: PortOf(child, p.name) for field, p in fields_of(child.block.outputs, port).items()}
            if part is None:
                end, path, found = "input", level.path, child.diagram.feed(level.part, port)
            else:
                end, path, found = "output", child.path, child.diagram.outlet(port)
            if found is None:
                raise not_connected(end, f"{path}.{port}")
            level, text = child, found
        raise DiagramError("a connection leads back to itself", f"{self.path}.{source}", "put a block into the loop")


MAX_DEPTH = 64
MAX_SIGNALS = 1_000_000  # as a bus of many fields at many borders of sub-diagrams would give


Schedule = list[tuple[Cell, list[str]]]
"""Cells, each with those of its ports that are computed together."""


class Hierarchy:
    """All cells of a diagram, connected, checked and put into an order.

    `schedule` lists (cell, ports to compute) so that every port comes after those it depends on;
    `continuous_schedule` is the part of it that an integration re-evaluates.
    """

    def __init__(self, diagram: Diagram) -> None:
        self.parameters: dict[str, Param] = {}
        self.cells: list[Cell] = []
        self.levels: list[DiagramLevel] = []  # each before those inside it
        self.writers: dict[Cell | DiagramLevel, Cell] = {}  # of data stores
        self.root = DiagramLevel(diagram, diagram.name, None, "")
        self._open(self.root, (), {})
        for cell in self.cells:
            steady_trace(cell.block, cell.path)
        self._connect()
        for cell in self.cells:
            check_base_rate(cell.block, cell.rate, cell.path)
        self.schedule = self._order()
        self._check_rates()
        self.continuous_schedule = self._continuous()

    def _open(self, level: DiagramLevel, levels: tuple[DiagramLevel, ...], bound: dict[str, str]) -> None:
        self.levels.append(level)
        diagram, path, prefix = level.diagram, level.path, f"{level.path}." if level.parent else ""
        if prefix.count(".") > MAX_DEPTH:
            raise DiagramError(f"sub-diagrams are nested more than {MAX_DEPTH} deep", path, "use fewer levels")
        roots = {name: self._root(prefix + name, p, bound.get(name)) for name, p in diagram.params.items()}
        for p in diagram.parts.values():
            for outer in p.params.values():
                if outer not in roots:
                    raise no_parameter(outer, diagram, f"{path}.{p.name}")
            inner = {own: roots[outer] for own, outer in p.params.items()}
            at = prefix + p.name
            own_rate = p.rate.within(level.rate).check(at, MAX_NESTED)
            if isinstance(p.item, Block):
                cell = Cell(at, p.item, own_rate, levels)
                cell.parameters = {d.name: self._root(f"{at}.{d.name}", d, inner.get(d.name)) for d in p.item.params}
                level.parts[p.name] = cell
                self.cells.append(cell)
            else:
                child = DiagramLevel(p.item, at, level, p.name, rate=own_rate, resets_outputs=p.disabled != "hold")
                decided = p.enable or p.reset or p.trigger or p.enabling == "restart"
                level.parts[p.name] = child
                self._open(child, (*levels, child) if decided else levels, inner)

    def _root(self, path: str, declared: Param, bound: str | None) -> str:
        if bound is None:
            self.parameters[path] = declared
            return path
        self.parameters[bound] = narrowed(self.parameters[bound], bound, declared, path)
        return bound

    def _connect(self) -> None:
        for level in self.levels:
            for cell in level.parts.values():
                if isinstance(cell, Cell) and isinstance(cell.block, StoreWrite):
                    for state in note_writer(self.writers, level, cell).block.states:
                        cell.initial[f"y{state.name.removeprefix('x')}"] = state.initial
        for level in self.levels:
            for name, source in level.diagram.outputs.items():
                if source is None:
                    raise not_connected("output", f"{level.path}.{name}")
            for name, child in level.parts.items():
                part = level.diagram.parts[name]
                for what, values in declared_values(part).items():
                    for output, value in values.items():
                        self._hold(child, output, value, what)
                if isinstance(child, DiagramLevel):
                    child.enable = self._condition(level, part.enable, child.path, "enable")
                    child.reset = self._condition(level, part.reset, child.path, "reset")
                    trigger = self._condition(level, part.trigger, child.path, "trigger")
                    if trigger is not None:
                        child.trigger = self._added(child, "trigger", TriggerEdge(part.edge), [trigger])
                    if part.enabling == "restart":
                        child.restart = self._restart(child)
                    for port in child.diagram.inputs.values():
                        self._checked_driver(level, name, port, child.path)
                else:
                    child.drivers = {
                        i.name: self._checked_driver(level, name, i, child.path) for i in child.block.inputs
                    }

    def _hold(self, part: DiagramLevel | Cell, output: str, value: Any, what: str) -> None:
        """Let the port that is a part's output hold `value` at first, or (`what` "disabled") where it is disabled."""
        where = f"{part.path}.{output}"
        if isinstance(part, Cell):
            port: PortOf | str = PortOf(part, output)
        else:
            source = part.diagram.outlet(output)
            if source is None:
                raise not_connected("output", where)
            port = part.resolve(source)
        if isinstance(port, str) or not str(port).startswith(f"{part.path}."):
            raise DiagramError("no part inside computes this output", where, f"leave its {what} value out")
        value = check_initial(value, port.declared, where)
        told = port.cell.initial if what == "initial" else port.cell.disabled
        held = told.setdefault(port.port, value)
        if held != value:
            raise DiagramError(two_values(what, str(port), held, value), where, f"give one {what} value")

    def _port(self, driver: PortOf | str) -> Port:
        return self.root.diagram.inputs[driver] if isinstance(driver, str) else driver.declared

    def _condition(self, level: DiagramLevel, source: str | None, path: str, what: str) -> PortOf | str | None:
        if source is None:
            return None
        driver = level.resolve(source)
        check_condition(self._port(driver), source, what, path)
        return driver

    def _restart(self, level: DiagramLevel) -> PortOf | None:
        """Return a cell's port that is true where `level` is enabled again; None if nothing disables it."""
        enables = [at.enable for at in (*level.around, level) if at.enable is not None]
        return self._added(level, "restart", EnabledAgain(len(enables)), enables) if enables else None

    def _added(self, level: DiagramLevel, name: str, block: Block, drivers: list[PortOf | str]) -> PortOf:
        """Return the output of a cell that the language adds beside a sub-diagram, to decide over it."""
        # It freezes with the diagrams around, but for one that has to see them disabled.
        around = () if name == "restart" else tuple(at for at in level.around if at.signals)
        cell = Cell(f"{level.path}._{name}", block, level.rate, around)
        cell.drivers = {port.name: driver for port, driver in zip(block.inputs, drivers, strict=True)}
        self.cells.append(cell)
        return PortOf(cell, "y")

    def _checked_driver(self, level: DiagramLevel, part: str, port: Port, path: str) -> PortOf | str:
        where = f"{path}.{port.name}"
        with located(where) if "." in port.name else nullcontext():
            source, field = level.diagram.wire(part, port.name)
            if source is None:
                driver: PortOf | str = PortOf(*stored(self.writers, level, part, port.name, where))
            else:
                driver = level.field(source, field) if field else level.resolve(source)
        clash = mismatch(port, self._port(driver), driver)
        if clash is not None:
            raise DiagramError(clash[0], where, clash[1])
        return driver

    def _needs(self, item: PortOf) -> list[PortOf]:
        cell = item.cell
        drivers = [cell.drivers[name] for name in sorted(cell.block.trace.feedthrough[item.port])]
        drivers += [s for level in cell.levels for s in level.signals]
        return [d for d in drivers if isinstance(d, PortOf)]

    def _order(self) -> Schedule:
        ports = [PortOf(cell, port.name) for cell in self.cells for port in cell.block.outputs]
        schedule: Schedule = []
        try:
            for item in TopologicalSorter({port: self._needs(port) for port in ports}).static_order():
                self._append(schedule, item)
        except CycleError as error:
            what = f"algebraic loop {' <- '.join(map(str, reversed(error.args[1])))}"
            remedy = "put a delay or a continuous state into the loop"
            raise DiagramError(what, self.root.path, remedy) from None
        return schedule

    def _append(self, schedule: Schedule, item: PortOf) -> None:
        """Append a port to the schedule, to the last entry if that is of its cell and the port does not read it."""
        feeds_itself = any(need.cell is item.cell for need in self._needs(item))
        if schedule and schedule[-1][0] is item.cell and not feeds_itself:
            schedule[-1][1].append(item.port)
        else:
            schedule.append((item.cell, [item.port]))

    def _constant(self) -> set[PortOf | str]:
        """Ports that never change while parameters do not: they have no rate."""
        found: set[PortOf | str] = set()
        for cell, ports in self.schedule:
            t = cell.block.trace
            for port in ports:
                changes = cell.levels or port in t.uses_tick or port in t.edges or leaves([t.outputs[port]], "state")
                if not changes and found.issuperset(cell.drivers[i] for i in t.feedthrough[port]):
                    found.add(PortOf(cell, port))
        return found

    def _check_rates(self) -> None:
        constant = self._constant()
        for cell in self.cells:
            for name, driver in cell.drivers.items():
                rate = BASE if isinstance(driver, str) else driver.cell.rate
                if rate != cell.rate and driver not in constant and not cell.block.crossing:
                    what = f"it runs at {tuple(cell.rate)}, and its signal {driver} at {tuple(rate)}"
                    remedy = "put a ZeroOrderHold or RateTransition between them"
                    raise DiagramError(what, f"{cell.path}.{name}", remedy)

    def _continuous(self) -> Schedule:
        varying: set[PortOf | str] = set()
        chosen: Schedule = []
        for cell, ports in self.schedule:
            t = cell.block.trace
            own = {s.name for s in cell.continuous}
            held = cell.rate != BASE or cell.block.crossing or (cell.discrete and not cell.continuous)
            for port in ports:
                if port in t.edges:
                    varying.add(PortOf(cell, port))
                    continue
                moving = not varying.isdisjoint(cell.drivers[i] for i in t.feedthrough[port])
                if not held and (moving or own & leaves([t.outputs[port]], "state")):
                    varying.add(PortOf(cell, port))
                    self._append(chosen, PortOf(cell, port))
        return chosen

    @cached_property
    def signals(self) -> dict[str, PortOf | str]:
        """The driver of each output of a block or sub-diagram, by its path "part.sub.port"."""
        found: dict[str, PortOf | str] = {}
        for cell in self.cells:
            found |= {f"{cell.path}.{port.name}": PortOf(cell, port.name) for port in cell.block.outputs}
        for level in self.levels[1:]:
            for name, source in level.diagram.outputs.items():
                found |= level.spread(f"{level.path}.{name}", source) if source else {}
            if len(found) > MAX_SIGNALS:
                raise DiagramError(f"it has more than {MAX_SIGNALS} signals", self.root.path, "use arrays")
        return found

    def signal(self, path: str) -> dict[str, PortOf | str]:
        """Return the port of the signal at "part.sub.port", or the fields of a bus. Raises DiagramError without one."""
        if path in self.signals:
            return {path: self.signals[path]}
        fields = {p: port for p, port in self.signals.items() if p.startswith(f"{path}.")}
        if not fields or path in {*(cell.path for cell in self.cells), *(level.path for level in self.levels[1:])}:
            raise unknown_name("signal", path, sorted(self.signals), self.root.path)
        return fields
