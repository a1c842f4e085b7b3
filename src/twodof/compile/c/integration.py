"""Integration of continuous states in the step function: a loop over the method's stages, edges, and projections."""

from collections.abc import Container
from functools import partial
from typing import NamedTuple

from twodof.compile.c.expressions import Renderer
from twodof.compile.c.graph import ProgramGraph
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.schedule import changed, commit, integrated_signals
from twodof.compile.c.statements import (
    Assign,
    Call,
    IfStatement,
    LoopStatement,
    Statement,
    Text,
    every,
    name_of,
    stored,
)
from twodof.compile.c.step import StepEmitter, all_of
from twodof.compile.program.flat_program import FlatSignal, Group, Node

ROLE = "integration"
LONGEST_UNROLLED = 300  # statements of a stage that may appear four times in the machine code


class Method(NamedTuple):
    """Butcher table of an explicit method in which each stage starts from the slopes of the one before.

    With the step h, the stage after stage k is at x + h ahead[k] slope_k. The new state is x + h share times the sum of
    weights[k] slope_k.
    """

    ahead: tuple[float, ...]
    weights: tuple[float, ...]
    share: float


METHODS = {"euler": Method((0.0,), (1.0,), 1.0), "rk4": Method((0.5, 0.5, 1.0, 0.0), (1.0, 2.0, 2.0, 1.0), 1 / 6)}


