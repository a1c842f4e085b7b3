"""Emitter of the statements of one tick, except the integration."""

from collections.abc import Iterable, Sequence
from functools import partial

from twodof.blocks.declarations import Port
from twodof.blocks.diagram import Rate
from twodof.blocks.state_machine import StateMachine
from twodof.compile.c.graph import ProgramGraph
from twodof.compile.c.machine_switch import MachineSwitch
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.schedule import Schedule, Segment, StateChange, changed, commit, switch_inputs
from twodof.compile.c.scope import Scope
from twodof.compile.c.statements import Assign, CNames, IfStatement, Statement, Text, stored
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
        self.schedule = Schedule(scope.program, scope.layout)
        apart = (*self.layout.stored, *(s for node in self.schedule.machines for s in node.outputs.values()))
        always = {s for g in self.program.tick if g.guard.always for a in g.actions for s in a.signals}
        self.graph = ProgramGraph(scope.program, {s for s in always.difference(apart) if s.width is None})
        self.fractions: dict[FlatSignal, tuple[str, str]] = {}
        # Lvalues of signals that are read outside of the brackets in which they are computed.
        self.places = {s: f"s->{member.name}" for s, member in self.layout.stored.items()}
        self._due: dict[Rate, str] = {}
        self._asked: set[Rate] = set()
        self.renderer = scope.renderer(names, scope.leaf(scope.state), self.graph.owner)
        for rate in (n.rate for n in self.program.nodes):
            if rate.divider > 1 and rate not in self._due:
                self._due[rate] = names.new(f"due_{rate.divider}_{rate.offset}")

    def signal(self, signal: FlatSignal) -> Text:
        """Return the C of a signal."""
        return self.renderer.text(self.graph.signal(signal))

    def _stands(self, signals: Iterable[FlatSignal]) -> None:
        """Read signals where they are stored from here on."""
        for s in signals:
            if s in self.places:
                self.renderer.know(self.graph.signal(s), Text.of(self.places[s]))

    def due(self) -> list[Statement]:
        """Return the declarations of the flags that tell which rates are due, for the rates in use."""
        made: list[Statement] = []
        for rate in (rate for rate in self._due if rate in self._asked):
            due = f"s->tick % {rate.divider}u == {rate.offset}u"
            if rate.divider >= TICKS:  # sub-diagrams multiply their rates
                due = f"s->tick == {rate.offset}u" if rate.offset < TICKS else "false"
            made.append(Assign(self._due[rate], due, "const bool", role="rates", reads=frozenset("s")))
        return made

    def tests(self, guard: Guard) -> list[Text]:
        """Return the conditions that must all hold for the blocks of a guard to act."""
        return [*self._rate(guard), *map(self.signal, guard.enables)]

    def _rate(self, guard: Guard) -> list[Text]:
        self._asked.add(guard.rate)
        due = self._due.get(guard.rate)
        return [] if due is None else [Text.of(due)]

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
            self._stands(signals)
            if guard.clears:
                enabled = all_of([self.signal(e) for e in guard.clears])
                disabled = Text(f"!({enabled.text})", reads=enabled.reads)
                held = [s for s in signals if s in self.layout.stored]
                self.guarded([*self._rate(guard), disabled], self._cleared(held))

    def _all(self, segment: Segment) -> list[Action]:
        return [*segment.actions, *([segment.behind] if segment.behind is not None else [])]

    def _variable(self, s: FlatSignal) -> None:
        """Declare a variable that is computed under a condition and read behind it."""
        name = self.places[s] = self.renderer.names.new(s.path)
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
            made += self.scope.fill(self.places[s], s.cleared, port, None, role="disabled outputs")
        return made

    def _segment(self, segment: Segment) -> None:
        """Add the outputs of a segment, then what stands behind them."""
        fixed = [s for a in segment.actions for s in a.signals if s in self.schedule.fixed]
        roots = [self.graph.signal(s) for s in fixed]
        for root in roots:
            if root.data in self.places:
                self.renderer.placed[id(root)] = self.places[root.data]
                if root.args[0].op in ("vector", "build", "store"):
                    self.renderer.targets.setdefault(id(root.args[0]), self.places[root.data])
        # What outputs and next states share is computed once, in one branch.
        updated = segment.updates
        if segment is self.schedule.segments[-1] and segment.guard.always:
            updated = [node for node in self.schedule.last if node.guard.always]
        roots += [e for node in updated for row in self._changes(node) for e in row.roots]
        behind = segment.behind
        if behind is not None and behind.start is None:
            roots += [self.graph.signal(s) for s in switch_inputs(behind.node)]
        self.renderer.texts(roots)
        for s in fixed:
            if s in self.fractions:
                self._set_edge(s)
        self._updates(segment.updates)
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
        test = all_of([self.signal(r) for r in behind.start.signals], " || ")
        self.renderer.out.append(IfStatement(test.text, self.scope.initial(node), owner=node, reads=test.reads))

    def _switch(self, node: Node, signals: Sequence[FlatSignal]) -> None:
        """Add a state machine as C that reads like its drawing."""
        machine = node.block
        assert isinstance(machine, StateMachine)
        renderer = self.renderer
        read = {self.graph.signal(s): self.signal(s) for s in switch_inputs(node)}
        outer, renderer.owner = renderer.owner, node
        for signal in signals:
            if signal not in self.places:
                self.places[signal] = renderer.names.new(signal.path)
                renderer.declare(self.places[signal], signal.kind, width=signal.width)
        states = {s.name: self.scope.state(node, s.name) for s in machine.states}
        targets = {s.port: self.places[s] for s in signals}
        MachineSwitch(self.scope, self.graph, renderer, node, machine, states, targets, read).write()
        self._stands(signals)
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
        commit(self.renderer, [row for node in nodes for row in self._changes(node)])

    def _changes(self, node: Node) -> list[StateChange]:
        values = {name: self.graph.of(node, e) for name, e in node.trace.update.items()}
        return changed(node, values, partial(self.scope.state, node))

    def returned(self) -> None:
        """Add the stores of outputs and logged signals in Y."""
        for path, signal in self.program.outputs.items():
            target, text = f"y->{self.layout.outputs[path].name}", self.signal(signal)
            role = "returned signals"
            self.renderer.out.append(stored(target, text.text, signal.kind, signal.width, None, text.reads, role))


def all_of(tests: Sequence[Text], sign: str = " && ") -> Text:
    """Return the condition that all of `tests` hold, or that they do with another operator between them."""
    return Text(sign.join(t.text for t in tests), reads=frozenset[str]().union(*(t.reads for t in tests)))
