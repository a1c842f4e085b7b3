"""The target-independent program: a flattened diagram whose ports are in an order in which they can be computed.

`twodof.compile.program.lower` makes it; emitters of C and the linearization read it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twodof.blocks.block import Block
from twodof.blocks.declarations import Param, Port, State, numeric
from twodof.blocks.diagram import Rate
from twodof.blocks.enumeration import Enumeration
from twodof.blocks.expressions import numbers
from twodof.blocks.namespaces import Clock, Parameters
from twodof.blocks.trace import Trace, computed


@dataclass(eq=False)
class FlatSignal:
    """A port that drives others: an output of a node, or (`node` None) an input of the program."""

    path: str
    port: str
    kind: str
    width: int | None
    unit: str
    node: Node | None = None
    initial: Any = None
    shape: tuple[int, int] | None = None
    enum: Enumeration | None = None
    disabled: Any = None

    @property
    def before(self) -> Any:
        """Value before the first computation."""
        return 0 if self.initial is None else self.initial

    @property
    def cleared(self) -> Any:
        """Value to which a disabled part resets the signal."""
        return self.before if self.disabled is None else self.disabled


@dataclass(eq=False)
class FlatParameter:
    """A parameter at the path where it is set; `declared` has its default, bounds and unit."""

    path: str
    declared: Param


@dataclass(eq=False)
class Condition:
    """Bool signals that enable, reset or trigger a sub-diagram; with `clears` its outputs are reset while disabled.

    `trigger` is true at the ticks with an edge of the sub-diagram's trigger, and it acts only at these. At a tick of
    `rate` at which `restart` is true, all states inside get their initial values, even if the sub-diagram does not act.
    """

    path: str
    rate: Rate
    enable: FlatSignal | None = None
    reset: FlatSignal | None = None
    trigger: FlatSignal | None = None
    restart: FlatSignal | None = None
    clears: bool = False

    @property
    def signals(self) -> list[FlatSignal]:
        """Signals that enable, reset or trigger the sub-diagram."""
        return [s for s in (self.enable, self.reset, self.trigger, self.restart) if s is not None]


@dataclass(eq=False)
class Node:
    """A block at its path. `drivers` has the signal of each input, `parameters` the program's one for each own name."""

    path: str
    block: Block
    rate: Rate
    conditions: tuple[Condition, ...]
    drivers: dict[str, FlatSignal] = field(default_factory=dict)
    parameters: dict[str, FlatParameter] = field(default_factory=dict)
    outputs: dict[str, FlatSignal] = field(default_factory=dict)

    @property
    def trace(self) -> Trace:
        """Expressions of the block."""
        return self.block.trace

    @property
    def discrete(self) -> list[State]:
        """States that `update` changes."""
        return [s for s in self.block.states if not s.continuous]

    @property
    def continuous(self) -> list[State]:
        """States that the integration of `derivative` changes."""
        return [s for s in self.block.states if s.continuous]

    @property
    def guard(self) -> Guard:
        """Rate and signals on which it depends whether the node acts."""
        enables = tuple(s for c in self.conditions for s in (c.enable, c.trigger) if s is not None)
        clears = tuple(c.enable for c in self.conditions if c.enable is not None and c.clears)
        return Guard(self.rate, enables, clears)

    @property
    def enumerations(self) -> tuple[Enumeration, ...]:
        """Enumerations of the block's declarations, each once."""
        block = self.block
        declared: tuple[Any, ...] = (*block.inputs, *block.outputs, *block.states, *block.params, *block.derived)
        return tuple(dict.fromkeys(d.enum for d in declared if d.enum is not None))

    @property
    def added(self) -> bool:
        """True if the language added the node, to trigger or restart a sub-diagram."""
        return self.path.rpartition(".")[2].startswith("_")

    @property
    def starts(self) -> tuple[Start, ...]:
        """Conditions that set the node's states to their initial values."""
        if not self.block.states:
            return ()
        found: dict[Guard, list[FlatSignal]] = {}
        for c in self.conditions:
            if c.restart is not None:
                found.setdefault(Guard(c.rate), []).append(c.restart)
        resets = [c.reset for c in self.conditions if c.reset is not None]
        if resets:
            found.setdefault(self.guard, []).extend(resets)
        return tuple(Start(self, guard, tuple(signals)) for guard, signals in found.items())