class Integration:
    """Writes the integration into the step function, on local copies of the continuous states."""

    def __init__(self, step: StepEmitter) -> None:
        self.step = step
        self.scope = step.scope
        self.layout, self.program = step.layout, step.program
        self.graph = ProgramGraph(self.program)  # without the tick's names of values that change inside the step
        self.names = step.renderer.names
        self.nodes = self.program.integrated
        self.x, self.at, self.sum, self.slope = map(self.names.new, ("x", "at", "sum", "slope"))
        self.real = C_TYPES["real"]
        self.struct = f"{self.program.name}_X"
        self._read = sorted(set(integrated_signals(self.program)), key=lambda s: s.path)
        self._inside = {s for g in self.program.stage if g.guard.always for a in g.actions for s in a.signals}

    def write(self) -> None:
        """Add the statements that integrate the states over a step, from edge to edge, and project them."""
        step, out = self.step, self.step.renderer.out
        out.append(Assign(self.x, "s->x", self.struct, role=ROLE, reads=frozenset("s")))
        if step.fractions:
            self._parts()
        else:
            self._stages(self.scope.constant(self.program.dt, "real"))
        for node in self.nodes:
            if node.trace.project:
                values = {name: self.graph.of(node, e) for name, e in node.trace.project.items()}
                with step.renderer.within() as body:
                    renderer = self._renderer(self.x)
                    commit(renderer, changed(node, values, partial(self._member, self.x, node)))
                step.guarded(step.tests(node.guard), body)

    def _member(self, struct: str, node: Node, name: str) -> str:
        return f"{struct}.{self.layout.states[node, name].name}"

    def _assign(self, target: str, value: str, declared: str = "", *reads: str) -> Statement:
        return Assign(target, value, declared, role=ROLE, reads=frozenset(map(name_of, reads)))

    def _parts(self) -> None:
        """Add the integration from edge to edge of a step."""
        step, out = self.step, self.step.renderer.out
        start, end, h = map(self.names.new, ("from", "to", "h"))
        zero, one = self.scope.constant(0.0, "real"), self.scope.constant(1.0, "real")
        out.append(self._assign(start, zero, self.real))
        with step.renderer.within() as body:
            body.append(self._assign(end, one, self.real))
            for s, (fraction, after) in step.fractions.items():
                text, reads = step.signal(s)[::2]
                test = f"{text} != {after} && {fraction} > {start} && {fraction} < {end}"
                reads |= {fraction, after, start, end}
                body.append(IfStatement(test, [self._assign(end, fraction, "", fraction)], role=ROLE, reads=reads))
                name = self.names.new(f"{s.path}.now")
                now = f"{start} >= {fraction} ? {after} : {text}"
                body.append(self._assign(name, now, f"const {self.real}", *reads))
                step.renderer.know(step.graph.signal(s), Text.of(name))  # inside the loop
            dt = self.scope.constant(self.program.dt, "real")
            body.append(self._assign(h, f"({end} - {start}) * {dt}", f"const {self.real}", start, end))
            self._stages(h)
            body.append(self._assign(start, end, "", end))
        out.append(LoopStatement("do", body, f"while ({start} < {one});", role=ROLE, reads=frozenset((start,))))

    def _stages(self, h: str) -> None:
        """Add a step of the method over `h`."""
        method = METHODS[self.program.integrator]
        renderer, constant = self.step.renderer, self.scope.constant
        tables = {}
        for name, row in (("ahead", method.ahead), ("weight", method.weights)):
            values = ", ".join(constant(value, "real") for value in row)
            table = tables[name] = self.names.new(name)
            declared = f"static const {self.real}"
            renderer.out.append(Assign(table, f"{{{values}}}", declared, len(row), role=ROLE))
        ahead, weight = tables["ahead"], tables["weight"]
        renderer.out.append(self._assign(self.at, self.x, self.struct, self.x))
        renderer.out.append(self._assign(self.sum, "", self.struct))
        # The one number that added to any other gives that, 0 and -0 included.
        renderer.out += self._each(self.sum, constant(-0.0, "real"))
        stage = self.names.new("stage")
        with renderer.within() as body:
            body.append(self._assign(self.slope, "", self.struct))
            self._slopes()
            more = f"{self.sum}.{{m}} + {weight}[{stage}] * {self.slope}.{{m}}"
            body += self._each(self.sum, more, self.sum, weight, self.slope)
            ahead_of = f"{self.x}.{{m}} + {h} * {ahead}[{stage}] * {self.slope}.{{m}}"
            body += self._each(self.at, ahead_of, self.x, h, ahead, self.slope)
        head = f"for (int32_t {stage} = 0; {stage} < {len(method.weights)}; {stage}++)"
        if sum(1 for _ in every(body)) <= LONGEST_UNROLLED:
            renderer.out.append(Call("td_unrolled", role=ROLE))
        renderer.out.append(LoopStatement(head, body, role=ROLE))
        share = constant(method.share, "real")
        renderer.out += self._each(self.x, f"{self.x}.{{m}} + {h} * {share} * {self.sum}.{{m}}", self.x, h, self.sum)

    def _each(self, target: str, value: str, *reads: str) -> list[Statement]:
        """Return a statement on each continuous state `{m}`, in a loop if that is an array."""
        made: list[Statement] = []
        for m in self.layout.x.members:
            name = m.name if m.width is None else f"{m.name}[i]"
            statement = self._assign(f"{target}.{name}", value.format(m=name), "", *reads)
            if m.width is not None:
                statement = LoopStatement(f"for (int32_t i = 0; i < {m.width}; i++)", [statement], role=ROLE)
            made.append(statement)
        return made

    def _slopes(self) -> None:
        """Add the derivatives of all states at the states `at`; those of disabled blocks too, which are not used."""
        renderer = self._renderer(self.at, self._inside)
        for group in self.program.stage:
            if not group.guard.always:
                self._guarded(renderer, group)
        rows = [(n, s, self.graph.of(n, n.trace.derivative[s.name])) for n in self.nodes for s in n.continuous]
        texts = iter(renderer.texts(e for _, s, e in rows if s.width is None))
        for node, state, e in rows:
            renderer.owner = node
            target = self._member(self.slope, node, state.name)
            if state.width is None:
                renderer.put(target, next(texts))
            else:
                renderer.assign([(target, e)])

    def _guarded(self, renderer: Renderer, group: Group) -> None:
        """Add the outputs of blocks that may be disabled, which start with their values of the tick."""
        signals = [s for a in group.actions for s in a.signals]
        for s in signals:
            name, renderer.owner = self.names.new(s.path), s.node
            renderer.declare(name, s.kind, width=s.width)
            renderer.put(name, self.step.signal(s), s.kind, s.width)
            renderer.know(self.graph.signal(s), Text.of(name))
        with renderer.within() as body:
            for s in signals:
                renderer.owner = s.node
                node = self.graph.signal(s)
                renderer.assign([(renderer.named[id(node)].text, node.args[0])])
        renderer.owner = None
        self.step.guarded(self.step.tests(group.guard), body)

    def _renderer(self, states: str, again: Container[FlatSignal] = ()) -> Renderer:
        """Return a renderer that reads the continuous states from the struct `states`, and computes signals `again`."""

        def state(node: Node, name: str) -> str:
            continuous = any(s.name == name for s in node.continuous)
            return self._member(states, node, name) if continuous else self.scope.state(node, name)

        made = self.scope.renderer(self.names, self.scope.leaf(state), self.graph.owner)
        made.out = self.step.renderer.out
        for s in self._read:
            if s not in again:
                made.know(self.graph.signal(s), self.step.signal(s))
        return made

    def commit(self) -> None:
        """Add the continuous states of the next tick; those of disabled blocks keep theirs."""
        out, reads = self.step.renderer.out, frozenset("s")
        for node in self.nodes:
            if node.guard.always:
                continue
            rows = [(s, self._member(self.x, node, s.name), self.scope.state(node, s.name)) for s in node.continuous]
            body = [stored(x, old, s.kind, s.width, None, reads, "disabled states") for s, x, old in rows]
            enabled = all_of(self.step.tests(node.guard))
            out.append(IfStatement(f"!({enabled.text})", body, role="disabled states", reads=enabled.reads))
        out.append(Assign("s->x", self.x, role="next states", reads=frozenset(("s", self.x))))
