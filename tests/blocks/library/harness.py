"""One block in a diagram of its own, run by the reference."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from twodof.blocks.block import Block
from twodof.blocks.diagram import Diagram
from twodof.blocks.reference import Reference


def alone(block: Block) -> Diagram:
    """A diagram that is `block` under the name "block", its ports being those of the diagram."""
    d = Diagram("alone")
    for port in block.inputs:
        d.input(port.name, port.kind, port.width, port.unit)
    d.add("block", block, **{port.name: port.name for port in block.inputs})
    for port in block.outputs:
        d.output(f"{port.name}_out", f"block.{port.name}")
    return d


def run(
    block: Block,
    steps: int,
    dt: float = 0.01,
    inputs: Mapping[str, Any] | None = None,
    params: Mapping[str, Any] | None = None,
    precision: str = "float64",
) -> dict[str, np.ndarray]:
    """The block's outputs by name, one row a step."""
    machine = Reference(alone(block), dt, precision).machine()
    machine.set_many({f"block.{name}": value for name, value in (params or {}).items()})
    machine.reset()
    return {name.removesuffix("_out"): rows for name, rows in machine.run(steps, inputs or {}).items()}


def run_y(block: Block, u: Any, dt: float = 0.01, params: Mapping[str, Any] | None = None) -> np.ndarray:
    """The output of a block with the input `u` (an array of one row a step) and one output."""
    (port,) = block.inputs[:1]
    (rows,) = run(block, len(u), dt, {port.name: u}, params).values()
    return rows
