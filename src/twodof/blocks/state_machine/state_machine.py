"""StateMachine: a block whose user writes modes and transitions in the place of methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import State, located
from twodof.blocks.expressions.arrays import flat_of, shaped
from twodof.blocks.expressions.expr import Expr, fault, int32, recording, uint32, where
from twodof.blocks.state_machine.chart import (
    ELAPSED,
    MODE,
    OUTER_ELAPSED,
    Chart,
    Leaf,
    MachineGraph,
    Mode,
    Route,
    Transition,
    check_ways,
    last,
    owner_clock,
)
from twodof.blocks.trace import SECTIONS, computed
from twodof.errors import DiagramError

LONGEST = 2**32 - 1  # ticks that a clock of a mode counts; then it stands

Values = dict[str, Any]


class Reaction:
    """The values of a machine's variables and clocks while a tick is recorded; `outputs` are those given so far."""

    def __init__(self, machine: StateMachine, u: Any, x: Any, p: Any, t: Any) -> None:
        self.chart = machine.chart
        self.graph = MachineGraph(machine)  # recorded anew: a function that counts or remembers shows
        self.seen = u, p, t
        kept = {s.name: flat_of(x[s.name]) for s in machine.states}
        self.values: Values = {ELAPSED: uint32(0), OUTER_ELAPSED: uint32(0), **kept}
        self.outputs: Values = {}
        self.variables = {v.name for v in machine.variables}

    def after(self, values: Values, outputs: Values | None = None) -> Reaction:
        """Return a reaction that goes on from other values."""
        made = object.__new__(Reaction)
        vars(made).update(vars(self))
        made.values, made.outputs = dict(values), dict(outputs or {})
        return made

    def computed(self, exprs: Mapping[str, Expr], owner: Mode) -> Values:
        """Return what a guard or an action gives with the present variables and the time in `owner`."""
        u, p, t = self.seen
        x = {**self.values, ELAPSED: self.values[owner_clock(owner in self.chart.outers)]}
        return _computed(exprs, u, x, p, t)

    def perform(self, exprs: Mapping[str, Expr], owner: Mode) -> None:
        """Perform an action: its values take effect together."""
        for name, value in self.computed(exprs, owner).items():
            (self.values if name in self.variables else self.outputs)[name] = value

    def act(self, mode: Mode, action: str) -> None:
        """Perform the action "entry", "during" or "exit" of a mode."""
        self.perform(self.graph.action(mode.name, action), mode)

    def grow_older(self) -> None:
        """Count one more tick in the mode and in the one around it."""
        for name in (ELAPSED, OUTER_ELAPSED):
            elapsed = self.values[name]
            self.values[name] = where(elapsed < LONGEST, elapsed + 1, LONGEST)

    def holds(self, route: Route) -> Any:
        """Return True if the guard of a transition holds."""
        guard = {"": self.graph.guards[route.number]}
        return self.computed(guard, self.chart.by_name[route.transition.source])[""]

    def leave(self, route: Route) -> None:
        """Perform the actions before a mode is entered."""
        for mode in route.left:
            self.act(mode, "exit")
        self.perform(self.graph.does[route.number], self.chart.by_name[route.transition.source])

    def begin(self) -> None:
        """Enter the first mode, with all clocks at 0."""
        self.values[OUTER_ELAPSED] = uint32(0)
        first = self.chart.leaves[0]
        self.enter(first, first.outer)

    def enter(self, leaf: Leaf, outer: Mode | None) -> None:
        """Be in `leaf`, and enter the mode `outer` around it before, if there is one to enter."""
        self.values[MODE], self.values[ELAPSED] = int32(leaf.number), uint32(0)
        if outer is not None:
            self.values[OUTER_ELAPSED] = uint32(0)
            self.act(outer, "entry")
        if leaf.outer is not None and leaf.outer.history:
            self.values[last(leaf.outer.name)] = int32(leaf.number)
        self.act(leaf.mode, "entry")

    def stay(self, leaf: Leaf) -> None:
        """Perform the actions of each tick that ends in a leaf."""
        for mode in leaf.path:
            self.act(mode, "during")


