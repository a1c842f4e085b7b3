"""Write a block, join it with library blocks, run it interpreted and compiled: the same bits."""

from typing import Any

import numpy as np

from twodof.blocks import Block, Diagram, Param, Port, State, maximum, minimum
from twodof.blocks.library import Gain, Sum
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build


class LimitedIntegrator(Block):
    """y' = u, kept within +-limit (forward Euler)."""

    inputs = (Port("u", unit="rad/s"),)
    outputs = (Port("y", unit="rad"),)
    states = (State("y", unit="rad"),)
    params = (Param("limit", 1.0, unit="rad", low=0.0, text="largest magnitude"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        """The state: u has no feed-through, so the loop below is not algebraic."""
        return x.y

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        """`minimum` and not Python's `if`: both branches exist when the C is made."""
        return maximum(-p.limit, minimum(p.limit, x.y + u.u * t.dt))


loop = Diagram("loop", "an angle that follows r")
loop.input("r", unit="rad")
loop.param("k", 20.0, low=0.0, high=100.0, text="loop gain [1/s]")
loop.add("error", Sum("+-", unit="rad"), a="r", b="angle")
loop.add("gain", Gain(input_unit="rad", unit="rad/s"), u="error", params={"k": "k"})
loop.add("angle", LimitedIntegrator(), u="gain")
loop.output("y", "angle")

step = {"r": np.where(np.arange(500) < 250, 0.5, 2.0)}
compiled = build(loop, dt=0.004).machine().run(500, step)["y"]
interpreted = Reference(loop, 0.004).machine().run(500, step)["y"]
print(f"after one second {compiled[249]:.4f} rad, after two {compiled[-1]:.4f} rad: the limit")
print(f"compiled and interpreted differ in {np.count_nonzero(compiled != interpreted)} of 500 samples")

# A diagram travels as JSON, own blocks as their traced expressions; loading one executes nothing.
travelled = build(from_json(to_json(loop)), dt=0.004).machine().run(500, step)["y"]
print(f"and from JSON in {np.count_nonzero(compiled != travelled)}")
