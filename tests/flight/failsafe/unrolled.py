"""A block with its states as inputs and outputs: the compiled C of one step, on any state, case after case."""

from collections.abc import Mapping
from typing import Any

from twodof.blocks import Block, Diagram, Port
from twodof.compile import build
from twodof.signals import PERIOD


class Unrolled(Block):
    """`block`'s step: inputs `before_STATE` come on top, outputs `after_STATE`; its parameters stay."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self.inputs = [*block.inputs, *(Port(f"before_{s.name}", s.kind, unit=s.unit) for s in block.states)]
        self.outputs = [*block.outputs, *(Port(f"after_{s.name}", s.kind, unit=s.unit) for s in block.states)]
        self.params = block.params
        self.derived = block.derived

    def prepare(self, p: Any, t: Any) -> Any:
        return self.block.prepare(p, t)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        x = {s.name: u[f"before_{s.name}"] for s in self.block.states}
        states = type(u)(x)
        after = self.block.update(u, states, p, t)
        after = after if isinstance(after, Mapping) else {self.block.states[0].name: after}
        given = self.block.output(u, states, p, t)
        given = given if isinstance(given, Mapping) else {self.block.outputs[0].name: given}
        return {**given, **{f"after_{name}": value for name, value in after.items()}}


def unrolled(block: Block, precision: str = "float64") -> Any:
    """A compiled machine with the ports of `Unrolled(block)`, and its parameters as `block.NAME`."""
    d = Diagram("unrolled")
    item = Unrolled(block)
    for port in item.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    d.add("block", item, inputs={port.name: port.name for port in item.inputs})
    for port in item.outputs:
        d.output(port.name, f"block.{port.name}")
    return build(d, PERIOD, precision).machine()
