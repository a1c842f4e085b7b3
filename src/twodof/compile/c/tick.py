"""The C of one tick: outputs, returned signals, discrete states."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext

from twodof.blocks.declarations import Param, Port, State, column_major
from twodof.blocks.diagram import Rate
from twodof.blocks.expressions.expr import LEAVES, Expr
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.state_machine import StateMachine
from twodof.compile.c.expressions import Renderer, Text, constant
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import ATOM, C_TYPES, LOOSE
from twodof.compile.c.states.machine_switch import MachineSwitch
from twodof.compile.c.states.next_states import changes, commit, numbers_of
from twodof.compile.c.style import SCALAR, CStyle
from twodof.compile.c.writer import CWriter
from twodof.compile.program.derived import in_doubles
from twodof.compile.program.flat_program import Action, FlatProgram, FlatSignal, Group, Guard, Need, Node, Start
from twodof.compile.program.layout import Member, MemoryLayout
from twodof.compile.program.lower import inputs_of

TICKS = 2**32  # a tick is a uint32
# Comments above lines that belong to no single block; `twodof.compile.c_files.source_map` reads them.
RATES_DUE = "/* which rates are due */"
DISABLED = "/* outputs of what is disabled */"
RETURNED = "/* what is returned */"
INTEGRATION = "/* the continuous states of the next tick */"
FROZEN = "/* what is disabled keeps its continuous states */"
NEXT_TICK = "/* the next tick */"
# What a body may name.
OWN = (
    *("P", "S", "U", "Y", "X", "Held", "derivative", "integrate", "along", "advance", "step", "run"),
    *("Ahead", "AHEAD", "look_ahead", "ticks"),
)


class Scope:
    """What the functions of one program share: its layout, precision and the text of leaves."""

    def __init__(self, program: FlatProgram, layout: MemoryLayout, precision: str, style: CStyle = SCALAR) -> None:
        self.program = program
        self.layout = layout
        self.precision = precision
        self.style = style
        self.defined: set[str] = set()  # what the program defines beside OWN

    def names(self, *arguments: str) -> CNames:
        """Identifiers of a function: its locals must not hide its `arguments` or what the program defines."""
        own = (f"{self.program.name}_{own}" for own in OWN)
        return CNames({*arguments, *own, *self.defined, *self.style.reserved})

    def constant(self, value: object, kind: str) -> str:
        """A literal of the program's precision."""
        return self.style.same(constant(value, kind, self.precision)[0], kind)

    def type(self, kind: str) -> str:
        """The C type of a value of one instance, or of all the lanes'."""
        return self.style.types[kind]

    def renderer(
        self,
        writer: CWriter,
        names: CNames,
        leaf: Callable[[Expr], Text],
        stem: str,
        known: Mapping[Expr, str] | None = None,
    ) -> Renderer:
        """What writes a block's expressions."""
        return self.style.renderer(writer, names, self.precision, leaf, stem, known)

    def leaf(
        self, node: Node, signal: Callable[[FlatSignal], str], state: Callable[[str], str], tick: str
    ) -> Callable[[Expr], Text]:
        """The C text of `node`'s leaves; `state` gives that of its own states by name."""

        def text(item: Expr) -> Text:
            if item.op == "input":
                return signal(node.drivers[item.data]), ATOM
            if item.op == "state":
                return state(item.data), ATOM
            if item.op == "param":
                return self.given(node, item.data), ATOM
            if item.op == "tick":
                return self.style.same(tick, "uint32"), ATOM
            seconds = self.program.dt * (node.rate.divider if item.data == "dt" else 1)
            return self.style.literal(*constant(seconds, item.kind, self.precision), item.kind)

        return text

    def parameter(self, node: Node, name: str) -> Member:
        """The member of P that a block's parameter (given or derived) stands for."""
        if name in node.parameters:
            return self.layout.parameters[node.parameters[name]]
        return self.layout.derived[node, name]

    def given(self, node: Node, name: str) -> str:
        """The C text of a block's parameter (given or derived)."""
        return f"p->{self.parameter(node, name).name}"

    def state(self, node: Node, state: State) -> str:
        """The lvalue of a state."""
        prefix = "s->x." if state.continuous else "s->"
        return prefix + self.layout.states[node, state.name].name

    def initial(self, writer: CWriter, node: Node, state: State, target: str) -> None:
        """Lines that set a state to its initial value."""
        if isinstance(state.initial, str):
            source = self.given(node, state.initial)
            if state.width is None:
                writer.assign(target, source, state.kind)
            else:
                writer.duplicate(target, source, state.width, state.kind)
            return
        self.fill(writer, target, state.initial, state)

    def prepare(self, writer: CWriter, names: CNames, node: Node, stem: str = "") -> None:
        """Lines that compute a block's derived parameters."""
        leaf_text = self.leaf(node, lambda s: s.path, str, "")
        renderer = self.renderer(writer, names, leaf_text, stem or node.path)
        exprs = in_doubles(node.trace.prepare) if self.precision == "float32" else node.trace.prepare
        renderer.assign([(self.given(node, name), e) for name, e in exprs.items()])

    def fill(self, writer: CWriter, target: str, value: object, declared: Port | State | Param) -> None:
        """Lines that store a constant number, or a sequence of them, in `target`."""
        kind, width = declared.kind, declared.width
        if width is None:
            writer.assign(target, self.constant(value, kind), kind)
            return
        flat = column_major(value, declared.shape, declared.name) if declared.shape else value
        values = list(flat) if isinstance(flat, (list, tuple)) else [flat]
        texts = [constant(v, kind, self.precision)[0] for v in values]
        if len(set(texts)) == 1:
            with writer.block(f"for (int32_t i = 0; i < {width}; i++)"):
                writer.assign(f"{target}[i]", self.style.same(texts[0], kind), kind)
        else:
            with writer.block(""):
                writer.line(f"static const {C_TYPES[kind]} initial[{width}] = {{{', '.join(texts)}}};")
                writer.table(target, "initial", width, kind)


