"""One block in a diagram of its own, run by the reference."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import settings

from twodof.blocks.block import Block
from twodof.blocks.bus import grouped
from twodof.blocks.declarations import numeric
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.namespaces import Clock, Parameters
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.trace import names_given

few = settings(max_examples=20)
"""For properties of blocks: each example is hundreds of steps on the reference."""


def alone(block: Block) -> Diagram:
    """A diagram that is `block` under the name "block", its ports being those of the diagram."""
    d = Diagram("alone")
    inputs = grouped(block.inputs)
    for port in inputs:
        d.declare(replace(port, name=f"{port.name}_in", width=None if port.shape else port.width))
    d.add("block", block, **{port.name: f"{port.name}_in" for port in inputs})
    for port in grouped(block.outputs):
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
    rows = machine.run(steps, {f"{name}_in": value for name, value in (inputs or {}).items()})
    return {name.removesuffix("_out"): values for name, values in rows.items()}


def run_y(block: Block, u: Any, dt: float = 0.01, params: Mapping[str, Any] | None = None) -> np.ndarray:
    """The first output of a block whose first input is `u`, an array of one row a step."""
    rows = run(block, len(u), dt, {block.inputs[0].name: u}, params)
    return rows[block.outputs[0].name]


def values_at(block: Block, ticks: Iterable[int], dt: float, precision: str = "float64") -> np.ndarray:
    """The bare output of a source without states at any ticks: none of those before has to be run."""
    with numbers.precision(precision):
        period = numbers.real_type()(dt)
        given = {p.name: numeric(p.value, p.kind, p.width, p.name) for p in block.params}
        prepared = block.prepare(Parameters(dict(given)), Clock(None, period, period))
        made = names_given("prepare", prepared, block.derived)
        derived = {d.name: numeric(made[d.name], d.kind, d.width, d.name) for d in block.derived}
        p, nothing = Parameters(given | derived), Parameters({})
        clocks = (Clock(numbers.UInt32(int(tick)), period, period) for tick in ticks)
        return np.array([numbers.plain(block.output(nothing, nothing, p, clock)) for clock in clocks])


def assert_close(found: Any, expected: Any, relative: float = 1e-12) -> None:
    """Equal to `relative` times the largest expected magnitude.

    The default leaves room for the other order in which scipy adds: some thousand roundings of 1e-16.
    """
    expected = np.asarray(expected, dtype=float)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * max(1e-300, float(np.max(np.abs(expected)))))


def noise(steps: int, seed: int = 1) -> np.ndarray:
    """A test input of standard normal numbers."""
    return np.random.default_rng(seed).standard_normal(steps)
