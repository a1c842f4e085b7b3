"""Small diagrams whose linear model is known."""

import math
import random
from typing import Any

import numpy as np

from tests.compile.examples import Pendulum
from twodof.blocks import Block, Diagram, Param, Port, State, sqrt
from twodof.blocks.elementary import functions as f

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


class Smooth(Block):
    """Two states, smooth and coupled, discrete or continuous."""

    inputs = (Port("u"),)
    outputs = (Port("y"), Port("z"))

    def __init__(self, continuous: bool, seed: int) -> None:
        r = random.Random(seed)
        self.k = [r.uniform(-1.0, 1.0) for _ in range(9)]
        self.params = [Param("p", r.uniform(0.5, 1.5))]
        self.derived = [Port("double")]
        start = [r.uniform(-0.5, 0.5) for _ in range(2)]
        self.states = [State("a", start[0], continuous=continuous), State("b", start[1], continuous=continuous)]

    def prepare(self, p: Any, t: Any) -> Any:
        return 2.0 * p.p

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        k = self.k
        return {"y": k[0] * f.sin(x.a) + x.b * x.b, "z": k[1] * f.tanh(u.u + x.a) + sqrt(2.0 + x.b * u.u)}

    def _change(self, u: Any, x: Any, p: Any) -> Any:
        k = self.k
        a = k[2] * x.a + f.atan2(x.b + u.u, 2.0 + x.a) * p.double
        return {"a": a, "b": k[3] * f.exp(k[4] * x.a) - x.b / (1.0 + x.a * x.a) + k[5] * u.u}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {} if self.states[0].continuous else self._change(u, x, p)

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self._change(u, x, p) if self.states[0].continuous else {}
