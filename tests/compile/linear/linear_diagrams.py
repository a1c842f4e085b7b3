"""Small diagrams whose linear model is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tests.compile.examples import Pendulum
from twodof.blocks import Block, Diagram

DT = 0.004


def chain(*blocks: Block, name: str = "chain") -> Diagram:
    """u -> block -> block ... -> y, each with its first input and output."""
    d = Diagram(name)
    source = d.input("u")
    for i, block in enumerate(blocks):
        part = d.add(f"b{i}", block)
        d.connect(source, f"{part}.{block.inputs[0].name}")
        source = f"{part}.{block.outputs[0].name}"
    d.output("y", source)
    return d


def pendulum() -> Diagram:
    d = Diagram("pendulum")
    d.input("M")
    d.add("p", Pendulum(), moment="M")
    d.output("theta", "p.theta")
    return d


def same_response(found: Any, expected: Any, rtol: float = 1e-9) -> None:
    """Two systems with the same frequency response; 20 frequencies settle an order below 20."""
    top = 200.0 if found.dt is None else 0.9 * math.pi / found.dt
    omega = np.geomspace(0.05, top, 20)
    s = 1j * omega if found.dt is None else np.exp(1j * omega * found.dt)
    np.testing.assert_allclose(found.response(omega)[:, 0, 0], expected(s), rtol=rtol)


# Equations
