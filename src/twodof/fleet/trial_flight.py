"""A trial of a controller before it is flashed: the margins of its loops, and a short flight of the virtual rig."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.design import LoopMargins
from twodof.errors import DiagramError
from twodof.flight.gains import DEFAULT
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION
from twodof.rig.parameters import lab
from twodof.signals import HOVER, PERIOD
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.initial_state import InitialState
from twodof.sim.linear import LOOPS, cascade_margins

Array = NDArray[np.float64]

_STEPS, _AT = 750, 50
"""Control steps of the flight, and when the set-point steps: 3 s, .2 s."""

_PITCH, _PLACE = math.radians(3.0), 0.05
"""The steps of theta [rad] and x [m]: small, so that a sound controller stays far from its limits."""

_QUIET, _LASTS, _GROWS = 0.3, 0.7, 1.3
"""A swing of the pitch rate [rad/s] that is left alone; what is left of one from third to third that does not die out;
and of one that grows."""

_SOON = 1.0
"""A linear motion that grows by the factor e in less than this [s] is a fault, also where the flight does not show it:
it may belong to a mode that was not flown. Slower ones are what the drone does without control."""


@dataclass(frozen=True)
class _Plan:
    mode: str
    setpoint: str
    size: float
    rings: bool
    loops: tuple[str, ...]


_PLANS: Mapping[str, _Plan] = MappingProxyType(
    {
        ATTITUDE.name: _Plan("attitude", "theta0", _PITCH, True, ("motors", "rate", "attitude")),
        POSITION.name: _Plan("position", "x0", _PLACE, False, ("velocity", "position")),
        MOTOR.name: _Plan("position", "x0", _PLACE, False, tuple(LOOPS)),
    }
)


@dataclass(frozen=True)
class TrialFlight:
    """What a controller did on the `lab` rig. `fault` says why it must not fly, "" if nothing speaks against it.

    `margins` are those of the loops that it closes, empty where they are not known, which `unknown` then explains.
    """

    margins: Mapping[str, LoopMargins]
    unknown: str
    fault: str

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "margins": {name: m.to_json() for name, m in self.margins.items()},
            "margins_unknown": self.unknown or None,
            "fault": self.fault or None,
        }


def trial_flight(diagram: Diagram, template: str, target: str = "native") -> TrialFlight:
    """Flies `diagram` of the template called `template` for 3 s without noise: a step of 3 deg, or of 5 cm.

    An attitude controller flies with the cart locked, the others free. The other loops are the stock ones. A fault is
    a swing that does not die out, a stop that is reached, or a linear motion of a loop that grows fast. `target`
    is where it flies, as `ClosedLoop`'s. Raises DiagramError for a diagram that does not compile.
    """
    plan = _PLANS[template]
    margins: dict[str, LoopMargins] = {}
    unknown = ""
    try:
        margins = cascade_margins(DEFAULT, [diagram], "lab", plan.loops)
    except DiagramError as reason:
        unknown = str(reason)
    rig = lab()
    loop = ClosedLoop(DEFAULT, rig, {"noise": 0.0, "rings": plan.rings}, controllers=[diagram], target=target)
    loop.start(InitialState(hover=True))
    stepped = np.where(np.arange(_STEPS) < _AT, 0.0, plan.size)
    out = loop.fly(_STEPS, {"mode": plan.mode, "thrust": HOVER, plan.setpoint: stepped})
    stops = float(rig["pitch_stop"]), float(rig["rail_stop"])
    return TrialFlight(margins, unknown, _fault(out, stops, margins))


def _fault(out: Mapping[str, Array], stops: tuple[float, float], margins: Mapping[str, LoopMargins]) -> str:
    swing = _fastest(margins)
    if swing is not None:
        return swing
    rate = np.asarray(out["true_q"], dtype=np.float64)
    for name, values, stop in (("pitch", out["true_theta"], stops[0]), ("cart", out["true_x"], stops[1])):
        beyond = np.flatnonzero(~(np.abs(values) < 0.98 * stop))
        if beyond.size:
            return f"the {name} is at its stop {PERIOD * max(0, int(beyond[0]) - _AT):.1f} s after the step"
    third = _STEPS // 3
    middle, late = (float(np.ptp(part)) for part in (rate[third : 2 * third], rate[2 * third :]))
    if late > _QUIET and late > _LASTS * middle:
        how = "growing" if late > _GROWS * middle else "and does not stop"
        return f"swings at {_frequency(rate[2 * third :]):.2g} rad/s, {how}"
    return ""


def _fastest(margins: Mapping[str, LoopMargins]) -> str | None:
    """What the fastest growing of the unstable loops does, if that is fast."""
    motions = [m.motion for m in margins.values() if not m.stable and m.motion is not None]
    worst = max(motions, key=lambda motion: motion.growth, default=None)
    return None if worst is None or worst.growth * _SOON < 1.0 else worst.text


def _frequency(values: Array) -> float:
    """Of a swing [rad/s], by how often it passes its mean."""
    level = values - values.mean()
    passes = np.flatnonzero(np.sign(level[1:]) != np.sign(level[:-1]))
    if passes.size < 2:
        return math.pi / (PERIOD * len(values))
    return math.pi * (passes.size - 1) / (PERIOD * float(passes[-1] - passes[0]))
