"""The C of the integration: what is held, one `derivative` function, Runge-Kutta or Euler, edges and projections."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial

from twodof.blocks.expressions.expr import LEAVES, Expr
from twodof.blocks.expressions.graph import walk
from twodof.blocks.expressions.kinds import FLOATS
from twodof.compile.c.expressions import Renderer
from twodof.compile.c.states.next_states import commit
from twodof.compile.c.tick import FROZEN, NEXT_TICK, Scope, TickEmitter, describe
from twodof.compile.c.writer import CWriter
from twodof.compile.program.flat_program import FlatSignal, Group, Guard, Node
from twodof.compile.program.layout import Member, Struct

ONE_SIXTH = 1 / 6
LONGEST_INLINE = 300  # lines of a derivative that may appear four times in the machine code


class IntegrationEmitter:
    """Writes the functions `derivative` and `integrate`, and the integration within the step function.

    What does not change inside a step is computed once, in the step, and passed in the struct Held.
    """

    def __init__(self, scope: Scope, prefix: str) -> None:
        self.scope = scope
        self.layout = scope.layout
        self.program = scope.program
        self.prefix = prefix
        self.held = Struct()
        self.captured: dict[FlatSignal, Member] = {}
        self.active: dict[Guard, Member] = {}
        self._states: dict[tuple[Node, str], Member] = {}
        self._hoisted: dict[tuple[Node, Expr], Member] = {}
        self._tick: Member | None = None
        self._qualifier = "td_inline"
        self.local: dict[FlatSignal, str] = {}  # the texts of signals that `derivative` computes
        self.renderers: dict[Node, Renderer] = {}

    def derivative(self, writer: CWriter) -> None:
        """The function that gives the derivatives of the continuous states."""
        self.writer = writer
        self.names = self.scope.names("p", "held", "x", "slope")
        p = self.prefix
        head = len(writer.lines)
        with writer.function(""):
            for group in self.program.stage:
                self._outputs(group)
            for node in self.program.integrated:
                self._slopes(node)
        if len(writer.lines) - head - 1 > LONGEST_INLINE:
            self._qualifier = "static"
        writer.lines[head] = (
            f"{self._qualifier} void {p}_derivative(const {p}_P *restrict p, const {p}_Held *restrict held, "
            f"const {p}_X *restrict x, {p}_X *restrict slope)"
        )

    def _outputs(self, group: Group) -> None:
        """The outputs of blocks that change inside a step; one that may be disabled starts with its held value."""
        always = group.guard.always
        for action in () if always else group.actions:
            self.writer.line(describe(action.node))
            for s in action.signals:
                held = f"held->{self._capture(s).name}"
                self._declare(s, f" = {held}" if s.width is None else "")
                if s.width is not None:
                    self.writer.duplicate(self.local[s], held, s.width, s.kind)
        with self._guarded(group.guard):
            for action in group.actions:
                node = action.node
                self.writer.line(describe(node))
                roots = [node.trace.outputs[s.port] for s in action.signals]
                renderer = self._renderer(node, roots)
                for s, root in zip(action.signals, roots, strict=True):
                    if always and s.width is None:
                        self.local[s] = self.names.new(s.path)
                        self.writer.line(f"const {self.scope.type(s.kind)} {self.local[s]} = {renderer.text(root)};")
                        continue
                    if always:
                        self._declare(s)
                    renderer.assign([(self.local[s], root)])

    def _declare(self, s: FlatSignal, value: str = "") -> None:
        self.local[s] = self.names.new(s.path)
        size = "" if s.width is None else f"[{s.width}]"
        self.writer.line(f"{self.scope.type(s.kind)} {self.local[s]}{size}{value};")

    def _slopes(self, node: Node) -> None:
        """The derivatives of a node's states: 0 where it is disabled."""
        writer = self.writer
        writer.line(describe(node))
        targets = [
            (f"slope->{self.layout.states[node, s.name].name}", node.trace.derivative[s.name]) for s in node.continuous
        ]
        if not node.guard.always:
            for (target, _), state in zip(targets, node.continuous, strict=True):
                if state.width is None:
                    writer.line(f"{target} = {self.scope.constant(0.0, 'real')};")
                else:
                    writer.line(f"(void)memset({target}, 0, sizeof {target});")
        with self._guarded(node.guard):
            self._renderer(node, [e for _, e in targets]).assign(targets)

    def _guarded(self, guard: Guard) -> AbstractContextManager[None]:
        if guard.always:
            return nullcontext()
        if guard not in self.active:
            stem = "_".join(e.path for e in guard.enables)
            self.active[guard] = self.held.add(Member(f"{stem[:60]}_active", "bool", None))
        return self.writer.choice("", [f"held->{self.active[guard].name}"])

    def _renderer(self, node: Node, roots: Sequence[Expr]) -> Renderer:
        known = {e: f"held->{self._hoist(node, e).name}" for e in self._steady(node, roots)}
        if node in self.renderers:
            self.renderers[node].learn(known)
            return self.renderers[node]

        def signal(s: FlatSignal) -> str:
            return self.local[s] if s in self.local else f"held->{self._capture(s).name}"

        leaf = self.scope.leaf(node, signal, partial(self._state, node), "held->tick")
        if self._tick is None and any(e.op == "tick" for e in walk(roots)):
            self._tick = self.held.add(Member("tick", "uint32", None))
        made = self.scope.renderer(self.writer, self.names, leaf, node.path, known)
        if node.guard.always:
            self.renderers[node] = made
        return made

    def _state(self, node: Node, name: str) -> str:
        """The text of a state within `derivative`: a continuous one is integrated, a discrete one held."""
        if any(s.name == name for s in node.continuous):
            return f"x->{self.layout.states[node, name].name}"
        if (node, name) not in self._states:
            member = self.layout.states[node, name]
            self._states[node, name] = self.held.add(Member(member.name, member.kind, member.width))
        return f"held->{self._states[node, name].name}"

    def _capture(self, s: FlatSignal) -> Member:
        if s not in self.captured:
            self.captured[s] = self.held.add(Member(s.path, s.kind, s.width))
        return self.captured[s]

    def _hoist(self, node: Node, e: Expr) -> Member:
        if (node, e) not in self._hoisted:
            self._hoisted[node, e] = self.held.add(Member(f"{node.path}.held", e.kind, e.width))
        return self._hoisted[node, e]

    def _steady(self, node: Node, roots: Sequence[Expr]) -> list[Expr]:
        """The largest sub-expressions of `roots` worth computing once a step: they do not change inside it."""
        own = {s.name for s in node.continuous}
        moves: dict[int, bool] = {}
        worth: dict[int, bool] = {}
        for e in walk(roots):
            moves[id(e)] = (
                (e.op == "state" and e.data in own)
                or (e.op == "input" and node.drivers[e.data] in self.program.moving)
                or any(moves[id(a)] for a in e.args)
            )
            worth[id(e)] = e.op in ("input", "state", "param", "tick", "call") or any(worth[id(a)] for a in e.args)
        found: list[Expr] = []
        seen: set[int] = set()
        stack = list(reversed(roots))
        while stack:
            e = stack.pop()
            if id(e) in seen:
                continue
            seen.add(id(e))
            if moves[id(e)] or e.loops or not worth[id(e)]:
                stack.extend(reversed(e.args))
            elif e.op not in LEAVES:
                found.append(e)
        return found

    def integrate(self, writer: CWriter) -> None:
        """The functions that move the continuous states by a step h."""
        p, members = self.prefix, self.layout.x.members
        real, style = self.scope.constant, self.scope.style
        h = style.types["real"]
        if self.program.integrator == "rk4":
            writer.lines.append("/* to = from + h * slope */")
            arguments = f"{p}_X *restrict to, const {p}_X *restrict from, {h} h, const {p}_X *restrict slope"
            with writer.function(f"{self._qualifier} void {p}_along({arguments})"):
                self._each(writer, "to->{m} = " + style.along.format("from->{m}", "slope->{m}") + ";", members)
            writer.lines.append(f"/* Runge and Kutta's method of order 4 over h; {len(members)} continuous states. */")
        arguments = f"const {p}_P *restrict p, const {p}_Held *restrict held, {p}_X *restrict x, {h} h"
        with writer.function(f"{self._qualifier} void {p}_integrate({arguments})"):
            if self.program.integrator == "euler":
                writer.line(f"{p}_X k1;")
                writer.line(f"{p}_derivative(p, held, x, &k1);")
                self._each(writer, "x->{m} = " + style.along.format("x->{m}", "k1.{m}") + ";", members)
            else:
                for name in ("k1", "k2", "k3", "k4", "at"):
                    writer.line(f"{p}_X {name};")
                writer.line(f"const {h} half = {style.product('h', real(0.5, 'real'))};")
                writer.line(f"const {h} sixth = {style.product('h', real(ONE_SIXTH, 'real'))};")
                # The sum of the scalars' slopes is gathered in k1: k2 and k3 need no registers until the end.
                gathered = [m for m in members if m.width is None and style.gathers]
                two = real(2.0, "real")
                for k, before, step in ((1, 0, ""), (2, 1, "half"), (3, 2, "half"), (4, 3, "h")):
                    if before:
                        writer.line(f"{p}_along(&at, x, {step}, &k{before});")
                    if before > 1:
                        self._each(writer, f"k1.{{m}} = k1.{{m}} + {two} * k{before}.{{m}};", gathered)
                    writer.line(f"{p}_derivative(p, held, {'&at' if before else 'x'}, &k{k});")
                self._each(writer, "x->{m} = x->{m} + sixth * (k1.{m} + k4.{m});", gathered)
                whole = [m for m in members if m not in gathered]
                self._each(writer, "x->{m} = " + style.weighted.replace("{two}", two) + ";", whole)

    def _each(self, writer: CWriter, line: str, members: Iterable[Member]) -> None:
        for m in members:
            if m.width is None:
                writer.line(line.format(m=m.name))
            else:
                with writer.block(f"for (int32_t i = 0; i < {m.width}; i++)"):
                    writer.line(line.format(m=f"{m.name}[i]"))

    def within_step(self, tick: TickEmitter) -> None:
        """The lines of the step function that integrate the continuous states into the local x, and project them."""
        writer, names, p = tick.writer, tick.names, self.prefix
        x, held = names.new("x"), names.new("held")
        writer.line(f"{p}_Held {held};")
        if not self.held.members:
            writer.line(f"{held}.none = 0;")
        for s, member in self.captured.items():
            if s not in tick.fractions:
                writer.line(f"{held}.{member.name} = {tick.signal(s)};")
        for (node, name), member in self._states.items():
            state = next(s for s in node.discrete if s.name == name)
            writer.line(f"{held}.{member.name} = {self.scope.state(node, state)};")
        if self._tick is not None:
            writer.line(f"{held}.{self._tick.name} = s->tick;")
        for guard, member in self.active.items():
            writer.line(f"{held}.{member.name} = {self.scope.style.truth(*tick.terms(guard))};")
        for node in dict.fromkeys(n for n, _ in self._hoisted):
            mine = [(e, m) for (n, e), m in self._hoisted.items() if n is node]
            texts = tick.renderer(node).scalars([e for e, _ in mine])
            for (text, _), (_, member) in zip(texts, mine, strict=True):
                writer.line(f"{held}.{member.name} = {text};")
        writer.line(f"{p}_X {x} = s->x;")
        dt = self.scope.constant(self.program.dt, "real")
        if tick.fractions:
            self._pieces(tick, x, held, dt)
        else:
            writer.line(f"{p}_integrate(p, &{held}, &{x}, {dt});")
        for node in self.program.integrated:
            if node.trace.project:
                with nullcontext() if node.guard.always else writer.choice(*tick.terms(node.guard)):
                    self._project(tick, node, x)
        self.integrated = x

    def _pieces(self, tick: TickEmitter, x: str, held: str, dt: str) -> None:
        """The integration in pieces that end where an edged output changes."""
        writer, names = tick.writer, tick.names
        start, end = names.new("from"), names.new("to")
        style, real = self.scope.style, self.scope.type("real")
        one, zero = self.scope.constant(1.0, "real"), self.scope.constant(0.0, "real")
        writer.line(f"{real} {start} = {zero};")
        writer.line(f"{real} {end};")
        writer.line("do {")
        writer.depth += 1
        writer.line(f"{end} = {one};")
        for s, (fraction, after) in tick.fractions.items():
            changed = style.compared("!=", tick.signal(s), after, s.kind)
            if writer.lean and s.kind in FLOATS:
                writer.helpers.add(f"{s.kind}_equal")
                changed = f"!{s.kind}_equal({tick.signal(s)}, {after})"
            inside = [style.compared(">", fraction, start), style.compared("<", fraction, end)]
            with writer.choice("", [changed, *inside]):
                writer.assign(end, fraction, "real")
        for s, (fraction, after) in tick.fractions.items():
            if s in self.captured:
                chosen = style.chosen(style.compared(">=", start, fraction), after, tick.signal(s), s.kind)
                writer.line(f"{held}.{self.captured[s].name} = {chosen};")
        with style.moving(writer, names, self.prefix, self.layout.x.members, start, x) as moved:
            writer.line(f"{self.prefix}_integrate(p, &{held}, &{moved}, {style.piece(start, end, dt)});")
        writer.line(f"{start} = {end};")
        writer.depth -= 1
        writer.line(f"}} while ({style.anywhere(style.compared('<', start, one))});")

    def _project(self, tick: TickEmitter, node: Node, x: str) -> None:
        tick.writer.line(describe(node))
        lvalues = {
            s.name: f"{x}.{self.layout.states[node, s.name].name}" if s.continuous else self.scope.state(node, s)
            for s in node.block.states
        }
        leaf = self.scope.leaf(node, tick.signal, lvalues.__getitem__, "s->tick")
        renderer = self.scope.renderer(tick.writer, tick.names, leaf, node.path)
        commit(tick.writer, renderer, tick.names, node, node.trace.project, lvalues)

    def commit(self, tick: TickEmitter) -> None:
        """The continuous states of the next tick; those of disabled blocks keep theirs."""
        writer, x = tick.writer, self.integrated
        frozen = [node for node in self.program.integrated if not node.guard.always]
        if frozen:
            writer.line(FROZEN)
        for node in frozen:
            style = self.scope.style
            _, enables = tick.terms(node.guard)  # continuous states live at the base rate, which is always due
            with writer.choice("", [style.negation(style.conjunction(enables))]):
                for s in node.continuous:
                    name = self.layout.states[node, s.name].name
                    if s.width is None:
                        writer.assign(f"{x}.{name}", f"s->x.{name}", s.kind)
                    else:
                        writer.duplicate(f"{x}.{name}", f"s->x.{name}", s.width, s.kind)
        writer.line(NEXT_TICK)
        writer.line(f"s->x = {x};")

    def declarations(self) -> Iterator[str]:
        """The members of the struct Held; an array is held by its address."""
        for m in self.held.members:
            if m.width is None:
                yield m.declaration(self.scope.style.types)
            else:
                yield f"const {self.scope.type(m.kind)} *{m.name};"
        if not self.held.members:
            yield "unsigned char none;"
