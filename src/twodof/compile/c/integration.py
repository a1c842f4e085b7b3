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
ROLE = "integration"
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
        p = self.prefix
        arguments = (f"const {p}_P *restrict p", f"const {p}_Held *restrict held", f"{p}_X *restrict x", "real h")
        head = f"{self._qualifier} void"
        if self.program.integrator == "euler":
            return [Function(head, f"{p}_integrate", arguments, self._euler(), "integrate")]
        remark = f"Runge and Kutta's method of order 4 over h; {len(self.layout.x.members)} continuous states."
        return [self._along(head), Function(head, f"{p}_integrate", arguments, self._rk4(), "integrate", remark)]

    def _each(self, line: str) -> list[Statement]:
        """Return a statement on each continuous state `{m}`."""
        return [_member(line, m) for m in self.layout.x.members]

    def _derive(self, x: str, slope: str) -> Statement:
        return Call(f"{self.prefix}_derivative(p, held, {x}, &{slope});", role=ROLE, reads=MOVING)

    def _euler(self) -> list[Statement]:
        declared = Call(f"{self.prefix}_X k1;", role=ROLE)
        return [declared, self._derive("x", "k1"), *self._each("x->{m} = x->{m} + h * k1.{m};")]

    def _along(self, head: str) -> Function:
        p = self.prefix
        arguments = (f"{p}_X *restrict to", f"const {p}_X *restrict from", "real h", f"const {p}_X *restrict slope")
        body = self._each("to->{m} = from->{m} + h * slope->{m};")
        return Function(head, f"{p}_along", arguments, body, "along", "to = from + h * slope")

    def _rk4(self) -> list[Statement]:
        p, constant = self.prefix, self.scope.constant
        numbers = [m for m in self.layout.x.members if m.width is None]
        arrays = [m for m in self.layout.x.members if m.width is not None]
        two = constant(2.0, "real")
        lines = [f"{p}_X {name};" for name in ("k1", "k2", "k3", "k4", "at")]
        lines += [f"const real half = h * {constant(0.5, 'real')};"]
        lines += [f"const real sixth = h * {constant(ONE_SIXTH, 'real')};"]
        body: list[Statement] = [Call(line, role=ROLE) for line in lines]
        body.append(self._derive("x", "k1"))
        for k, step in ((2, "half"), (3, "half"), (4, "h")):
            body.append(Call(f"{p}_along(&at, x, {step}, &k{k - 1});", role=ROLE))
            if k > 2:  # the sum of the numbers' slopes is gathered in k1: k2 and k3 need no registers until the end
                body += [_member(f"k1.{{m}} = k1.{{m}} + {two} * k{k - 1}.{{m}};", m) for m in numbers]
            body.append(self._derive("&at", f"k{k}"))
        body += [_member("x->{m} = x->{m} + sixth * (k1.{m} + k4.{m});", m) for m in numbers]
        weighted = f"x->{{m}} = x->{{m}} + sixth * (((k1.{{m}} + {two} * k2.{{m}}) + {two} * k3.{{m}}) + k4.{{m}});"
        return [*body, *(_member(weighted, m) for m in arrays)]

    def within_step(self, step: StepEmitter) -> None:
        """Add the statements of the step function that integrate the states into the local x, and project them."""
        renderer, p = step.renderer, self.prefix
        roots = list(self.values)
        projected = [s for n in self.program.integrated for s in _read(n)]
        texts = renderer.texts([*roots, *(leaf(s) for s in projected)])
        out = renderer.out
        names = renderer.names
        x, held = names.new("x"), names.new("held")
        out.append(Call(f"{p}_Held {held};", role=ROLE))
        if not self.held.members:
            out.append(Call(f"{held}.none = 0;", role=ROLE))
        for (item, member), text in zip(self.values.items(), texts, strict=False):
            if not (item.op == "input" and item.data in step.fractions):
                owner = self.graph.owner(item) if item.op not in LEAVES else None
                out.append(Assign(f"{held}.{member.name}", text.text, owner=owner, role=ROLE, reads=text.reads))
        for guard, member in self.active.items():
            test = all_of(step.tests(guard))
            out.append(Assign(f"{held}.{member.name}", test.text, role=ROLE, reads=test.reads))
        out.append(Assign(x, "s->x", f"{p}_X", role=ROLE, reads=frozenset(("s",))))
        dt = self.scope.constant(self.program.dt, "real")
        if step.fractions:
            self._parts(step, x, held, dt)
        else:
            out.append(Call(f"{p}_integrate(p, &{held}, &{x}, {dt});", role=ROLE, reads=frozenset(("p", x))))
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
        renderer = step.renderer
        start, end = renderer.names.new("from"), renderer.names.new("to")
        one, zero = self.scope.constant(1.0, "real"), self.scope.constant(0.0, "real")
        renderer.out.append(Call(f"real {start} = {zero};", role=ROLE))
        renderer.out.append(Call(f"real {end};", role=ROLE))
        body: list[Statement] = [Call(f"{end} = {one};", role=ROLE)]
        for s, (fraction, after) in step.fractions.items():
            text = step.signal(s)
            changed = f"{text} != {after}"
            if self.scope.lean and s.kind in FLOATS:
                self.scope.used.helpers.add(f"{s.kind}_equal")
                changed = f"!{s.kind}_equal({text}, {after})"
            reads = frozenset((fraction, after, name_of(text)))
            test = f"{changed} && {fraction} > {start} && {fraction} < {end}"
            body.append(IfStatement(test, [Call(f"{end} = {fraction};", role=ROLE)], role=ROLE, reads=reads))
        for s, (fraction, after) in step.fractions.items():
            member = self.values.get(leaf(s))
            if member is not None:
                text = step.signal(s)
                reads = frozenset((fraction, after, name_of(text)))
                chosen = f"{start} >= {fraction} ? {after} : {text}"
                body.append(Call(f"{held}.{member.name} = {chosen};", role=ROLE, reads=reads))
        move = f"{self.prefix}_integrate(p, &{held}, &{x}, ({end} - {start}) * {dt});"
        body += [Call(move, role=ROLE, reads=frozenset(("p", x))), Call(f"{start} = {end};", role=ROLE)]
        renderer.out.append(LoopStatement("do", body, f"while ({start} < {one});", role=ROLE))

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


def _member(line: str, m: Member) -> Statement:
    """Return a statement on a member, in a loop if it is an array."""
    if m.width is None:
        return Call(line.format(m=m.name), role=ROLE, reads=MOVING)
    head = f"for (int32_t i = 0; i < {m.width}; i++)"
    return LoopStatement(head, [Call(line.format(m=f"{m.name}[i]"), role=ROLE, reads=MOVING)], role=ROLE)
