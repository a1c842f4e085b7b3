"""One step of a program with its derivatives: docs/explanation/language.md, section 4, on numbers that carry slopes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from twodof.blocks.block import Clock, Parameters, names_given
from twodof.blocks.declarations import numeric
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.derivative import Dual, Slope, Tangent, Value, constant, plain
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import UInt32
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Guard, Node

Key = tuple[Node, str]
"""A state: its node and its name."""

States = dict[Key, Value]


def parameter_values(program: FlatProgram, given: Mapping[str, Any]) -> dict[Key, Any]:
    """The parameters of every node, given (by path in `given`, else default) and derived, by node and own name."""
    values: dict[Key, Any] = {}
    with numbers.precision("float64"):
        for node in program.nodes:
            own = {}
            for name, parameter in node.parameters.items():
                d = parameter.declared
                own[name] = numeric(given.get(parameter.path, d.value), d.kind, d.width, parameter.path)
            block = node.block
            clock = Clock(None, np.float64(program.dt * node.rate.divider), np.float64(program.dt))
            made = names_given(node.path, "prepare", block.prepare(Parameters(dict(own)), clock), block.derived)
            derived = {d.name: numeric(made[d.name], d.kind, d.width, node.path) for d in block.derived}
            values |= {(node, name): value for name, value in (own | derived).items()}
    return values


def initial_states(program: FlatProgram, parameters: Mapping[Key, Any]) -> dict[Key, Any]:
    """The initial value of every state."""
    with numbers.precision("float64"):
        return {
            (node, s.name): parameters[node, s.initial]
            if isinstance(s.initial, str)
            else numeric(s.initial, s.kind, s.width, f"{node.path}.{s.name}")
            for node in program.nodes
            for s in node.block.states
        }


class TangentStep:
    """One step from given states and inputs; to be used under `numbers.precision("float64")`.

    `cut` replaces signals for all their readers: signal -> the slope that its readers see. `direction` is that of
    `Tangent`.
    """

    def __init__(
        self,
        program: FlatProgram,
        parameters: Mapping[Key, Any],
        states: Mapping[Key, Value],
        inputs: Mapping[FlatSignal, Value],
        tick: int,
        cut: Mapping[FlatSignal, Slope] | None = None,
        direction: Slope | None = None,
    ) -> None:
        self.program = program
        self.parameters = parameters
        self.tangent = Tangent(direction)
        self.tick = tick
        self.cut = cut or {}
        self.states: States = dict(states)
        self.read: dict[FlatSignal, Value] = dict(inputs)  # as readers see it
        self.made: dict[FlatSignal, Value] = dict(inputs)  # as its block gives it
        self._memo: dict[Node, dict[int, Value]] = {}
        self._outputs()

    def _leaf(
        self, node: Node, signal: Callable[[FlatSignal], Value], state: Callable[[str], Value]
    ) -> Callable[[Expr], Value]:
        def value(item: Expr) -> Value:
            if item.op == "input":
                return signal(node.drivers[item.data])
            if item.op == "state":
                return state(item.data)
            if item.op == "param":
                return constant(self.parameters[node, item.data])
            if item.op == "tick":
                return Dual(UInt32(self.tick))
            seconds = self.program.dt * (node.rate.divider if item.data == "dt" else 1)
            return Dual(np.float64(seconds))

        return value

    def _state(self, node: Node, x: Mapping[Key, Value]) -> Callable[[str], Value]:
        return lambda name: x[node, name] if (node, name) in x else self.states[node, name]

    def evaluate(self, node: Node, roots: list[Expr]) -> list[Value]:
        """Expressions of a node at the tick."""
        self.tangent.block = node.path
        leaf = self._leaf(node, self.read.__getitem__, self._state(node, {}))
        return self.tangent.evaluate(roots, leaf, self._memo.setdefault(node, {}))

    def values(self, node: Node, roots: list[Expr], states: Mapping[Key, Value]) -> list[Value]:
        """Expressions of a node at the tick, with some of its states replaced."""
        self.tangent.block = node.path
        leaf = self._leaf(node, self.read.__getitem__, self._state(node, states))
        return self.tangent.evaluate(roots, leaf)

    def active(self, guard: Guard) -> bool:
        """Whether the nodes of a guard act at this tick."""
        due = self.tick % guard.rate.divider == guard.rate.offset
        return due and all(bool(plain(self.read[e])) for e in guard.enables)

    def _outputs(self) -> None:
        for group in self.program.tick:
            acts = self.active(group.guard)
            for action in group.actions:
                node = action.node
                if not action.signals:
                    if acts and any(bool(plain(self.read[r])) for r in node.resets):
                        initial = initial_states(self.program, self.parameters)
                        self.states |= {(node, s.name): constant(initial[node, s.name]) for s in node.block.states}
                    continue
                for s in action.signals:
                    self.made[s] = self.evaluate(node, [node.trace.outputs[s.port]])[0] if acts else zero(s)
                    self.read[s] = self.made[s]
                    if s in self.cut:
                        self.read[s] = Dual(plain(self.made[s]), self.cut[s])

    def updates(self) -> States:
        """The discrete states of the next tick."""
        new: States = {}
        for node in self.program.nodes:
            roots = node.trace.update if self.active(node.guard) else {}
            found = self.evaluate(node, list(roots.values()))
            new |= {(node, name): value for name, value in zip(roots, found, strict=True)}
        return {(n, s.name): self.states[n, s.name] for n in self.program.nodes for s in n.discrete} | new

    def derivative(self, x: Mapping[Key, Value], signals: Mapping[FlatSignal, Value] | None = None) -> States:
        """The derivatives of the continuous states at `x`; `signals` replaces those that have an edge."""
        now: dict[FlatSignal, Value] = dict(self.read) | dict(signals or {})
        memos: dict[Node, dict[int, Value]] = {}

        def evaluate(node: Node, roots: list[Expr]) -> list[Value]:
            self.tangent.block = node.path
            leaf = self._leaf(node, now.__getitem__, self._state(node, x))
            return self.tangent.evaluate(roots, leaf, memos.setdefault(node, {}))

        for group in self.program.stage:
            if self.active(group.guard):
                for action in group.actions:
                    for s in action.signals:
                        if s not in self.cut:
                            now[s] = evaluate(action.node, [action.node.trace.outputs[s.port]])[0]
        slopes: States = {}
        for node in self.program.integrated:
            names = [s.name for s in node.continuous]
            if self.active(node.guard):
                found = evaluate(node, [node.trace.derivative[name] for name in names])
            else:
                found = [_times(x[node, name], 0.0) for name in names]
            slopes |= {(node, name): value for name, value in zip(names, found, strict=True)}
        return slopes

    def integrated(self) -> States:
        """The continuous states of the next tick, before they are projected: RK4 or Euler, split at edges."""
        x = {(n, s.name): self.states[n, s.name] for n in self.program.integrated for s in n.continuous}
        edges: dict[FlatSignal, tuple[float, Value, Value]] = {}
        for s in self.program.edged:
            if s.node is not None and self.active(s.node.guard):
                fraction, after = self.evaluate(s.node, list(s.node.trace.edges[s.port]))
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
            return {key: _plus(x[key], _times(slope[key], step)) for key in x}

        k1 = self.derivative(x, signals)
        if self.program.integrator == "euler":
            return along(h, k1)
        k2 = self.derivative(along(0.5 * h, k1), signals)
        k3 = self.derivative(along(0.5 * h, k2), signals)
        k4 = self.derivative(along(h, k3), signals)
        total = {key: _plus(_plus(_plus(k1[key], _times(k2[key], 2.0)), _times(k3[key], 2.0)), k4[key]) for key in x}
        return along(h / 6.0, total)

    def projected(self, x: States) -> States:
        """`x` after the jumps of continuous states."""
        new = dict(x)
        for node in self.program.integrated:
            if node.trace.project and self.active(node.guard):
                self.tangent.block = node.path
                leaf = self._leaf(node, self.read.__getitem__, self._state(node, x))
                found = self.tangent.evaluate(list(node.trace.project.values()), leaf)
                new |= {(node, name): value for name, value in zip(node.trace.project, found, strict=True)}
        return new


def zero(signal: FlatSignal) -> Value:
    """What a signal holds before its first tick."""
    return constant(numeric(0, signal.kind, signal.width, signal.path))


def _plus(a: Value, b: Value) -> Value:
    if isinstance(a, tuple) and isinstance(b, tuple):
        return tuple(_add(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, tuple) or isinstance(b, tuple):
        raise TypeError("an array meets a scalar")
    return _add(a, b)


def _add(a: Dual, b: Dual) -> Dual:
    slope = a.slope if b.slope is None else b.slope if a.slope is None else a.slope + b.slope
    return Dual(a.value + b.value, slope)


def _times(a: Value, factor: float) -> Value:
    if isinstance(a, tuple):
        return tuple(Dual(d.value * factor, None if d.slope is None else d.slope * factor) for d in a)
    return Dual(a.value * factor, None if a.slope is None else a.slope * factor)
