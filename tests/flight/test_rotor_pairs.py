"""Around a user's controllers: a NaN or infinity stops the motors, motors make pairs, flags follow the mode."""

import math
from typing import Any

import numpy as np
import pytest

from twodof.blocks import Block, Diagram
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import build
from twodof.flight.mixer import FiniteCommands, MotorFlags, RotorPairs
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, PERIOD, POSITION, RATE, VELOCITY


def step(block: Block, **inputs: Any) -> dict[str, Any]:
    d = Diagram("one")
    for port in block.inputs:
        d.input(port.name, port.kind)
    d.add("block", block, **{port.name: port.name for port in block.inputs})
    for port in block.outputs:
        d.output(port.name, f"block.{port.name}")
    compiled = build(d, PERIOD).machine().step(inputs)
    interpreted = Reference(d, PERIOD).machine().step(inputs)
    np.testing.assert_equal({k: float(v) for k, v in compiled.items()}, {k: float(v) for k, v in interpreted.items()})
    return compiled


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_stops_the_motors(bad: float) -> None:
    assert step(FiniteCommands(), M=0.1, T=0.4) == {"M": 0.1, "T": 0.4}
    assert step(FiniteCommands(), M=bad, T=0.4) == {"M": 0.0, "T": 0.0}
    assert step(FiniteCommands(), M=0.1, T=bad) == {"M": 0.0, "T": 0.0}
    out = step(RotorPairs(), mode=ATTITUDE, motor_1=0.5, motor_2=0.3, motor_3=bad, motor_4=0.3)
    assert (out["fore"], out["aft"], out["M"]) == (0.25, 0.3, pytest.approx(-0.025))
    assert math.isnan(out["M_shown"])
    assert math.isnan(out["T_shown"])


def test_a_pair_gets_the_mean_of_its_clipped_motors() -> None:
    out = step(RotorPairs(), mode=ATTITUDE, motor_1=1.5, motor_2=-0.2, motor_3=0.5, motor_4=0.4)
    assert out == {"fore": 0.75, "aft": 0.2, "M": 0.275, "T": 0.475, "M_shown": 0.275, "T_shown": 0.475}
    off = step(RotorPairs(), mode=OFF, motor_1=1.0, motor_2=math.nan, motor_3=1.0, motor_4=1.0)
    assert set(off.values()) == {0.0}


@pytest.mark.parametrize(
    ("mode", "closed"),
    [
        (OFF, set()),
        (OPEN_LOOP, set()),
        (RATE, {"rate"}),
        (ATTITUDE, {"rate", "attitude"}),
        (VELOCITY, {"rate", "attitude", "velocity"}),
        (POSITION, {"rate", "attitude", "velocity", "position"}),
    ],
)
def test_the_flags_say_which_loops_a_mode_closes(mode: int, closed: set[str]) -> None:
    assert {name for name, value in step(MotorFlags(), mode=mode).items() if value} == closed
