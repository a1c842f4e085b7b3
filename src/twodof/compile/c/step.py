"""Emitter of the statements of one tick, except the integration."""

from collections.abc import Iterable, Sequence
from functools import partial

from twodof.blocks.declarations import Port
from twodof.blocks.diagram import Rate
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.state_machine import StateMachine
from twodof.compile.c.commit import StateChange, changed, commit
from twodof.compile.c.expressions import Leaves
from twodof.compile.c.graph import leaf
from twodof.compile.c.machine_switch import MachineSwitch
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.schedule import Schedule, Segment, switch_inputs
from twodof.compile.c.scope import Scope
from twodof.compile.c.statements import Assign, CNames, Copy, IfStatement, Statement, Text, name_of
from twodof.compile.program.flat_program import Action, FlatSignal, Guard, Node

TICKS = 2**32  # a tick is a uint32


class StepEmitter:
    """Emitter of the step function's body.

    `renderer` writes all expressions. `fractions` holds, for each signal with an edge inside the step, the names of two
    variables: the fraction of the step at which the edge is, and the value after it.
    """

    def __init__(self, scope: Scope, names: CNames) -> None:
        self.scope = scope
        self.layout = scope.layout
        self.program = scope.program
        self.graph = scope.graph
        self.schedule = Schedule(scope.program, scope.layout)
        self.fractions: dict[FlatSignal, tuple[str, str]] = {}
        self._variables: dict[FlatSignal, str] = {}  # that are declared before the statements that compute them
        self._pending = set(self.schedule.live)
        self._shown: dict[Expr, Expr] = {}
        for s in self.schedule.live:
            if s.width is None and s not in self.layout.stored and s.node not in self.schedule.machines:
                self._shown.setdefault(self.graph.output(s), leaf(s))
        self._due: dict[Rate, str] = {}
        self._asked: set[Rate] = set()
        text = scope.leaf(self.signal, scope.state)
        leaves = Leaves(text, self._driver, self._place, self._shown.get, self.graph.owner)
        self.renderer = scope.renderer(names, leaves)
        for rate in (n.rate for n in self.program.nodes):
            if rate.divider > 1 and rate not in self._due:
                self._due[rate] = names.new(f"due_{rate.divider}_{rate.offset}")

    def signal(self, signal: FlatSignal) -> str:
        """Return the C of a signal that has been computed, or is an input."""
        if signal.node is None:
            return f"u->{self.layout.inputs[signal].name}"
        if signal in self.layout.stored:
            return f"s->{self.layout.stored[signal].name}"
        if signal in self._variables:
            return self._variables[signal]
        return self.renderer.named[id(leaf(signal))].text

    def _driver(self, item: Expr) -> Expr | None:
        signal: FlatSignal = item.data
        return self.graph.output(signal) if signal in self._pending else None

    def _place(self, signal: FlatSignal) -> str:
        if signal in self.layout.stored:
            return f"s->{self.layout.stored[signal].name}"
        return self._variables.get(signal, "")

    def due(self) -> list[Statement]:
        """Return the declarations of the flags that tell which rates are due, for the rates in use."""
        made: list[Statement] = []
        for rate in (rate for rate in self._due if rate in self._asked):
            due = f"s->tick % {rate.divider}u == {rate.offset}u"
            if rate.divider >= TICKS:  # sub-diagrams multiply their rates
                due = f"s->tick == {rate.offset}u" if rate.offset < TICKS else "false"
            made.append(Assign(self._due[rate], due, "const bool", role="rates", reads=frozenset(("s",))))
        return made

    def tests(self, guard: Guard) -> list[Text]:
        """Return the conditions that must all hold for the blocks of a guard to act."""
        return [*self._rate(guard), *(self._text(e) for e in guard.enables)]

    def _rate(self, guard: Guard) -> list[Text]:
        self._asked.add(guard.rate)
        due = self._due.get(guard.rate)
        return [] if due is None else [Text(due, reads=frozenset((due,)))]

    def _text(self, signal: FlatSignal) -> Text:
        text = self.signal(signal)
        return Text(text, reads=frozenset((name_of(text),)))

    def guarded(self, tests: Sequence[Text], body: list[Statement]) -> None:
        """Add the statements `body`, in an `if` on all of `tests` unless these are empty."""
        if not tests:
            self.renderer.out += body
        elif body:
            condition = all_of(tests)
            self.renderer.out.append(IfStatement(condition.text, body, role="condition", reads=condition.reads))

    def outputs(self) -> None:
        """Add the outputs of all blocks, group by group."""
        for signal in self.program.edged:
            self._declare_edge(signal)
        for segments in self.schedule.groups:
            guard = segments[0].guard
            if guard.always:
                for segment in segments:
                    self._segment(segment)
                continue
            signals = [s for segment in segments for a in self._all(segment) for s in a.signals]
            for s in signals:
                if s in self.layout.passing and (s in self.schedule.fixed or s.node in self.schedule.machines):
                    self._variable(s)
            with self.renderer.within() as body:
                for segment in segments:
                    self._segment(segment)
            self.guarded(self.tests(guard), body)
            if guard.clears:
                enabled = all_of([self._text(e) for e in guard.clears])
                disabled = Text(f"!({enabled.text})", reads=enabled.reads)
                held = [s for s in signals if s in self.layout.stored]
                self.guarded([*self._rate(guard), disabled], self._cleared(held))

    def _all(self, segment: Segment) -> list[Action]:
        return [*segment.actions, *([segment.behind] if segment.behind is not None else [])]

    def _variable(self, s: FlatSignal) -> None:
        """Declare a variable that is computed under a condition and read behind it, unless it is computed already."""
        if (known := self.renderer.named.get(id(leaf(s)))) is not None:
            self._variables[s] = known.text
            return
        name = self._variables[s] = self.renderer.names.new(s.path)
        value = self.scope.constant(0, s.kind)
        self.renderer.out.append(Assign(name, value, C_TYPES[s.kind], owner=s.node))

    def _declare_edge(self, signal: FlatSignal) -> None:
        new = self.renderer.names.new
        self.fractions[signal] = names = new(f"{signal.path}.fraction"), new(f"{signal.path}.after")
        if signal.node is not None and not signal.node.guard.always:
            for name, value in zip(names, (1.0, 0.0), strict=True):
                self.renderer.out.append(Assign(name, self.scope.constant(value, "real"), "real", owner=signal.node))

    def _cleared(self, signals: Iterable[FlatSignal]) -> list[Statement]:
        made: list[Statement] = []
        for s in signals:
            port = Port("y", s.kind, s.width, shape=s.shape)
            made += self.scope.fill(self.signal(s), s.cleared, port, None, role="disabled outputs")
        return made

    def _segment(self, segment: Segment) -> None:
        """Add the outputs of a segment, then what stands behind them."""
        fixed = [s for a in segment.actions for s in a.signals if s in self.schedule.fixed]
        roots = [leaf(s) for s in fixed]
        # What outputs and next states share is computed once, in one branch.
        updated = segment.updates
        if segment is self.schedule.segments[-1] and segment.guard.always:
            updated = [node for node in self.schedule.last if node.guard.always]
        roots += [
            e for node in updated if not self._idle_machine(node) for row in self._changes(node) for e in row.numbers
        ]
        behind = segment.behind
        if behind is not None and behind.start is None:
            roots += [leaf(s) for s in switch_inputs(behind.node) if s in self._pending]
        self.renderer.texts(roots)
        for s in fixed:
            if s in self.fractions:
                self._set_edge(s)
        self._updates(segment.updates)
        self._pending.difference_update(fixed)
        if behind is not None:
            self._behind(segment, behind.node)

    def _set_edge(self, signal: FlatSignal) -> None:
        """Add the place of a signal's edge in the step, and its value behind it."""
        node = signal.node
        assert node is not None
        self.renderer.owner = node
        values = self.renderer.texts(self.graph.of(node, e) for e in node.trace.edges[signal.port])
        for name, value in zip(self.fractions[signal], values, strict=True):
            if node.guard.always:
                self.renderer.declare(name, "real", value, fixed=True)
            else:
                self.renderer.put(name, value)
        self.renderer.owner = None

    def _behind(self, segment: Segment, node: Node) -> None:
        behind = segment.behind
        assert behind is not None
        if behind.start is None:
            self._switch(node, behind.signals)
            return
        signals = [self.signal(r) for r in behind.start.signals]
        reads = frozenset(map(name_of, signals))
        self.renderer.out.append(IfStatement(" || ".join(signals), self.scope.initial(node), owner=node, reads=reads))

    def _switch(self, node: Node, signals: Sequence[FlatSignal]) -> None:
        """Add a state machine as C that reads like its drawing."""
        machine = node.block
        assert isinstance(machine, StateMachine)
        renderer, targets = self.renderer, {}
        outer, renderer.owner = renderer.owner, node
        for signal in signals:
            if not self._place(signal):
                name = self._variables[signal] = renderer.names.new(signal.path)
                renderer.declare(name, signal.kind, width=signal.width)
            targets[signal.port] = self.signal(signal)
        states = {s.name: self.scope.state(node, s.name) for s in machine.states}
        MachineSwitch(self.scope, renderer, node, machine, states, targets, self.signal).write()
        self._pending.difference_update(signals)
        renderer.owner = outer

    def updates(self) -> None:
        """Add the updates of states. The update of a block reads only its own states."""
        by_guard: dict[Guard, list[Node]] = {}
        for node in self.schedule.last:
            by_guard.setdefault(node.guard, []).append(node)
        for guard in sorted(by_guard, key=lambda g: not g.always):
            with self.renderer.within() as body:
                self._updates(by_guard[guard])
            self.guarded(self.tests(guard), body)

    def _updates(self, nodes: Sequence[Node]) -> None:
        rows: list[StateChange] = []
        for node in nodes:
            if self._idle_machine(node):
                self._switch(node, ())
            else:
                rows += self._changes(node)
        commit(self.renderer, rows)

    def _idle_machine(self, node: Node) -> bool:
        """Return True if a node is a state machine whose outputs nobody reads, and whose inputs are at hand."""
        used = any(s in self.schedule.live for s in node.outputs.values())
        return isinstance(node.block, StateMachine) and not used and self.schedule.ready(node)

    def _changes(self, node: Node) -> list[StateChange]:
        values = {name: self.graph.of(node, e) for name, e in node.trace.update.items()}
        return changed(node, values, partial(self.scope.state, node))

    def returned(self) -> None:
        """Add the stores of outputs and logged signals in Y."""
        for path, signal in self.program.outputs.items():
            target, text = f"y->{self.layout.outputs[path].name}", self.signal(signal)
            reads = frozenset((name_of(text),))
            if signal.width is None:
                self.renderer.out.append(Assign(target, text, role="returned signals", reads=reads))
            else:
                kind = C_TYPES[signal.kind]
                self.renderer.out.append(Copy(target, text, signal.width, kind, role="returned signals", reads=reads))


def all_of(tests: Sequence[Text]) -> Text:
    """Return the condition that all of `tests` hold."""
    return Text(" && ".join(t.text for t in tests), reads=frozenset[str]().union(*(t.reads for t in tests)))
