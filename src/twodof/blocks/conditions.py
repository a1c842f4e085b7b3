"""What decides when a sub-diagram acts: blocks that the language itself adds where a part asks for them."""

from functools import reduce
from operator import and_
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Port, State

__all__ = ["EnabledAgain"]


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
