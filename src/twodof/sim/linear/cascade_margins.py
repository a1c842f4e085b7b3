"""The loops of the cascade as they fly, controllers and rig together, and the margins of each."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.declarations import unknown_name
from twodof.design import LoopMargins, LoopTransfer, margins
from twodof.flight.gains import DEFAULT, Gains
from twodof.rig.parameters import load_rig
from twodof.signals import PERIOD
from twodof.sim.linear.linear_controller import linear_controller
from twodof.sim.linear.linear_rig import SIGNALS, linear_rig

MOTORS = "motors"

LOOPS: Mapping[str, str] = MappingProxyType(
    {
        MOTORS: "at the moment M, rate and attitude loop closed: what the motors may do",
        "rate": "at q, in rate mode",
        "attitude": "at theta, the rate loop closed",
        "velocity": "at v, the loops inside closed",
        "position": "at x, the loops inside closed",
    }
)
"""The loops, and where each is broken."""

_READ = MappingProxyType({"rate": "q", "attitude": "theta", "velocity": "v", "position": "x"})


def cascade_loop(
    loop: str,
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    rig: str | Mapping[str, float] = "lab",
) -> LoopTransfer:
    """L of one of `LOOPS` as it flies, sampled at 250 Hz: the loops inside closed, those outside open.

    `rig` is "lab", "paper", a file, or the values of a rig's parameters by name. `controllers` fly in place of the
    stock ones, with the gains of those that are left. What is made linear and how: `linear_rig`. Raises DiagramError
    for another loop, for a controller that fits no template, and for one without a slope in hover; ParameterError for
    another rig.
    """
    if loop not in LOOPS:
        raise unknown_name("loop", loop, LOOPS, "cascade_loop")
    values = load_rig(rig).snapshot() if isinstance(rig, str) else rig
    plant = linear_rig(values)
    law = linear_controller("attitude" if loop == MOTORS else loop, gains, controllers)
    m = len(law.a)
    if loop == MOTORS:
        # fore = T + M, aft = T - M; the thrust's way stays closed.
        moment, thrust = np.array([[0.5, -0.5]]), np.full((2, 2), 0.5)
        kept = plant.b @ thrust
        a = np.block([[plant.a + kept @ law.d @ plant.c, kept @ law.c], [law.b @ plant.c, law.a]])
        b = np.vstack([plant.b @ [[1.0], [-1.0]], np.zeros((m, 1))])
        return LoopTransfer(a, b, -(moment @ np.hstack([law.d @ plant.c, law.c])), 0.0, PERIOD)
    broken = SIGNALS.index(_READ[loop])
    closed = np.ones((len(SIGNALS), 1))
    closed[broken] = 0.0
    read = closed * plant.c
    a = np.block([[plant.a + plant.b @ law.d @ read, plant.b @ law.c], [law.b @ read, law.a]])
    b = np.vstack([plant.b @ law.d[:, [broken]], law.b[:, [broken]]])
    return LoopTransfer(a, b, -np.hstack([plant.c[[broken]], np.zeros((1, m))]), 0.0, PERIOD)


def cascade_margins(
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    rig: str | Mapping[str, float] = "lab",
    loops: Sequence[str] = tuple(LOOPS),
) -> dict[str, LoopMargins]:
    """The margins of each of `loops` as it flies, see `cascade_loop`: `cascade_margins(rig="paper")["rate"].disk`."""
    flown = tuple(controllers)
    return {loop: margins(cascade_loop(loop, gains, flown, rig)) for loop in loops}