@dataclass(frozen=True)
class Guard:
    """Condition of acting: a node acts at the ticks of `rate` at which all `enables` are true.

    At a tick of `rate` at which one of `clears` is false, its outputs are reset.
    """

    rate: Rate
    enables: tuple[FlatSignal, ...] = ()
    clears: tuple[FlatSignal, ...] = ()

    @property
    def always(self) -> bool:
        """True if the nodes act at every tick."""
        return self.rate.divider == 1 and not self.enables


@dataclass(frozen=True)
class Start:
    """Start of a node: at a tick of `guard`, any of `signals` that is true sets its states to their initial values."""

    node: Node
    guard: Guard
    signals: tuple[FlatSignal, ...]


@dataclass(frozen=True)
class Action:
    """Computation of `signals`, outputs of `node`; or, without signals, the start of its states."""

    node: Node
    signals: tuple[FlatSignal, ...]
    start: Start | None = None


@dataclass(frozen=True)
class Group:
    """Actions that share one guard."""

    guard: Guard
    actions: tuple[Action, ...]


@dataclass(eq=False)
class FlatProgram:
    """A checked, flattened and ordered diagram.

    `tick` computes the outputs of a tick; `stage` computes, at each stage of the integration, the continuous outputs
    that the derivatives read. `moving` are all signals that change inside a step, `edged` those that do so at an edge.
    """

    name: str
    text: str
    dt: float
    integrator: str
    inputs: dict[str, FlatSignal]
    outputs: dict[str, FlatSignal]  # with the logged signals
    signals: dict[str, FlatSignal]  # outputs of blocks and sub-diagrams by path
    parameters: dict[str, FlatParameter]
    nodes: list[Node]
    tick: list[Group]
    stage: list[Group]
    moving: frozenset[FlatSignal]
    edged: list[FlatSignal]
    own: tuple[str, ...]  # of `outputs`, those that are not logged signals

    @property
    def ports(self) -> list[Port]:
        """Inputs of the program as ports."""
        return [Port(name, s.kind, s.width, s.unit, s.shape, s.enum) for name, s in self.inputs.items()]

    @property
    def enumerations(self) -> tuple[Enumeration, ...]:
        """Enumerations of inputs and blocks, each once."""
        of_inputs = (s.enum for s in self.inputs.values() if s.enum is not None)
        return tuple(dict.fromkeys((*of_inputs, *(e for node in self.nodes for e in node.enumerations))))

    @property
    def integrated(self) -> list[Node]:
        """Nodes with continuous states."""
        return [n for n in self.nodes if n.continuous]


Key = tuple[Node, str]
"""Key of a state or parameter: its node and its name."""


def parameter_values(program: FlatProgram, given: Mapping[str, Any]) -> dict[Key, Any]:
    """Return the values of all nodes' parameters, derived ones too, with the values `given` by path, else defaults."""
    values: dict[Key, Any] = {}
    with numbers.precision("float64"):
        for node in program.nodes:
            own = {}
            for name, parameter in node.parameters.items():
                d = parameter.declared
                own[name] = numeric(given.get(parameter.path, d.value), d.kind, d.width, parameter.path, d.shape)
            clock = Clock(None, np.float64(program.dt * node.rate.divider), np.float64(program.dt))
            prepare = node.trace.prepare
            derived = dict(
                zip(prepare, computed(list(prepare.values()), None, None, Parameters(own), clock), strict=True)
            )
            values |= {(node, name): value for name, value in (own | derived).items()}
    return values


def initial_states(program: FlatProgram, parameters: Mapping[Key, Any]) -> dict[Key, Any]:
    """Return the initial values of all states, by node and name."""
    with numbers.precision("float64"):
        return {
            (node, s.name): parameters[node, s.initial]
            if isinstance(s.initial, str)
            else numeric(s.initial, s.kind, s.width, f"{node.path}.{s.name}", s.shape)
            for node in program.nodes
            for s in node.block.states
        }
