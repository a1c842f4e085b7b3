"""Operating point of a linearization: parameters, inputs, states and tick, and the nodes that take part."""

import math
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from twodof.blocks.declarations import check_value, numeric, unknown_parameter
from twodof.blocks.diagram import BASE, Rate
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.derivative import Value, plain
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.expressions.numbers import FLOATS, Vector
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Key, Node, initial_states, parameter_values
from twodof.compile.program.flatten import constants
from twodof.errors import DiagramError

States = dict[Key, Value]
K = TypeVar("K")


def elements(value: Any) -> tuple[Any, ...]:
    """Return the elements of an array, or a tuple of the scalar alone."""
    return value if isinstance(value, tuple) else (value,)


def flat(values: Mapping[K, Any], keys: Iterable[K]) -> list[float]:
    """Return the numbers of `keys`, all elements one after the other."""
    return [float(v) for key in keys for v in elements(values[key])]


def put_flat(values: dict[K, Any], keys: Iterable[K], numbers: Iterator[float]) -> None:
    """Set the values of `keys` to the next of `numbers`, all elements one after the other."""
    for key in keys:
        made = [np.float64(next(numbers)) for _ in elements(values[key])]
        values[key] = Vector(made) if isinstance(values[key], tuple) else made[0]


class OperatingPoint:
    """Parameters, inputs, states and tick at a point. `at` overrides defaults and initial values, by name or path.

    Raises DiagramError or ParameterError for an unknown name, and for a value of another type or out of bounds.
    """

    def __init__(self, program: FlatProgram, at: Mapping[str, Any]) -> None:
        keys = {f"{n.path}.{s.name}": (n, s) for n in program.nodes for s in n.block.states}
        known = {*program.inputs, *program.parameters, *keys, "tick"}
        for name in at:
            if name not in known:
                raise unknown_parameter(name, known)
        for path, parameter in program.parameters.items():
            if path in at:
                check_value(parameter.declared, at[path], path)
        self.parameters = parameter_values(program, {p: at[p] for p in program.parameters if p in at})
        self.states: dict[Key, Any] = initial_states(program, self.parameters)
        self.given: set[Key] = set()
        with numbers.precision("float64"):
            self.inputs: dict[FlatSignal, Any] = {
                s: numeric(at.get(name, 0), s.kind, s.width, name, s.shape) for name, s in program.inputs.items()
            }
            for path, (node, state) in keys.items():
                if path in at:
                    self.states[node, state.name] = numeric(at[path], state.kind, state.width, path, state.shape)
                    self.given.add((node, state.name))
        self.tick = int(at.get("tick", 0))
        self.tick_given = "tick" in at
        self.held: dict[FlatSignal, Any] = {}  # of slower rates, as they stand before the point's tick

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Restore states, held signals and tick of the point at the end of the `with` block."""
        before = dict(self.states), dict(self.held), self.tick
        try:
            yield
        finally:
            self.states, self.held, self.tick = before

    def width(self, key: Key) -> int:
        """Return the number of elements of a state."""
        return len(elements(self.states[key]))

    def put(self, states: States) -> None:
        """Set the states in `states`."""
        self.states |= {key: plain(value) for key, value in states.items()}


MAX_PERIOD = 1000  # base ticks


class Parts:
    """Nodes on which `outputs` depend, without following signals in `cut`; with `everything` all nodes."""

    def __init__(
        self, program: FlatProgram, outputs: Mapping[str, FlatSignal], cut: Container[FlatSignal], everything: bool
    ) -> None:
        self.program = program
        self._below = {name: _depended_on(s, cut) for name, s in outputs.items()}
        needed = set().union(*self._below.values())
        everything = everything or not outputs
        self.nodes = [n for n in program.nodes if everything or n in needed]

    def outputs_of(self, node: Node) -> list[str]:
        """Return the names of the outputs that depend on a node, or the diagram's name if none does."""
        return [name for name, nodes in self._below.items() if node in nodes] or [self.program.name]

    def free_outputs(self, node: Node) -> list[str]:
        """Return the names of the outputs that do not depend on a node."""
        return [name for name, nodes in self._below.items() if node not in nodes]

    @cached_property
    def integrated(self) -> list[Node]:
        """Nodes with continuous states."""
        return [n for n in self.nodes if n.continuous]

    @cached_property
    def _rates(self) -> dict[Rate, str]:
        """The rates of the nodes that do something, each with the path of one."""
        ordered = [s for g in self.program.tick for a in g.actions for s in a.signals]
        rateless = constants(ordered)
        live = {s.node for s in ordered if s not in rateless} | {n for n in self.nodes if n.block.states}
        return {n.rate: n.path for n in reversed(self.nodes) if n in live} or {BASE: self.program.name}

    @cached_property
    def period(self) -> int:
        """Number of base ticks after which all rates are due together. Raises DiagramError above MAX_PERIOD."""
        ticks = math.lcm(*(rate.divider for rate in self._rates))
        if len(self._rates) > 1 and ticks > MAX_PERIOD:
            (one, a), (two, b), *_ = sorted(self._rates.items(), reverse=True)
            raise DiagramError(
                f"its rates are due together every {ticks} ticks only: {a} runs at {tuple(one)} and {b} "
                f"at {tuple(two)}",
                self.program.name,
                f"at most {MAX_PERIOD} ticks: cut a signal between them as an input, or ask for fewer outputs",
            )
        return ticks

    def steps(self, node: Node) -> int:
        """Return the number of runs of a node in a period."""
        return self.period // math.gcd(self.period, node.rate.divider)

    @property
    def several_rates(self) -> str:
        """Text with two parts of different rates; "" if there is only one rate."""
        if len(self._rates) == 1:
            return ""
        (one, a), (two, b), *_ = self._rates.items()
        return f"{a} runs at {tuple(one)} and {b} at {tuple(two)}"

    def start(self, tick: int) -> int:
        """Return the first tick from `tick` on at which most of the nodes are due."""
        if len(self._rates) == 1:
            (rate,) = self._rates
            return tick + (rate.offset - tick) % rate.divider
        sizes = Counter(n.rate for n in self.nodes)
        window = range(tick, tick + self.period)
        return max(window, key=lambda k: sum(size for r, size in sizes.items() if k % r.divider == r.offset))

    def due(self, tick: int) -> frozenset[Rate]:
        """Return the rates that are due at a tick."""
        return frozenset(r for r in self._rates if tick % r.divider == r.offset)

    def held(self, outputs: Iterable[FlatSignal]) -> list[FlatSignal]:
        """Return the real signals of slower rates that are read, or output, between their own ticks."""
        if not self.several_rates:
            return []
        read = {s for n in self.nodes for s in n.drivers.values()} | set(outputs)
        slow = [s for n in self.nodes for s in n.outputs.values() if n.rate != BASE and s in read]
        return [s for s in slow if s.kind in FLOATS]

    def read_tick(self) -> list[str]:
        """Return the paths of the nodes that read the tick."""
        found = []
        for node in self.nodes:
            t = node.trace
            edges = [e for pair in t.edges.values() for e in pair]
            methods = (t.outputs, t.update, t.derivative, t.project)
            if leaves([*edges, *(e for method in methods for e in method.values())], "tick"):
                found.append(node.path)
        return found


def _depended_on(signal: FlatSignal, cut: Container[FlatSignal]) -> set[Node]:
    """Return the nodes that a signal depends on, its own included."""
    found: set[Node] = set()
    stack = [signal]
    while stack:
        node = stack.pop().node
        if node is not None and node not in found:
            found.add(node)
            conditions = [s for c in node.conditions for s in c.signals]
            stack += [s for s in (*node.drivers.values(), *conditions) if s not in cut]
    return found
