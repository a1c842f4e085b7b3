"""Flattening: the blocks of a diagram without sub-diagrams, connected, checked and in an order of execution."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field

from twodof.blocks.block import Block, EnabledAgain, TriggerEdge, steady_trace
from twodof.blocks.declarations import Param, Port, check_initial, located, mismatch, narrowed, unknown_name
from twodof.blocks.diagram import (
    BASE,
    MAX_NESTED,
    Diagram,
    Part,
    Rate,
    check_base_rate,
    check_condition,
    declared_values,
    no_parameter,
    not_connected,
    two_values,
)
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.library.delays import StoreWrite, note_writer, stored
from twodof.compile.program.flat_program import Condition, FlatParameter, FlatSignal, Node
from twodof.errors import DiagramError, nearest


@dataclass(eq=False)
class Level:
    """A diagram or sub-diagram at its path; `parts` are its blocks' nodes and its sub-diagrams' levels, by name."""

    diagram: Diagram
    path: str  # of this diagram, for messages
    prefix: str  # of its parts
    parent: Level | None = None
    name: str = ""  # in the parent
    parts: dict[str, Node | Level] = field(default_factory=dict)
    condition: Condition | None = None
    root_inputs: dict[str, FlatSignal] = field(default_factory=dict)

    @property
    def conditions(self) -> list[Condition]:
        """Conditions of this diagram and of those around it, the innermost first."""
        found = [] if self.condition is None else [self.condition]
        return found if self.parent is None else [*found, *self.parent.conditions]

    def driver(self, output: str) -> FlatSignal:
        """Return the signal that drives one of this diagram's outputs, or a field of one."""
        return scalar(self._driven(output), f"{self.path}.{output}")

    def drivers(self, output: str) -> dict[str, FlatSignal]:
        """Return the signals that drive one of this diagram's outputs, by path: one signal, or the fields of a bus."""
        return {f"{output}.{field}" if field else output: s for field, s in self._driven(output).items()}

    def _driven(self, output: str) -> dict[str, FlatSignal]:
        source = self.diagram.outlet(output)
        if source is None:
            raise not_connected("output", f"{self.path}.{output}")
        return self.signals(source)

    def resolve(self, source: str) -> FlatSignal:
        """Return the signal named `source` in this diagram. Raises DiagramError for a bus."""
        return scalar(self.signals(source), f"{self.path}.{source}")

    def signals(self, source: str) -> dict[str, FlatSignal]:
        """Follow `source` through the borders of sub-diagrams; return {"": signal}, or a bus's signals by field."""
        at, text = self, source
        seen: set[tuple[int, str]] = set()
        while (id(at), text) not in seen:
            seen.add((id(at), text))
            try:
                part, port = at.diagram.source(text)
            except DiagramError as error:
                raise DiagramError(error.what, at.path, error.remedy) from error
            if part is None:
                if at.parent is None:
                    return _fields(at.root_inputs, port)
                above = at.parent.diagram.feed(at.name, port)
                if above is None:
                    raise not_connected("input", f"{at.path}.{port}")
                at, text = at.parent, above
                continue
            inner = at.parts.get(part)
            if inner is None:
                raise DiagramError(
                    "its source is in sub-diagrams nested too deep", f"{self.path}.{source}", "use fewer levels"
                )
            if isinstance(inner, Node):
                return _fields(inner.outputs, port)
            below = inner.diagram.outlet(port)
            if below is None:
                raise not_connected("output", f"{inner.path}.{port}")
            at, text = inner, below
        raise DiagramError("a connection leads back to itself", f"{self.path}.{source}", "put a block into the loop")


def _fields(signals: Mapping[str, FlatSignal], name: str) -> dict[str, FlatSignal]:
    if name in signals:
        return {"": signals[name]}
    return {path[len(name) + 1 :]: s for path, s in signals.items() if path.startswith(f"{name}.")}