def react(machine: StateMachine, u: Any, x: Any, p: Any, t: Any) -> tuple[Values, Values]:
    """Record a tick: return the states and the outputs after it."""
    now = Reaction(machine, u, x, p, t)
    leaves, mode = now.chart.leaves, now.values[MODE]
    start = now.after(now.values)
    start.begin()
    now.grow_older()
    values = start.values
    for leaf in reversed(leaves):
        values = _chosen(mode == leaf.number, _ways(now, leaf), values)
    *others, end = [now.after(values) for _ in leaves]
    for leaf, there in zip(leaves, [*others, end], strict=True):
        there.stay(leaf)
    for leaf, there in reversed(list(zip(leaves, others, strict=False))):
        here = values[MODE] == leaf.number
        end = now.after(_chosen(here, there.values, end.values), _chosen(here, there.outputs, end.outputs))
    states = [*machine.variables, *machine.graph.states]
    outputs = [(port, end.values if port.name in end.values else end.outputs) for port in machine.outputs]
    return (
        {s.name: shaped(end.values[s.name], s.shape) for s in states},
        {port.name: shaped(values[port.name], port.shape) for port, values in outputs},
    )


def _ways(now: Reaction, leaf: Leaf) -> Values:
    """Return the values after a tick that begins in `leaf`."""
    found = now.values | {MODE: int32(leaf.number)}  # which is what it is there; so each value is one of a mode
    for route in reversed(now.chart.routes[leaf.number]):
        left = now.after(now.values)
        left.leave(route)
        ends = []
        for one in route.leaves:
            end = left.after(left.values)
            end.enter(one, route.entered)
            ends.append(end.values)
        taken = ends[0]
        for one, values in zip(route.leaves[1:], ends[1:], strict=True):
            assert route.resumes is not None
            taken = _chosen(left.values[last(route.resumes.name)] == one.number, values, taken)
        found = _chosen(now.holds(route), taken, found)
    return found


def _chosen(condition: Any, a: Values, b: Values) -> Values:
    """Return for each name `a` where the condition holds, else `b`; no choice is recorded between equal values."""
    found = {}
    for name in b | a:
        one, other = a.get(name, b.get(name)), b.get(name, a.get(name))
        found[name] = one if one is other else where(condition, one, other)
    return found


class StateMachine(Block):
    """Subclass this: set `modes` and `transitions`, and `inputs`, `outputs`, `params` as for any block.

    `variables` are what the actions change: a list of `State`. An output is given by `during` in each mode, or it has
    the name of a variable and shows it. An output named `mode` (int32) is the number of the mode in which the tick
    ends, counted without outer ones. One named `elapsed` (uint32) is the number of ticks since it was entered.

    At its first tick, and after a reset, the machine enters its first mode. At each other tick it looks at the
    transitions: those of the outer mode, then those of the inner one, each in their order. The first one whose guard
    holds is taken, and at most one. Then act: `exit` of the modes that are left (inner first), `do` of the transition,
    `entry` of those that are entered (outer first). `during` of the mode around and of the mode in which the tick ends
    act at every tick, also at that of the entry. Each action sees what those before it gave.
    """

    modes: Sequence[Mode] = ()
    transitions: Sequence[Transition] = ()
    variables: Sequence[State] = ()
    label: str = ""  # the name of the class, if another one's

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in ("states", *(method for method in SECTIONS if method != "prepare")):
            if name in cls.__dict__:
                remedy = "declare variables, modes and transitions, whose functions say what it does"
                raise DiagramError(f"a state machine writes {name} itself", f"block {cls.__name__}", remedy)

    @cached_property
    def chart(self) -> Chart:
        """The modes, and the ways between them. Raises DiagramError for names that are wrong or missing."""
        with located(f"block {self.label or type(self).__name__}"):
            return Chart(self.modes, self.transitions)

    @cached_property
    def graph(self) -> MachineGraph:
        """The recorded guards and actions, checked. Raises DiagramError with the mode and the user's line."""
        made = MachineGraph(self)
        with located(f"block {self.label or type(self).__name__}"):
            check_ways(self.chart, made)
        return made

    @property
    def states(self) -> Sequence[State]:
        """The variables, and what the machine remembers by itself."""
        return [*self.variables, *self.graph.states]

    @states.setter
    def states(self, value: Any) -> None:
        raise fault("the states of a state machine are assigned", "declare what its actions change in `variables`")

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return react(self, u, x, p, t)[1] if recording() else _computed(self.trace.outputs, u, x, p, t)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return react(self, u, x, p, t)[0] if recording() else _computed(self.trace.update, u, x, p, t)


def _computed(exprs: Mapping[str, Expr], u: Any, x: Any, p: Any, t: Any) -> Values:
    """Return the values of a tick's recorded expressions: on numbers a machine is what was recorded of it."""
    return dict(zip(exprs, computed(list(exprs.values()), u, x, p, t), strict=True))
