"""Conditions of sub-diagrams: blocks that the language adds to decide when a sub-diagram acts."""

from functools import reduce
from operator import and_
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Port, State

__all__ = ["EDGES", "EnabledAgain", "TriggerEdge", "edge_of"]

EDGES = ("rising", "falling", "either")


def edge_of(edge: str, before: Any, now: Any) -> Any:
    """Return True if a bool that was `before` and is `now` has an edge of this kind, one of EDGES."""
    if edge == "either":
        return now ^ before
    return now & ~before if edge == "rising" else ~now & before


class EnabledAgain(Block):
    """y is true in the sample in which all of the bools e0, e1, ... hold and did not hold in the sample before.

    The start is not such a sample: the states are initial then anyway, or what was set.
    """

    crossing = True

    def __init__(self, enables: int) -> None:
        self.inputs = [Port(f"e{i}", "bool") for i in range(enables)]
        self.outputs = [Port("y", "bool")]
        self.states = [State("x", True, "bool")]

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return reduce(and_, (u[port.name] for port in self.inputs))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.update(u, x, p, t) & ~x.x


class TriggerEdge(Block):
    """y is true in the sample in which u has an edge. The first sample does not: what u was before is not known."""

    crossing = True

    def __init__(self, edge: str) -> None:
        self.edge = edge
        self.inputs = [Port("u", "bool")]
        self.outputs = [Port("y", "bool")]
        self.states = [State("before", False, "bool"), State("begun", False, "bool")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return x.begun & edge_of(self.edge, x.before, u.u)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"before": u.u, "begun": True}
