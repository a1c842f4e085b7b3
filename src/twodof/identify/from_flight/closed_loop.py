"""What is known before of the machine that a log in closed loop is of: its cart, its rings, its pendulum."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from twodof.flightlog.log import FlightLog
from twodof.models.structure import Structure
from twodof.rig.parameters import NAMES, load_rig
from twodof.rig.steady_state import cart_parameters, model_parameters

POLES_BEFORE: Mapping[str, tuple[float, float]] = MappingProxyType({"w_n": (2.28, 0.31), "xi": (0.05, 0.05)})
"""What the real drone's logs tell of the pendulum while the rotors run (docs/explanation/physics.md, section 9).

The stiffness is 5.2 +- 1.4 1/s2. The damping is between that of the free response beside dry friction, .036, and with
all of it taken for viscous, .10."""

FRICTION_BEFORE: Mapping[str, tuple[float, float]] = MappingProxyType({"coulomb": (0.05, 0.05)})
"""The bearing's dry friction: not less than nothing, and a fraction of the .26 rad/s2 with the rotors at rest."""

BEND_BEFORE: Mapping[str, tuple[float, float]] = MappingProxyType({"bend": (0.0, 1.0)})
"""What a large moment may lack: of the hardest of the real logs, .35, an eighth."""

FREE = 1e3
"""Play of a cart without rings [m]. Its modelled way drifts by metres in half a minute, and must meet no stop."""

_REAL = "lab"
_MOVED_M = 0.1
"""The range sensor's noise stays within this in a flight with rings; a free cart moves three times as far [m]."""


@dataclass(frozen=True)
class FlownMachine:
    """The rig whose calibration holds for a flight, and whether its cart was `free` to slide."""

    rig: str = _REAL
    free: bool = False

    @property
    def text(self) -> str:
        """In words."""
        return f"'{self.rig}' with its cart {'free' if self.free else 'in rings'}"

    def values(self, structure: Structure) -> dict[str, float]:
        """What the calibration knows of the structure's unknowns: the cart, and its play within the rings."""
        return known_cart(load_rig(self.rig).snapshot(), structure, self.free)

    def prior(self, structure: Structure) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of what is known less well; it is estimated along."""
        return known_before(None if self.rig == _REAL else load_rig(self.rig).snapshot(), structure)

    def estimate(self, structure: Structure) -> tuple[str, ...]:
        """What a flight in closed loop is to tell: of `pitch_on_cart` also what a large moment lacks, and on a free
        cart the moment of its speed.
        """
        more = ("bend", *(("M_u",) if self.free else ()))
        return (*structure.estimate, *(name for name in more if name in structure.unknowns))


def known_cart(rig: Mapping[str, float], structure: Structure, free: bool) -> dict[str, float]:
    """What a rig with these parameters says of the structure's unknowns: the cart, and its play within the rings."""
    known = {**cart_parameters(rig), "play": FREE if free else rig["ring_play"]}
    return {name: value for name, value in known.items() if name in structure.unknowns}


def known_before(rig: Mapping[str, float] | None, structure: Structure) -> dict[str, tuple[float, float]]:
    """Mean and deviation of the poles, of the bearing's friction and of `bend`, where the structure has them.

    The poles' means are those of the `rig` with its rotors running; without one, those that the real logs tell.
    """
    poles = dict(POLES_BEFORE)
    if rig is not None:
        poles = {name: (model_parameters(rig)[f"{name}_run"], poles[name][1]) for name in poles}
    before = {**poles, **FRICTION_BEFORE, **BEND_BEFORE}
    return {name: one for name, one in before.items() if name in structure.unknowns}


def machine_of(log: FlightLog, start: float, stop: float) -> FlownMachine:
    """The machine of a log, by the rig that it names, and by the way that the cart made from `start` to `stop` [s].

    A log that names no virtual rig is one of the real drone, whose calibration is `lab`.
    """
    said = log.provenance.get("rig")
    seen = log["dist"].slice(start, stop).value if "dist" in log else np.zeros(0)
    moved = seen.size > 0 and float(np.ptp(seen)) > _MOVED_M
    return FlownMachine(said if isinstance(said, str) and said in NAMES else _REAL, moved)