def scalar(found: Mapping[str, FlatSignal], where: str) -> FlatSignal:
    """Return the signal in `found`, from `Level.signals`. Raises DiagramError for a bus."""
    if "" not in found:
        raise DiagramError(f"it is a bus, with the fields {nearest('', found)}", where, "name one of its fields")
    return found[""]


MAX_DEPTH = 64
MAX_SIGNALS = 1_000_000  # as a bus of many fields at many borders of sub-diagrams would give
MAX_LOOPS = 20  # algebraic loops that are listed; each costs a walk through the diagram

Report = Callable[[DiagramError], None]
"""Handler of a problem: `lower` raises the first one, `twodof.compile.program.check` collects them all."""


class AlgebraicLoop(DiagramError):
    """Signals that need one another in the same tick. `signals` are their paths, each after the one that needs it."""

    def __init__(self, what: str, where: str, remedy: str, signals: tuple[str, ...]) -> None:
        super().__init__(what, where, remedy)
        self.signals = signals


def refuse(error: DiagramError) -> None:
    """Raise the error."""
    raise error


class FlatDiagram:
    """Nodes and parameters of a diagram, connected and checked. `report` is called with each problem.

    If `report` returns, the checks go on with a harmless substitute: an input without a driver gets a signal in
    `unknown`, and a block that cannot be traced is left out.
    """

    def __init__(self, diagram: Diagram, report: Report = refuse) -> None:
        self.diagram = diagram
        self.report = report
        self.unknown: set[FlatSignal] = set()
        self.nodes: list[Node] = []
        self.writers: dict[Node, Node] = {}  # of data stores
        self.parameters: dict[str, FlatParameter] = {}
        self.signals: dict[str, FlatSignal] = {}  # the outputs of blocks and sub-diagrams, by path
        self.outputs: dict[str, FlatSignal] = {}  # of the whole, buses by field
        self.buses: dict[tuple[str, str], dict[str, FlatSignal]] = {}  # by path of the diagram and source in it
        self.levels: list[Level] = []
        self.root = Level(diagram, diagram.name, "")
        self.root.root_inputs = {p.name: _signal(p.name, p) for p in diagram.inputs.values()}
        stack: list[tuple[Level, Rate, tuple[Condition, ...], dict[str, FlatParameter], int]] = [
            (self.root, BASE, (), {}, 0)
        ]
        while stack:
            level, rate, conditions, bound, depth = stack.pop()
            if depth > MAX_DEPTH:
                what = f"sub-diagrams are nested more than {MAX_DEPTH} deep"
                report(DiagramError(what, level.path, "use fewer levels"))
                continue
            self.levels.append(level)
            declared = level.diagram.params
            own = {n: self._parameter(level.prefix + n, p, bound.get(n)) for n, p in declared.items()}
            for part in level.diagram.parts.values():
                inner = self._bindings(level, part, own)
                if isinstance(part.item, Block):
                    level.parts[part.name] = self._node(level, part, part.item, rate, conditions, inner)
                    continue
                path = level.prefix + part.name
                below = Level(part.item, path, f"{path}.", level, part.name)
                level.parts[part.name] = below
                around = conditions
                own_rate = part.rate.within(rate).check(path, MAX_NESTED)
                if part.enable or part.reset or part.trigger or part.enabling == "restart":
                    below.condition = Condition(path, own_rate, clears=part.disabled != "hold")
                    around = (*conditions, below.condition)
                stack.append((below, own_rate, around, inner, depth + 1))
        self.nodes.sort(key=lambda n: n.path)
        self._trace()
        self._connect()  # which adds nodes
        self.nodes.sort(key=lambda n: n.path)
        self._check_base_rate()

    def _bindings(self, level: Level, part: Part, own: Mapping[str, FlatParameter]) -> dict[str, FlatParameter]:
        for outer in part.params.values():
            if outer not in own:
                self.report(no_parameter(outer, level.diagram, f"{level.path}.{part.name}"))
        return {inner: own[outer] for inner, outer in part.params.items() if outer in own}

    def _parameter(self, path: str, declared: Param, bound: FlatParameter | None) -> FlatParameter:
        if bound is None:
            self.parameters[path] = FlatParameter(path, declared)
            return self.parameters[path]
        try:
            bound.declared = narrowed(bound.declared, bound.path, declared, path)
        except DiagramError as error:
            self.report(error)
            return self._parameter(path, declared, None)
        return bound

    def _node(
        self,
        level: Level,
        part: Part,
        block: Block,
        rate: Rate,
        conditions: tuple[Condition, ...],
        bound: Mapping[str, FlatParameter],
    ) -> Node:
        path = level.prefix + part.name
        node = Node(path, block, part.rate.within(rate).check(path, MAX_NESTED), conditions)
        node.parameters = {d.name: self._parameter(f"{path}.{d.name}", d, bound.get(d.name)) for d in block.params}
        return self._with_outputs(node)

    def _with_outputs(self, node: Node) -> Node:
        node.outputs = {o.name: _signal(f"{node.path}.{o.name}", o, node) for o in node.block.outputs}
        self.nodes.append(node)
        self.signals |= {s.path: s for s in node.outputs.values()}
        return node

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Report a DiagramError raised inside, and go on."""
        try:
            yield
        except DiagramError as error:
            self.report(error)

    def _trace(self) -> None:
        """Trace every block; one that cannot be is left out, and its outputs are as if given from outside."""
        for node in list(self.nodes):
            try:
                steady_trace(node.block, node.path)
            except DiagramError as error:
                self.report(error)
                self.nodes.remove(node)
                for signal in node.outputs.values():
                    signal.node = None
                    self.unknown.add(signal)

    def _connect(self) -> None:
        """Give each node its drivers and each condition its signals; checks types, widths and units."""
        self._find_writers()
        for level in self.levels:
            for name in level.diagram.outputs:
                with self._reported():
                    driven = level.drivers(name)
                    if level.parent is None:
                        self.outputs |= driven
                        continue
                    self.signals |= {f"{level.path}.{path}": s for path, s in driven.items()}
                    if len(self.signals) > MAX_SIGNALS:
                        raise DiagramError(f"it has more than {MAX_SIGNALS} signals", self.diagram.name, "use arrays")
            for part in level.diagram.parts.values():
                inner = level.parts.get(part.name)
                if inner is not None:
                    self._start(part, inner)
                if isinstance(inner, Node):
                    inner.drivers = {
                        port.name: self._driver(level, part.name, port, inner.path) for port in inner.block.inputs
                    }
                    continue
                if inner is None:
                    continue
                for port in inner.diagram.inputs.values():
                    self._driver(level, part.name, port, inner.path)
                if inner.condition is not None:
                    self._decide(level, part, inner, inner.condition)

    def _start(self, part: Part, inner: Node | Level) -> None:
        """Give the signals of a part's outputs the values that it declares."""
        told = [(what, name, value) for what, values in declared_values(part).items() for name, value in values.items()]
        for what, name, value in told:
            where = f"{inner.path}.{name}"
            with self._reported():
                signal = inner.outputs[name] if isinstance(inner, Node) else inner.driver(name)
                if not signal.path.startswith(f"{inner.path}."):
                    raise DiagramError("no part inside computes this output", where, f"leave its {what} value out")
                found = check_initial(value, signal, where)
                held = getattr(signal, what)
                if held not in (None, found):
                    raise DiagramError(two_values(what, signal.path, held, found), where, f"give one {what} value")
                setattr(signal, what, found)

    def _decide(self, level: Level, part: Part, inner: Level, condition: Condition) -> None:
        """Give a sub-diagram's condition its signals, with the nodes that the language adds for them."""
        condition.enable = self._bool(level, part.enable, inner.path, "enable")
        condition.reset = self._bool(level, part.reset, inner.path, "reset")
        trigger = self._bool(level, part.trigger, inner.path, "trigger")
        if trigger is not None:
            around = tuple(level.conditions[::-1])
            condition.trigger = self._added("trigger", TriggerEdge(part.edge), condition, [trigger], around)
        enables = [c.enable for c in inner.conditions if c.enable is not None]
        if part.enabling == "restart" and enables:
            # It sees the diagrams around disabled: nothing may freeze it.
            condition.restart = self._added("restart", EnabledAgain(len(enables)), condition, enables, ())

    def _added(
        self,
        name: str,
        block: Block,
        condition: Condition,
        drivers: Sequence[FlatSignal],
        around: tuple[Condition, ...],
    ) -> FlatSignal:
        """Add a node that triggers or restarts a sub-diagram, and return its output."""
        node = Node(f"{condition.path}._{name}", block, condition.rate, around)
        node.drivers = {port.name: signal for port, signal in zip(block.inputs, drivers, strict=True)}
        return self._with_outputs(node).outputs["y"]

    def _driver(self, level: Level, part: str, port: Port, path: str) -> FlatSignal:
        where = f"{path}.{port.name}"
        with self._reported():
            with located(where) if "." in port.name else nullcontext():
                source, field = level.diagram.wire(part, port.name)
                if source is None:
                    node, output = stored(self.writers, level, part, port.name, where)
                    signal: FlatSignal = node.outputs[output]
                elif field:
                    signal = self._field(level, source, field)
                else:
                    signal = scalar(level.signals(source), where)
            clash = mismatch(port, signal, signal.path)
            if clash is not None:
                raise DiagramError(clash[0], where, clash[1])
            return signal
        stand_in = _signal(where, port)
        self.unknown.add(stand_in)
        return stand_in

    def _field(self, level: Level, source: str, field: str) -> FlatSignal:
        """Return a field of the bus `source`. The bus is kept: a wide one is asked a thousand times."""
        key = level.path, source
        if key not in self.buses:
            self.buses[key] = level.signals(source)
        found = self.buses[key].get(field[1:])
        return level.resolve(level.diagram.field(source, field)) if found is None else found

    def _find_writers(self) -> None:
        """Find the writer of each data store: one at most."""
        for level in self.levels:
            for node in level.parts.values():
                if not isinstance(node, Node) or not isinstance(node.block, StoreWrite):
                    continue
                with self._reported():
                    store = note_writer(self.writers, level, node)
                    for signal, state in zip(node.outputs.values(), store.block.states, strict=False):
                        signal.initial = state.initial

    def _bool(self, level: Level, source: str | None, path: str, what: str) -> FlatSignal | None:
        if not source:
            return None
        with self._reported():
            signal = level.resolve(source)
            check_condition(signal, source, what, path)
            return signal
        return None

    def _check_base_rate(self) -> None:
        for node in self.nodes:
            with self._reported():
                check_base_rate(node.block, node.rate, node.path)

    def ordered(self) -> list[FlatSignal]:
        """Return all outputs of all nodes, each after those that it needs, ties by path; check loops and rates."""
        everything = [s for n in self.nodes for s in n.outputs.values()]
        order = _ordered(self.diagram.name, everything, self.report)
        _check_rates(self.nodes, order, self.unknown, self.report)
        return order

    def logged(self, path: str) -> dict[str, FlatSignal]:
        """Return the signal with the path "part.sub.port", or each field of a bus. Raises DiagramError without one."""
        if path in self.signals:
            return {path: self.signals[path]}
        fields = {p: s for p, s in self.signals.items() if p.startswith(f"{path}.")}
        if not fields or not self._is_bus(path):
            raise unknown_name("signal", path, sorted(self.signals), self.diagram.name)
        return fields

    def _is_bus(self, path: str) -> bool:
        """Return True if the signals below `path` are the fields of one bus, and not the signals of a part."""
        parts = {node.path for node in self.nodes} | {level.path for level in self.levels}
        return path not in parts


