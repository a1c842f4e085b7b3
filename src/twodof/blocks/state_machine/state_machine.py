"""StateMachine: a block whose user writes modes and transitions in the place of methods."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import State
from twodof.blocks.expressions.expr import fault
from twodof.blocks.state_machine.chart import Chart
from twodof.blocks.state_machine.hidden_transitions import check_ways
from twodof.blocks.state_machine.machine_graph import MachineGraph
from twodof.blocks.state_machine.mode import Mode, Transition
from twodof.blocks.state_machine.reaction import react
from twodof.blocks.trace import SECTIONS
from twodof.errors import DiagramError


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
                raise DiagramError(
                    f"a state machine writes {name} itself",
                    f"block {cls.__name__}",
                    "declare variables, modes and transitions, whose functions say what it does",
                )

    @cached_property
    def chart(self) -> Chart:
        """The modes, and the ways between them. Raises DiagramError for names that are wrong or missing."""
        try:
            return Chart(self.modes, self.transitions)
        except DiagramError as error:
            raise DiagramError(error.what, f"block {self.label or type(self).__name__}", error.remedy) from error

    @cached_property
    def graph(self) -> MachineGraph:
        """What guards and actions record, checked. Raises DiagramError with the mode and the user's line."""
        made = MachineGraph(self)
        try:
            check_ways(self.chart, made)
        except DiagramError as error:
            raise DiagramError(error.what, f"block {self.label or type(self).__name__}", error.remedy) from error
        return made

    @property
    def states(self) -> Sequence[State]:
        """The variables, and what the machine remembers by itself."""
        return [*self.variables, *self.graph.states]

    @states.setter
    def states(self, value: Any) -> None:
        raise fault("the states of a state machine are assigned", "declare what its actions change in `variables`")

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return react(self, u, x, p, t)[1]

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return react(self, u, x, p, t)[0]
