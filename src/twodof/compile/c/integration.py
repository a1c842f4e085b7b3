"""The integration: what is held, one `derivative` function, Runge-Kutta or Euler, edges and projections."""

from collections.abc import Iterable, Sequence

from twodof.blocks.expressions.expr import LEAVES, Expr
from twodof.blocks.expressions.graph import ordered
from twodof.blocks.expressions.numbers import FLOATS
from twodof.compile.c.commit import Commit
from twodof.compile.c.expressions import Leaves
from twodof.compile.c.functions import Function
from twodof.compile.c.graph import leaf
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.scope import Scope
from twodof.compile.c.statements import Assign, Call, Copy, IfStatement, LoopStatement, Statement, Text, every, name_of
from twodof.compile.c.step import StepEmitter, all_of
from twodof.compile.program.flat_program import FlatSignal, Guard, Node
from twodof.compile.program.layout import Member, Struct

ONE_SIXTH = 1 / 6
LONGEST_INLINE = 300  # statements of a derivative that may appear four times in the machine code
HELD = frozenset(("held",))
MOVING = frozenset(("p", "held", "x", "to", "from", "slope"))


class IntegrationEmitter:
    """Writes the functions `derivative` and `integrate`, and the integration within the step function.

    What does not change inside a step is computed once, in the step, and passed in the struct Held.
    """

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.layout = scope.layout
        self.program = scope.program
        self.graph = scope.graph
        self.prefix = scope.program.name
        self.held = Struct()
        self.values: dict[Expr, Member] = {}
        self.active: dict[Guard, Member] = {}
        self._local: dict[FlatSignal, str] = {}  # of blocks that may be disabled
        self._inside = {s for group in self.program.stage for action in group.actions for s in action.signals}
        self._qualifier = "td_inline"

    def derivative(self) -> Function:
        """Return the function that gives the derivatives of the continuous states."""
        p = self.prefix
        names = self.scope.names("p", "held", "x", "slope")
        text = self.scope.leaf(self._signal, self._state, "held->tick")
        self.renderer = self.scope.renderer(names, Leaves(text, self._driver, owner=self.graph.owner))
        always = [n for n in self.program.integrated if n.guard.always]
        slopes = {
            n: [self.graph.of(n, n.trace.derivative[s.name]) for s in n.continuous] for n in self.program.integrated
        }
        for group in self.program.stage:
            if not group.guard.always:
                self._guarded_outputs(group.guard, [s for action in group.actions for s in action.signals])
        for node in self.program.integrated:
            if not node.guard.always:
                self._zero(node)
                self._steady(slopes[node])
                with self.renderer.within() as body:
                    self._slopes(node, slopes[node])
                self.renderer.out.append(self._branch(node.guard, body))
        self._steady(e for n in always for e in slopes[n])
        numbers = [e for n in always for e in slopes[n] if e.width is None]
        texts = iter(self.renderer.texts(numbers))
        for node in always:
            self._slopes(node, slopes[node], texts)
        body = self.renderer.out
        if sum(1 for _ in every(body)) > LONGEST_INLINE:
            self._qualifier = "static"
        parameters: tuple[str, ...] = (f"const {p}_P *restrict p", f"const {p}_Held *restrict held")
        parameters += (f"const {p}_X *restrict x", f"{p}_X *restrict slope")
        return Function(f"{self._qualifier} void", f"{p}_derivative", parameters, body, "derivative")

    def _guarded_outputs(self, guard: Guard, signals: Sequence[FlatSignal]) -> None:
        """Add the outputs of blocks that may be disabled, which start with their held values."""
        out = self.renderer.out
        for s in signals:
            held = f"held->{self._member(leaf(s)).name}"
            name = self._local[s] = self.renderer.names.new(s.path)
            value = held if s.width is None else ""
            out.append(Assign(name, value, C_TYPES[s.kind], s.width, owner=s.node, reads=HELD))
            if s.width is not None:
                out.append(Copy(name, held, s.width, C_TYPES[s.kind], owner=s.node, reads=HELD))
        roots = {s: self.graph.output(s) for s in signals}
        self._steady(roots.values())
        with self.renderer.within() as body:
            for s, root in roots.items():
                self.renderer.owner = s.node
                self.renderer.assign([(self._local[s], root)])
                self.renderer.owner = None
        self.renderer.out.append(self._branch(guard, body))
        self._inside.difference_update(signals)

    def _branch(self, guard: Guard, body: list[Statement]) -> IfStatement:
        if guard not in self.active:
            stem = "_".join(e.path for e in guard.enables)
            self.active[guard] = self.held.add(Member(f"{stem[:60]}_active", "bool", None))
        return IfStatement(f"held->{self.active[guard].name}", body, role="condition", reads=HELD)

    def _zero(self, node: Node) -> None:
        """Add derivatives of 0, for a node that is disabled."""
        for state in node.continuous:
            target = self._slope(node, state.name)
            if state.width is None:
                self.renderer.out.append(Assign(target, self.scope.constant(0.0, "real"), owner=node))
            else:
                self.renderer.out.append(
                    Call(f"(void)memset({target}, 0, sizeof {target});", owner=node, reads=frozenset(("slope",)))
                )

    def _slope(self, node: Node, name: str) -> str:
        return f"slope->{self.layout.states[node, name].name}"

    def _slopes(self, node: Node, roots: Sequence[Expr], texts: Iterable[Text] | None = None) -> None:
        """Add the derivatives of a node's states."""
        self.renderer.owner = node
        given = iter(self.renderer.texts(e for e in roots if e.width is None) if texts is None else texts)
        for state, root in zip(node.continuous, roots, strict=True):
            target = self._slope(node, state.name)
            if root.width is None:
                self.renderer.put(target, next(given))
            else:
                self.renderer.assign([(target, root)])
        self.renderer.owner = None

    def _signal(self, signal: FlatSignal) -> str:
        return self._local[signal] if signal in self._local else f"held->{self._member(leaf(signal)).name}"

    def _state(self, node: Node, name: str) -> str:
        """Return the C of a state within `derivative`: a continuous one is integrated, a discrete one held."""
        if not any(s.name == name for s in node.continuous):
            raise ValueError(f"{node.path}.{name} is not held")
        return f"x->{self.layout.states[node, name].name}"

    def _driver(self, item: Expr) -> Expr | None:
        signal: FlatSignal = item.data
        return self.graph.output(signal) if signal in self._inside else None

    def _below(self, item: Expr) -> tuple[Expr, ...]:
        driver = self._driver(item) if item.op == "input" else None
        return item.args if driver is None else (driver,)

    def _hold(self, item: Expr) -> None:
        """Read a value of the tick from Held."""
        self.renderer.know(item, Text(f"held->{self._member(item).name}", reads=HELD))

    def _member(self, item: Expr) -> Member:
        """Return the member of Held that has a value of the tick."""
        if item not in self.values:
            owner = self.graph.owner(item)
            name = f"{owner.path if owner is not None else 'tick'}.held"
            if item.op == "input":
                name = item.data.path
            elif item.op == "state":
                name = self.layout.states[item.data].name
            elif item.op == "tick":
                name = "tick"
            self.values[item] = self.held.add(Member(name, item.kind, item.width))
        return self.values[item]

    def _steady(self, roots: Iterable[Expr]) -> None:
        """Hold the largest expressions below `roots` worth computing once a step: they do not change inside it."""
        roots = list(roots)
        moves: dict[int, bool] = {}
        worth: dict[int, bool] = {}
        for e in ordered(roots, self._below):
            below = self._below(e)
            continuous = e.op == "state" and any(s.name == e.data[1] for s in e.data[0].continuous)
            moving = e.op == "input" and (e.data in self.program.moving or e.data in self._local)
            moves[id(e)] = continuous or moving or any(moves[id(a)] for a in below)
            worth[id(e)] = e.op in ("input", "state", "param", "tick", "call") or any(worth[id(a)] for a in below)
        seen: set[int] = set()
        stack = list(reversed(roots))
        while stack:
            e = stack.pop()
            if id(e) in seen:
                continue
            seen.add(id(e))
            if e.op in ("const", "param", "bound"):
                continue
            edged = e.op == "input" and e.data in self.program.moving and self._driver(e) is None
            if e.op in LEAVES and e.op != "input":
                if not moves[id(e)]:
                    self._hold(e)
            elif moves[id(e)] or e.loops or not worth[id(e)]:
                if edged and e.data not in self._local:
                    self._hold(e)
                stack.extend(reversed(self._below(e)))
            else:
                self._hold(e)

    def integrate(self) -> list[Function]:
        """Return the functions that move the continuous states by a step h."""
        p, members, real = self.prefix, self.layout.x.members, self.scope.constant
        made = []
        role = "integration"
        if self.program.integrator == "rk4":
            along = [_member("to->{m} = from->{m} + h * slope->{m};", m, role) for m in members]
            arguments: tuple[str, ...] = (
                f"{p}_X *restrict to",
                f"const {p}_X *restrict from",
                "real h",
                f"const {p}_X *restrict slope",
            )
            head = f"{self._qualifier} void"
            made.append(Function(head, f"{p}_along", arguments, along, "along", "to = from + h * slope"))
        arguments = (f"const {p}_P *restrict p", f"const {p}_Held *restrict held", f"{p}_X *restrict x", "real h")
        body: list[Statement] = []
        if self.program.integrator == "euler":
            body += [
                Call(line, role=role, reads=MOVING) for line in (f"{p}_X k1;", f"{p}_derivative(p, held, x, &k1);")
            ]
            body += [_member("x->{m} = x->{m} + h * k1.{m};", m, role) for m in members]
        else:
            body += [Call(f"{p}_X {name};", role=role) for name in ("k1", "k2", "k3", "k4", "at")]
            body.append(Call(f"const real half = h * {real(0.5, 'real')};", role=role))
            body.append(Call(f"const real sixth = h * {real(ONE_SIXTH, 'real')};", role=role))
            # The sum of the scalars' slopes is gathered in k1: k2 and k3 need no registers until the end.
            gathered = [m for m in members if m.width is None]
            two = real(2.0, "real")
            for k, before, step in ((1, 0, ""), (2, 1, "half"), (3, 2, "half"), (4, 3, "h")):
                if before:
                    body.append(Call(f"{p}_along(&at, x, {step}, &k{before});", role=role))
                if before > 1:
                    line = f"k1.{{m}} = k1.{{m}} + {two} * k{before}.{{m}};"
                    body += [_member(line, m, role) for m in gathered]
                body.append(
                    Call(f"{p}_derivative(p, held, {'&at' if before else 'x'}, &k{k});", role=role, reads=MOVING)
                )
            body += [_member("x->{m} = x->{m} + sixth * (k1.{m} + k4.{m});", m, role) for m in gathered]
            weighted = f"x->{{m}} = x->{{m}} + sixth * (((k1.{{m}} + {two} * k2.{{m}}) + {two} * k3.{{m}}) + k4.{{m}});"
            body += [_member(weighted, m, role) for m in members if m.width is not None]
        remark = f"Runge and Kutta's method of order 4 over h; {len(members)} continuous states."
        made.append(
            Function(
                f"{self._qualifier} void",
                f"{p}_integrate",
                arguments,
                body,
                "integrate",
                remark if self.program.integrator == "rk4" else "",
            )
        )
        return made

    def within_step(self, step: StepEmitter) -> None:
        """Add the statements of the step function that integrate the states into the local x, and project them."""
        renderer, p, role = step.renderer, self.prefix, "integration"
        roots = list(self.values)
        projected = [s for n in self.program.integrated for s in _read(n)]
        texts = renderer.texts([*roots, *(leaf(s) for s in projected)])
        out = renderer.out
        names = renderer.names
        x, held = names.new("x"), names.new("held")
        out.append(Call(f"{p}_Held {held};", role=role))
        if not self.held.members:
            out.append(Call(f"{held}.none = 0;", role=role))
        for (item, member), text in zip(self.values.items(), texts, strict=False):
            if not (item.op == "input" and item.data in step.fractions):
                owner = self.graph.owner(item) if item.op not in LEAVES else None
                out.append(Assign(f"{held}.{member.name}", text.text, owner=owner, role=role, reads=text.reads))
        for guard, member in self.active.items():
            test = all_of(step.tests(guard))
            out.append(Assign(f"{held}.{member.name}", test.text, role=role, reads=test.reads))
        out.append(Assign(x, "s->x", f"{p}_X", role=role, reads=frozenset(("s",))))
        dt = self.scope.constant(self.program.dt, "real")
        if step.fractions:
            self._parts(step, x, held, dt)
        else:
            out.append(Call(f"{p}_integrate(p, &{held}, &{x}, {dt});", role=role, reads=frozenset(("p", x))))
        for node in self.program.integrated:
            if node.trace.project:
                with renderer.within() as body:
                    self._project(step, node, x)
                if node.guard.always:
                    renderer.out += body
                else:
                    step.guarded(step.tests(node.guard), body)
        self.integrated = x

    def _parts(self, step: StepEmitter, x: str, held: str, dt: str) -> None:
        """Add the integration from edge to edge of a step."""
        renderer, role = step.renderer, "integration"
        start, end = renderer.names.new("from"), renderer.names.new("to")
        one, zero = self.scope.constant(1.0, "real"), self.scope.constant(0.0, "real")
        renderer.out.append(Call(f"real {start} = {zero};", role=role))
        renderer.out.append(Call(f"real {end};", role=role))
        body: list[Statement] = [Call(f"{end} = {one};", role=role)]
        for s, (fraction, after) in step.fractions.items():
            text = step.signal(s)
            changed = f"{text} != {after}"
            if self.scope.lean and s.kind in FLOATS:
                self.scope.used.helpers.add(f"{s.kind}_equal")
                changed = f"!{s.kind}_equal({text}, {after})"
            reads = frozenset((fraction, after, name_of(text)))
            test = f"{changed} && {fraction} > {start} && {fraction} < {end}"
            body.append(IfStatement(test, [Call(f"{end} = {fraction};", role=role)], role=role, reads=reads))
        for s, (fraction, after) in step.fractions.items():
            member = self.values.get(leaf(s))
            if member is not None:
                text = step.signal(s)
                reads = frozenset((fraction, after, name_of(text)))
                chosen = f"{start} >= {fraction} ? {after} : {text}"
                body.append(Call(f"{held}.{member.name} = {chosen};", role=role, reads=reads))
        move = f"{self.prefix}_integrate(p, &{held}, &{x}, ({end} - {start}) * {dt});"
        body += [Call(move, role=role, reads=frozenset(("p", x))), Call(f"{start} = {end};", role=role)]
        renderer.out.append(LoopStatement("do", body, f"while ({start} < {one});", role=role))

    def _project(self, step: StepEmitter, node: Node, x: str) -> None:
        def state(owner: Node, name: str) -> str:
            continuous = any(s.name == name for s in owner.continuous)
            return f"{x}.{self.layout.states[owner, name].name}" if continuous else self.scope.state(owner, name)

        text = self.scope.leaf(step.signal, state)
        renderer = self.scope.renderer(step.renderer.names, Leaves(text, owner=self.graph.owner))
        renderer.out = step.renderer.out
        values = {name: self.graph.of(node, e) for name, e in node.trace.project.items()}
        commit = Commit(node, values, lambda name: state(node, name))
        commit.write(renderer, renderer.texts(commit.roots))

    def commit(self, step: StepEmitter) -> None:
        """Add the continuous states of the next tick; those of disabled blocks keep theirs."""
        x, reads = self.integrated, frozenset(("s",))
        for node in self.program.integrated:
            if node.guard.always:
                continue
            body: list[Statement] = []
            for s in node.continuous:
                name = self.layout.states[node, s.name].name
                target, source = f"{x}.{name}", f"s->x.{name}"
                if s.width is None:
                    body.append(Assign(target, source, role="disabled states", reads=reads))
                else:
                    body.append(Copy(target, source, s.width, C_TYPES[s.kind], role="disabled states", reads=reads))
            tests = " && ".join(step.signal(e) for e in node.guard.enables)
            enables = frozenset(name_of(step.signal(e)) for e in node.guard.enables)
            step.renderer.out.append(IfStatement(f"!({tests})", body, role="disabled states", reads=enables))
        step.renderer.out.append(Call(f"s->x = {x};", role="next states", reads=reads | {x}))

    def declarations(self) -> list[str]:
        """Return the members of the struct Held; an array is held by its address."""
        made = [
            m.declaration() if m.width is None else f"const {C_TYPES[m.kind]} *{m.name};" for m in self.held.members
        ]
        return made or ["unsigned char none;"]


def _read(node: Node) -> list[FlatSignal]:
    """Return the signals that the projections of a node read."""
    names = {
        e.data for root in node.trace.project.values() for e in ordered([root], lambda e: e.args) if e.op == "input"
    }
    return [node.drivers[name] for name in sorted(names)]


def _member(line: str, m: Member, role: str) -> Statement:
    """Return a statement on a member, in a loop if it is an array."""
    if m.width is None:
        return Call(line.format(m=m.name), role=role, reads=MOVING)
    head = f"for (int32_t i = 0; i < {m.width}; i++)"
    return LoopStatement(head, [Call(line.format(m=f"{m.name}[i]"), role=role, reads=MOVING)], role=role)
