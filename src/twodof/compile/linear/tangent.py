"""One step of a program with its derivatives: docs/explanation/language.md, section 4, on numbers that carry slopes."""

from collections.abc import Container, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from twodof.blocks.declarations import numeric
from twodof.blocks.expressions.derivative import Dual, Slope, Tangent, Value, constant, plain
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import UInt32
from twodof.compile.linear.operating_point import OperatingPoint, States, elements
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Guard, Key, Node, initial_states


class TangentStep:
    """One step at an operating point; to be used under `numbers.precision("float64")`.

    States, inputs and `held`, the signals of the tick before, are those of the point. They may be given slopes before
    `compute_outputs`. `cut` has the slopes that the readers of a signal see in place of its own. `direction` is that of
    `Tangent`. Only the states of `nodes` change. With `rested` all rates are due.
    """

    def __init__(
        self,
        program: FlatProgram,
        point: OperatingPoint,
        nodes: Container[Node],
        rested: bool = False,
        direction: Slope | None = None,
    ) -> None:
        self.program = program
        self.nodes = [n for n in program.nodes if n in nodes]
        self.integrated_nodes = [n for n in program.integrated if n in nodes]
        self.rested = rested
        self.parameters = point.parameters
        self.tick = point.tick
        self.tangent = Tangent(direction)
        self.states: States = {key: constant(value) for key, value in point.states.items()}
        self.held: dict[FlatSignal, Value] = {s: constant(value) for s, value in point.held.items()}
        self.cut: dict[FlatSignal, Slope] = {}
        self.read: dict[FlatSignal, Value] = {s: constant(value) for s, value in point.inputs.items()}
        self.made: dict[FlatSignal, Value] = {}  # as its block gives it; `read` as readers see it
        self._memos: dict[Node, dict[int, Value]] = {}

    def evaluate(
        self,
        node: Node,
        roots: Iterable[Expr],
        states: Mapping[Key, Value] | None = None,
        signals: Mapping[FlatSignal, Value] | None = None,
        memos: dict[Node, dict[int, Value]] | None = None,
    ) -> list[Value]:
        """Evaluate expressions of a node at the tick, with some of its states or input signals replaced.

        `memos` keeps computed values: by default the memo of the tick, or none with replaced states.
        """
        x, read = states or {}, self.read if signals is None else signals

        def leaf(item: Expr) -> Value:
            if item.op == "input":
                return read[node.drivers[item.data]]
            if item.op == "state":
                key = node, item.data
                return x[key] if key in x else self.states[key]
            if item.op == "param":
                return constant(self.parameters[node, item.data])
            if item.op == "tick":
                return Dual(UInt32(self.tick))
            seconds = self.program.dt * (node.rate.divider if item.data == "dt" else 1)
            return Dual(np.float64(seconds))

        self.tangent.block = node.path
        kept = self._memos if memos is None and not x else memos
        return self.tangent.evaluate(list(roots), leaf, None if kept is None else kept.setdefault(node, {}))

    def active(self, guard: Guard) -> bool:
        """Return True if the nodes of a guard act at this tick."""
        return self.due(guard) and all(bool(plain(self.read[e])) for e in guard.enables)

    def due(self, guard: Guard) -> bool:
        """Return True if the nodes of a guard are due at this tick."""
        return self.rested or self.tick % guard.rate.divider == guard.rate.offset

    def compute_outputs(self) -> None:
        """Compute the signals of the tick."""
        self.made = dict(self.read)
        for group in self.program.tick:
            acts = self.active(group.guard)
            clears = self.due(group.guard) and not all(bool(plain(self.read[e])) for e in group.guard.clears)
            for action in group.actions:
                node = action.node
                if action.start is not None:
                    if acts and any(bool(plain(self.read[r])) for r in action.start.signals):
                        initial = initial_states(self.program, self.parameters)
                        self.states |= {(node, s.name): constant(initial[node, s.name]) for s in node.block.states}
                    continue
                for s in action.signals:
                    if acts:
                        self.made[s] = self.evaluate(node, [node.trace.outputs[s.port]])[0]
                    else:
                        held = self.held.get(s, zero(s))
                        self.made[s] = valued(s, s.cleared) if clears else held
                    self.read[s] = self.made[s]
                    if s in self.cut:
                        self.read[s] = Dual(plain(self.made[s]), self.cut[s])

    def made_plain(self) -> dict[FlatSignal, Any]:
        """Return the numbers of the tick's signals that blocks give."""
        return {s: plain(v) for s, v in self.made.items() if s.node is not None}

    def updates(self) -> States:
        """Return the discrete states of the next tick."""
        new: States = {}
        for node in self.nodes:
            roots = node.trace.update if self.active(node.guard) else {}
            found = self.evaluate(node, roots.values())
            new |= {(node, name): value for name, value in zip(roots, found, strict=True)}
        return {(n, s.name): self.states[n, s.name] for n in self.program.nodes for s in n.discrete} | new

    def continuous(self) -> States:
        """Return the continuous states at the tick."""
        return {(n, s.name): self.states[n, s.name] for n in self.integrated_nodes for s in n.continuous}

    def following(self) -> States:
        """Return all states of the next tick."""
        return self.states | self.updates() | (self.projected(self.integrated()) if self.integrated_nodes else {})

    def derivative(self, x: Mapping[Key, Value], signals: Mapping[FlatSignal, Value] | None = None) -> States:
        """Return the derivatives of the continuous states at `x`; `signals` are the present values of edged signals."""
        now: dict[FlatSignal, Value] = dict(self.read) | dict(signals or {})
        memos: dict[Node, dict[int, Value]] = {}
        for group in self.program.stage:
            if self.active(group.guard):
                for action in group.actions:
                    for s in action.signals:
                        if s not in self.cut:
                            roots = [action.node.trace.outputs[s.port]]
                            now[s] = self.evaluate(action.node, roots, x, now, memos)[0]
        slopes: States = {}
        for node in self.integrated_nodes:
            names = [s.name for s in node.continuous]
            if self.active(node.guard):
                found = self.evaluate(node, [node.trace.derivative[name] for name in names], x, now, memos)
            else:
                found = [_sum(x[node, name], x[node, name], -1.0) for name in names]
            slopes |= {(node, name): value for name, value in zip(names, found, strict=True)}
        return slopes

    def integrated(self) -> States:
        """Return the continuous states of the next tick before projections: RK4 or Euler, split at edges."""
        x = self.continuous()
        edges: dict[FlatSignal, tuple[float, Value, Value]] = {}
        for s in self.program.edged:
            if s.node is not None and s not in self.cut and self.active(s.node.guard):
                fraction, after = self.evaluate(s.node, s.node.trace.edges[s.port])
                edges[s] = float(plain(fraction)), self.read[s], after
        start = 0.0
        while start < 1.0:
            end = min([1.0, *(f for f, _, _ in edges.values() if f > start)])
            signals = {s: after if start >= f else before for s, (f, before, after) in edges.items()}
            x = self._advance(x, (end - start) * self.program.dt, signals)
            start = end
        return x

    def _advance(self, x: States, h: float, signals: Mapping[FlatSignal, Value]) -> States:
        def along(step: float, slope: States) -> States:
            return {key: _sum(x[key], slope[key], step) for key in x}

        stages = () if self.program.integrator == "euler" else ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0))
        slope = total = self.derivative(x, signals)
        for step, weight in stages:
            slope = self.derivative(along(step * h, slope), signals)
            total = {key: _sum(total[key], slope[key], weight) for key in x}
        return along(h / (1.0 + sum(weight for _, weight in stages)), total)

    def projected(self, x: States) -> States:
        """Return `x` after the jumps of continuous states."""
        new = dict(x)
        for node in self.integrated_nodes:
            if node.trace.project and self.active(node.guard):
                found = self.evaluate(node, node.trace.project.values(), x)
                new |= {(node, name): value for name, value in zip(node.trace.project, found, strict=True)}
        return new


def zero(signal: FlatSignal) -> Value:
    """Return the value of a signal before its first tick."""
    return valued(signal, signal.before)


def valued(signal: FlatSignal, value: Any) -> Value:
    """Return a constant of a signal's kind."""
    return constant(numeric(value, signal.kind, signal.width, signal.path))


def seeded(value: Value, rows: Iterator[Slope]) -> Value:
    """Return a value whose elements have the next of `rows` as slopes."""
    made = tuple(Dual(d.value, next(rows)) for d in elements(value))
    return made if isinstance(value, tuple) else made[0]


def _sum(a: Value, b: Value, factor: float) -> Value:
    """Return a + factor * b."""
    made = tuple(_added(x, y, factor) for x, y in zip(elements(a), elements(b), strict=True))
    return made if isinstance(a, tuple) else made[0]


def _added(a: Dual, b: Dual, factor: float) -> Dual:
    slope = None if b.slope is None else b.slope * factor
    if a.slope is not None:
        slope = a.slope if slope is None else a.slope + slope
    return Dual(a.value + b.value * factor, slope)