def describe(node: Node) -> str:
    """A block's path and type, for a comment."""
    kind = node.block.type_name or type(node.block).__name__
    legend = "".join(f"; {e}" for e in node.enumerations)
    named = kind.isascii() and kind.isidentifier()
    return f"/* {node.path}: {kind}{legend} */" if named else f"/* {node.path}{legend} */"


class TickEmitter:
    """Writes the body of the step function, apart from the integration."""

    def __init__(self, scope: Scope, writer: CWriter, names: CNames) -> None:
        self.scope = scope
        self.layout = scope.layout
        self.program = scope.program
        self.writer = writer
        self.names = names
        self.texts: dict[FlatSignal, str] = {}
        self.renderers: dict[Node, Renderer] = {}
        self.computed: set[FlatSignal | Start] = set()  # what has been done so far
        self.updated: set[Node] = set()
        self.stored: dict[Node, dict[Expr, str]] = {}  # expressions that stand in S, or are known ahead
        self.fractions: dict[FlatSignal, tuple[str, str]] = {}  # edged signal -> names of its fraction and later value
        self._due: dict[Rate, str] = {}
        self._asked: set[Rate] = set()
        self._tick_signals = {s for g in self.program.tick for a in g.actions for s in a.signals}

    def signal(self, signal: FlatSignal) -> str:
        """The C text of a signal's value at the tick."""
        if signal.node is None:
            return f"u->{self.layout.inputs[signal].name}"
        if signal in self.layout.stored:
            return f"s->{self.layout.stored[signal].name}"
        return self.texts[signal]

    def renderer(self, node: Node) -> Renderer:
        """A node has one renderer in each C block, so that its temporaries serve everything that is computed there."""
        if node in self.renderers:
            return self.renderers[node]
        states = {s.name: self.scope.state(node, s) for s in node.block.states}
        leaf = self.scope.leaf(node, self.signal, states.__getitem__, "s->tick")
        made = self.scope.renderer(self.writer, self.names, leaf, node.path, self.stored.get(node))
        made.expect(node.trace.update.values())
        self.renderers[node] = made
        return made

    @contextmanager
    def guarded(self, guard: Guard) -> Iterator[None]:
        """An `if` block; what is declared in it is forgotten at its end."""
        outside = self.renderers
        self.renderers = dict(outside)
        with self.writer.choice(*self.terms(guard)):
            yield
        self.renderers = outside

    def due(self) -> None:
        """Take names that say which rates are due, and keep their place: here `write_due` writes them."""
        for node in self.program.nodes:
            rate = node.rate
            if rate.divider > 1 and rate not in self._due:
                self._due[rate] = self.names.new(f"due_{rate.divider}_{rate.offset}")
        self._due_line = len(self.writer.lines)

    def write_due(self) -> None:
        """Lines that say of the rates that were asked for whether they are due."""
        lines = []
        for rate in (rate for rate in self._due if rate in self._asked):
            due = f"s->tick % {rate.divider}u == {rate.offset}u"
            if rate.divider >= TICKS:  # sub-diagrams multiply their rates
                due = f"s->tick == {rate.offset}u" if rate.offset < TICKS else "false"
            lines.append(f"    const bool {self._due[rate]} = {due};")
        self.writer.lines[self._due_line : self._due_line] = [f"    {RATES_DUE}", *lines] if lines else []

    def terms(self, guard: Guard) -> tuple[str, list[str]]:
        """The C conditions under which a guard's nodes act: that the rate is due ("" if always), and the enables."""
        self._asked.add(guard.rate)
        return self._due.get(guard.rate, ""), [self.signal(e) for e in guard.enables]

    def outputs(self) -> None:
        """The outputs of all blocks, group by group."""
        for signal in self.program.edged:
            fraction, after = self.names.new(f"{signal.path}.fraction"), self.names.new(f"{signal.path}.after")
            self.fractions[signal] = fraction, after
            node = signal.node
            if node is not None and not node.guard.always:
                self.writer.line(describe(node))
                for name, value in ((fraction, 1.0), (after, 0.0)):
                    self.writer.line(f"{self.scope.type('real')} {name} = {self.scope.constant(value, 'real')};")
        for group in self.program.tick:
            if group.needs and (self.scope.style.branches or not group.guard.always):
                self._where_needed(group)
                continue
            if group.guard.always:
                for action in group.actions:
                    self._action(action)
                continue
            signals = [s for action in group.actions for s in action.signals]
            self._declare(s for s in signals if s in self.layout.passing)
            with self.guarded(group.guard):
                for action in group.actions:
                    self._action(action)
                self._early_updates(group.guard)
            if group.guard.clears and (held := [s for s in signals if s not in self.layout.passing]):
                style = self.scope.style
                self.writer.line(DISABLED)
                cleared = style.negation(style.conjunction([self.signal(e) for e in group.guard.clears]))
                with self.writer.choice(self.terms(group.guard)[0], [cleared]):
                    for s in held:
                        port = Port("y", s.kind, s.width, shape=s.shape)
                        self.scope.fill(self.writer, self.signal(s), s.cleared, port)

    def _where_needed(self, group: Group) -> None:
        """Outputs that nobody reads unless some conditions hold; they stand in variables that are 0 otherwise."""
        self._declare(s for action in group.actions for s in action.signals)
        with nullcontext() if group.guard.always else self.guarded(group.guard):
            tests = self._tests(group.needs) if self.scope.style.branches else []
            outside, self.renderers = self.renderers, {}  # what is declared inside is not seen behind it
            with self.writer.choice("", tests) if tests else nullcontext():
                for action in group.actions:
                    self.writer.line(describe(action.node))
                    self._assigned(action)
                    self.computed.update(action.signals)
            self.renderers = outside

    def _declare(self, signals: Iterable[FlatSignal]) -> None:
        """Variables for numbers that are computed in brackets and read behind them."""
        for s in signals:
            self.texts[s] = self.names.new(s.path)
            self.writer.line(f"{self.scope.type(s.kind)} {self.texts[s]} = {self.scope.constant(0, s.kind)};")

    def _assigned(self, action: Action) -> None:
        """Lines that store an action's outputs in variables that are there."""
        roots = [(self.texts[s], action.node.trace.outputs[s.port]) for s in action.signals]
        self.renderer(action.node).assign(roots)

    def _tests(self, needs: Iterable[Need]) -> list[str]:
        """The C of conditions."""
        tests = []
        for need in needs:
            text, binding = self.renderer(need.node).scalars([need.condition])[0]
            tests.append(f"({text})" if need.holds and binding == LOOSE else text if need.holds else f"!({text})")
        return tests

    def _action(self, action: Action) -> None:
        node, write = action.node, self.writer
        write.line(describe(node))
        if action.start is not None:
            with write.choice("", [self.scope.style.disjunction([self.signal(r) for r in action.start.signals])]):
                for state in node.block.states:
                    self.scope.initial(write, node, state, self.scope.state(node, state))
            self.computed.add(action.start)
            return
        if self._switches(node, action.signals):
            self._switch(node, action.signals)
            return
        renderer = self.renderer(node)
        roots = [node.trace.outputs[s.port] for s in action.signals]
        at_once = self._may_update(node, action.signals)
        shared = [*roots, *(numbers_of(node.trace.update) if at_once else ())]
        own = set(action.signals).intersection(node.drivers.values())
        renderer.prepare(r for r in shared if not own or own.isdisjoint(inputs_of(node, [r])))
        together: dict[FlatSignal, Expr] = {}  # outputs that share their temporaries, as none reads another
        for signal, root in zip(action.signals, roots, strict=True):
            kept = signal in self.layout.stored or signal in self.texts
            if not kept or together.keys() & inputs_of(node, [root]):
                self._store(renderer, node, together)
                together = {}
            if kept:
                together[signal] = root
            else:
                self._output(renderer, signal, root)
        self._store(renderer, node, together)
        for signal in action.signals:
            if signal in self.fractions:
                fraction, after = node.trace.edges[signal.port]
                for name, root in zip(self.fractions[signal], (fraction, after), strict=True):
                    if node.guard.always:
                        write.line(f"const {self.scope.type('real')} {name} = {renderer.text(root)};")
                    else:
                        write.assign(name, renderer.text(root), "real")
        self.computed.update(action.signals)
        if at_once or self._may_update(node):
            self.updated.add(node)
            self._commit(node)

    def _switches(self, node: Node, signals: Sequence[FlatSignal]) -> bool:
        """Whether this is the whole tick of a state machine: all outputs that are read, and what it needs is there."""
        if not (isinstance(node.block, StateMachine) and self.scope.style.branches) or node in self.updated:
            return False
        given = {s for s in node.outputs.values() if s in self._tick_signals}
        # What no output and no state needs is read by nobody else perhaps, and is then not computed at all.
        needed = {s for s in inputs_of(node, node.block.graph.expressions) if s.node is not None}
        return given == set(signals) and self.computed.issuperset([*needed, *node.starts])

    def _switch(self, node: Node, signals: Sequence[FlatSignal]) -> None:
        """A state machine as C that reads like its drawing."""
        write, machine = self.writer, node.block
        assert isinstance(machine, StateMachine)
        targets = {}
        for signal in signals:
            if signal not in self.layout.stored and signal not in self.texts:
                self.texts[signal] = self.names.new(signal.path)
                size = "" if signal.width is None else f"[{signal.width}]"
                write.elements += signal.width or 0
                write.line(f"{self.scope.type(signal.kind)} {self.texts[signal]}{size};")
            targets[signal.port] = self.signal(signal)

        def renderer(state: Callable[[str], str]) -> Renderer:
            leaf = self.scope.leaf(node, self.signal, state, "s->tick")
            return self.scope.renderer(write, self.names, leaf, node.path)

        def replace(renderer: Renderer, values: Mapping[str, Expr], lvalues: Mapping[str, str]) -> None:
            commit(write, renderer, self.names, node, values, lvalues)

        states = {s.name: self.scope.state(node, s) for s in machine.states}
        MachineSwitch(write, machine, states, targets, renderer, replace).write()
        self.computed.update(signals)
        self.updated.add(node)

    def _store(self, renderer: Renderer, node: Node, outputs: Mapping[FlatSignal, Expr]) -> None:
        renderer.assign([(self.signal(s), root) for s, root in outputs.items()])
        known = {root: self.signal(s) for s, root in outputs.items() if root.op not in LEAVES}
        renderer.learn(known)
        self.stored.setdefault(node, {}).update(known)

    def _output(self, renderer: Renderer, signal: FlatSignal, root: Expr) -> None:
        ctype = self.scope.type(signal.kind)
        name = self.names.new(signal.path)
        self.texts[signal] = name
        if signal.width is None:
            self.writer.line(f"const {ctype} {name} = {renderer.text(root)};")
            if root.op not in LEAVES:
                renderer.learn({root: name})
        elif root.op in ("input", "param"):
            self.writer.line(f"const {ctype} *const {name} = {renderer.text(root)};")
        else:
            self.writer.elements += signal.width
            self.writer.line(f"{ctype} {name}[{signal.width}];")
            renderer.assign([(name, root)])

    def returned(self) -> None:
        """The outputs and logged signals."""
        for path, signal in self.program.outputs.items():
            member = f"y->{self.layout.outputs[path].name}"
            if signal.width is None:
                self.writer.line(f"{member} = {self.signal(signal)};")
            else:
                self.writer.duplicate(member, self.signal(signal), signal.width, signal.kind)

    def updates(self) -> None:
        """The next discrete states. A block's own are the only ones that its update reads."""
        by_guard: dict[Guard, list[Node]] = {}
        for node in self._changing():
            if node not in self.updated:
                by_guard.setdefault(node.guard, []).append(node)
        for guard in sorted(by_guard, key=lambda g: not g.always):
            if guard.always:
                for node in by_guard[guard]:
                    self._update(node)
                continue
            with self.guarded(guard):
                for node in by_guard[guard]:
                    self._update(node)

    def _changing(self) -> list[Node]:
        """The nodes with discrete states that may change."""
        return [n for n in self.program.nodes if changes(n)]

    def _early_updates(self, guard: Guard) -> None:
        """The updates of nodes of `guard` that need nothing more."""
        for node in self._changing():
            if node.guard == guard and self._may_update(node):
                self.updated.add(node)
                self._update(node)

    def _may_update(self, node: Node, now: Sequence[FlatSignal] = ()) -> bool:
        """Whether a node's states can be replaced at once, when its outputs `now` are computed too.

        Then they share what both need, and nothing has to be kept until the end.
        Nobody but a block itself reads its states, and only one with continuous states reads them again in this tick.
        """
        if node.continuous or node in self.updated or not changes(node):
            return False
        read = [node.drivers[name] for name in leaves(node.trace.update.values(), "input")]
        needed = {s for s in read if s in self._tick_signals}
        own = {s for s in node.outputs.values() if s in self._tick_signals}
        return self.computed.issuperset([*needed, *own.difference(now), *node.starts])

    def _update(self, node: Node) -> None:
        self.writer.line(describe(node))
        if self._switches(node, ()):
            self._switch(node, ())
            return
        self._commit(node)

    def _commit(self, node: Node) -> None:
        texts = {s.name: self.scope.state(node, s) for s in node.discrete}
        commit(self.writer, self.renderer(node), self.names, node, node.trace.update, texts)