def _signal(path: str, port: Port, node: Node | None = None) -> FlatSignal:
    return FlatSignal(path, port.name, port.kind, port.width, port.unit, node, shape=port.shape, enum=port.enum)


def node_of(signal: FlatSignal) -> Node:
    """Return the node whose output a signal is. Raises ValueError for an input of the program."""
    if signal.node is None:
        raise ValueError(f"{signal.path} is an input of the program")
    return signal.node


def drivers_of(signal: FlatSignal) -> list[FlatSignal]:
    """Return the outputs of nodes on which this signal depends in the same tick through its block."""
    node = node_of(signal)
    found = [node.drivers[name] for name in sorted(node.trace.feedthrough[signal.port])]
    return [d for d in found if d.node is not None]


def tick_needs(signal: FlatSignal) -> list[FlatSignal]:
    """Return the signals that must be known before this one can be computed in a tick."""
    return drivers_of(signal) + conditions_of(node_of(signal))


def conditions_of(node: Node) -> list[FlatSignal]:
    """Return the outputs of nodes that enable, reset or trigger a node."""
    return [s for c in node.conditions for s in c.signals if s.node is not None]


def _ordered(name: str, signals: Sequence[FlatSignal], report: Report) -> list[FlatSignal]:
    """Sort `signals`, each after those it needs, ties by path; report each algebraic loop and go on as if cut."""
    rank = {s: i for i, s in enumerate(signals)}
    needs = {s: set(tick_needs(s)) for s in signals}
    users: dict[FlatSignal, list[FlatSignal]] = {s: [] for s in signals}
    for s, before in needs.items():
        for b in before:
            users[b].append(s)
    waiting = {s: len(before) for s, before in needs.items()}
    ready = [rank[s] for s in signals if waiting[s] == 0]
    heapq.heapify(ready)
    order: dict[FlatSignal, None] = {}
    for _ in range(MAX_LOOPS):
        while ready:
            s = signals[heapq.heappop(ready)]
            order[s] = None
            for user in users[s]:
                waiting[user] -= 1
                if waiting[user] == 0:
                    heapq.heappush(ready, rank[user])
        if len(order) == len(signals):
            break
        loop = _loop({s: [b for b in needs[s] if b not in order] for s in signals if s not in order})
        report(
            AlgebraicLoop(
                f"algebraic loop {' <- '.join(s.path for s in loop)}",
                name,
                "put a delay or a continuous state into the loop",
                tuple(s.path for s in loop),
            )
        )
        waiting[loop[0]] = 0  # from here on it only falls, so it is not pushed again
        ready.append(rank[loop[0]])
    return list(order)


