"""Closed loop with the failsafe and a user's controller that fails, flown piece by piece."""

import functools
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Block, Diagram, Param, Port, State, where
from twodof.flight.starters.attitude import with_ports
from twodof.flight.templates import ATTITUDE
from twodof.signals import PERIOD
from twodof.sim.closed_loop import ClosedLoop, InitialState

PERIOD_MS = 1e3 * PERIOD


class Failing(Block):
    """A user's attitude controller, P on pitch and rate, whose moment is `wrong` from its tick `at` on.

    The wrong moment is `wrong` times infinity (0: NaN).
    """

    inputs = tuple(Port(p.name, p.kind, unit=p.unit) for p in ATTITUDE.inputs)
    outputs = (Port("M"),)
    states = (State("count", 0, "int32"),)
    params = (Param("at", 1_000_000, "int32", low=0), Param("wrong", 0.0))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        right = 0.0854 * (where(u.FLAG_ATTITUDE_ENABLED, 11.0 * (u.theta_0 - u.theta), u.q_0) - u.q)
        return where(x.count < p.at, right, p.wrong * inf)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.count + 1


@functools.cache
def compiled(own: bool, precision: str) -> ClosedLoop:
    """Return the closed loop; with `own`, `Failing` flies in it."""
    controllers: list[Diagram] = []
    if own:
        controllers.append(with_ports(ATTITUDE, "failing", ""))
        controllers[0].add("law", Failing(), inputs={port.name: port.name for port in ATTITUDE.inputs})
        controllers[0].output("M", "law")
    return ClosedLoop(controllers=controllers, precision=precision, failsafe=True)


class FaultyLoop:
    """A flight of the `lab` rig with the failsafe, in steps of 4 ms, that starts disarmed and level at x = 0."""

    def __init__(self, own: bool = False, precision: str = "float64", rings: bool = True) -> None:
        self.loop = compiled(own, precision)
        self.machine = self.loop.machine
        self.loop.configure({**self.loop.rig, "rings": rings, "seed": 1})
        self.loop.start(InitialState())
        self.now: dict[str, Any] = {"arm": False}

    def fly(self, seconds: float, **changes: Any) -> dict[str, NDArray[Any]]:
        """Fly on with inputs changed; an input may be an array with a value for each step. Each signal is (steps,)."""
        out = self.loop.fly(round(seconds / PERIOD), self.now | changes)
        self.now |= {name: np.asarray(value).flat[-1].item() for name, value in changes.items()}
        return out

    def take_off(self, seconds: float = 3.0, **setpoints: Any) -> None:
        """Arm, then fly for `seconds`, in attitude mode with thrust .4 unless the set-points say otherwise."""
        self.fly(0.4)
        armed = self.fly(0.1, arm=True)
        assert armed["state"][-1] == 2, armed["reason"][-1]
        out = self.fly(seconds, **({"mode": 3, "thrust": 0.4} | setpoints))
        assert np.all(out["action"] == 0), set(out["reason"].tolist())


def first(condition: NDArray[Any]) -> float:
    """Return the time to the first step in which a condition holds [ms]; infinite if it never does."""
    steps = np.flatnonzero(condition)
    return PERIOD_MS * float(steps[0]) if steps.size else float("inf")