def _loop(needs: Mapping[FlatSignal, Sequence[FlatSignal]]) -> list[FlatSignal]:
    """Return a cycle in a graph in which each node needs another one."""
    at = min(needs, key=lambda s: s.path)
    seen: dict[FlatSignal, int] = {}
    while at not in seen:
        seen[at] = len(seen)
        at = min(needs[at], key=lambda s: s.path)
    return [*list(seen)[seen[at] :], at]


def constants(ordered: Iterable[FlatSignal]) -> set[FlatSignal]:
    """Return the signals that change only with parameters, and so have no rate."""
    constant: set[FlatSignal] = set()
    for s in ordered:
        node = node_of(s)
        steady = not node.conditions and s.port not in node.trace.uses_tick and s.port not in node.trace.edges
        fed = [node.drivers[i] for i in node.trace.feedthrough[s.port]]
        if steady and all(d in constant for d in fed) and not leaves([node.trace.outputs[s.port]], "state"):
            constant.add(s)
    return constant


def _check_rates(
    nodes: Sequence[Node], ordered: Sequence[FlatSignal], unknown: set[FlatSignal], report: Report
) -> None:
    """Report where a block reads a signal of another rate without being a crossing."""
    rateless = constants(ordered) | unknown
    for node in nodes:
        for name, signal in node.drivers.items():
            rate = BASE if signal.node is None else signal.node.rate
            if rate != node.rate and signal not in rateless and not node.block.crossing:
                report(
                    DiagramError(
                        f"it runs at {tuple(node.rate)}, and its signal {signal.path} at {tuple(rate)}",
                        f"{node.path}.{name}",
                        "put a ZeroOrderHold or RateTransition between them",
                    )
                )
