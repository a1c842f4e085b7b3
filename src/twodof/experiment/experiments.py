"""Experiments: protocols of flights, with the excitation, the loop that it enters, and the cart locked or free."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ExperimentError, nearest
from twodof.excitation import Doublet, Excitation, Impulse, Prbs, Steps, Sweep
from twodof.signals import HOVER, MODES, OFF, OPEN_LOOP, PERIOD
from twodof.sim.closed_loop import ARMING

SETPOINT = MappingProxyType(
    {"open-loop": "M_open", "rate": "q0", "attitude": "theta0", "velocity": "v0", "position": "x0"}
)
"""The set-point that an excitation is added to, by mode."""

LOOP = MappingProxyType({"open-loop": "M", "rate": "q", "attitude": "theta", "velocity": "v", "position": "x"})
"""The outermost loop of each mode, by its name in `Drone.excite`."""
LOOP_MODES: Mapping[str, str] = MappingProxyType({loop: mode for mode, loop in LOOP.items()})

UNIT = MappingProxyType({"open-loop": "-", "rate": "rad/s", "attitude": "rad", "velocity": "m/s", "position": "m"})


@dataclass(frozen=True)
class Experiment:
    """One flight: `still` s with the motors off, `hold` s with `thrust`, the excitation, `rest` s, motors off.

    `mode` names the loop that `excitation` enters, a key of `SETPOINT`. With `rings` the cart is locked (1DoF), and the
    hold is level: it finds the trim moment to which an open-loop excitation is added. Without `rings` the hold keeps
    the start's position. At `thrust` 0 the hold is left out, and only the excitation turns the motors. Raises
    ExperimentError for an excitation in another unit than the loop's, and for a value out of bounds.
    """

    name: str
    mode: str
    excitation: Excitation
    rings: bool
    thrust: float = HOVER
    still: float = 0.5
    hold: float = 8.0
    rest: float = 1.0
    text: str = ""

    def __post_init__(self) -> None:
        if self.mode not in SETPOINT:
            raise ExperimentError(f"unknown mode {self.mode!r:.80}", self.name, f"use one of {', '.join(SETPOINT)}")
        if self.excitation.unit != UNIT[self.mode]:
            raise ExperimentError(
                f"the excitation is in {self.excitation.unit!r}, and the {self.mode} loop in {UNIT[self.mode]!r}",
                self.name,
                "give an excitation in the unit of the loop",
            )
        if not 0.0 <= self.thrust <= 1.0:
            raise ExperimentError(
                f"the thrust {self.thrust:g} is out of bounds", self.name, "give 0 to 1; the drone hovers at 0.4"
            )
        if self.thrust == 0.0 and self.mode != "open-loop":
            raise ExperimentError("a closed loop needs thrust", self.name, "give thrust, or fly it in open loop")
        if self.rings and self.mode in ("velocity", "position"):
            remedy = "free the cart (rings=False, or Reset)"
            raise ExperimentError(f"the {self.mode} loop moves the cart, and the rings lock it", self.name, remedy)
        for what in ("still", "hold", "rest"):
            if not 0.0 <= getattr(self, what) <= 600.0:
                raise ExperimentError(
                    f"{what} = {getattr(self, what)!r} s is out of bounds", self.name, "give 0 to 600 s"
                )

    @property
    def lead(self) -> float:
        """Time from the start of the flight to that of the excitation [s]."""
        return self.still + (self.hold if self.thrust > 0.0 else 0.0)

    @property
    def duration(self) -> float:
        """Duration of the flight [s], with `still` s with the motors off at its end."""
        return self.lead + self.excitation.duration + self.rest + self.still


_IDENTIFICATION = (
    Experiment(
        "impulse",
        "open-loop",
        Impulse(0.1, 0.2, lead=0.5),
        rings=True,
        thrust=0.0,
        rest=24.0,
        text="the paper's experiment 1: M = 0.1 for 0.2 s, then the free response",
    ),
    Experiment(
        "doublet",
        "open-loop",
        Doublet(0.03, 0.6, lead=0.2),
        rings=True,
        hold=20.0,
        rest=0.4,
        text="the paper's experiment 2: a doublet of the moment about its trim",
    ),
    Experiment(
        "velocity-doublet",
        "attitude",
        Doublet(radians(15.0), 1.6, unit="rad", lead=0.2),
        rings=False,
        rest=0.6,
        text="the paper's section 4.2: a doublet of the pitch set-point, cart free",
    ),
)

_COURSE = (
    Experiment(
        "attitude-steps",
        "attitude",
        Steps((radians(10.0), 0.0, radians(-10.0), 0.0), 2.0, unit="rad", lead=0.5),
        rings=True,
        text="steps of +-10 deg of the pitch set-point",
    ),
    Experiment(
        "rate-doublets",
        "rate",
        Doublet(radians(30.0), 1.0, unit="rad/s", lead=0.5, repeat=3, pause=2.0, settle=1.0),
        rings=True,
        text="three doublets of +-30 deg/s of the pitch-rate set-point",
    ),
    Experiment(
        "velocity-doublets",
        "velocity",
        Doublet(0.15, 4.0, unit="m/s", lead=0.5),
        rings=False,
        text="a doublet of +-0.15 m/s of the velocity set-point",
    ),
    Experiment(
        "position-sweep",
        "position",
        Sweep(0.15, 0.1, 1.0, 25.0, unit="m", lead=0.5),
        rings=False,
        text="a sweep of the position set-point from 0.1 to 1 Hz",
    ),
    Experiment(
        "attitude-prbs",
        "attitude",
        Prbs(radians(4.0), 0.06, 7, unit="rad", lead=0.5),
        rings=True,
        text="a pseudo-random binary pitch set-point, for identification in closed loop",
    ),
)

IDENTIFICATION: Mapping[str, Experiment] = MappingProxyType({one.name: one for one in _IDENTIFICATION})
"""The paper's three identification experiments, by name."""

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({one.name: one for one in (*_IDENTIFICATION, *_COURSE)})
"""All ready-made experiments, by name."""


def experiment(name: str, **changes: Any) -> Experiment:
    """Return the ready-made experiment `name` with fields changed. Raises ExperimentError for an unknown name."""
    if name not in EXPERIMENTS:
        raise ExperimentError(f"no experiment called {name!r:.80}", "", f"there are: {nearest(name, EXPERIMENTS)}")
    known = EXPERIMENTS[name].__dataclass_fields__
    for field in changes:
        if field not in known:
            raise ExperimentError(f"an experiment has no field {field!r:.80}", name, f"it has: {', '.join(known)}")
    return replace(EXPERIMENTS[name], **changes)


def on_wire(value: float) -> float:
    """Round a set-point to float32, as a MAVLink message carries it."""
    return float(np.float32(value))


@dataclass(frozen=True, eq=False)
class Script:
    """Set-points of an experiment at each control step, (steps,) by name, and the steps at which its phases begin.

    The drone arms at step `armed`, thrust starts at `hold`, the excitation at `begin`. At step `end` the drone disarms.
    """

    setpoints: Mapping[str, NDArray[np.generic]]
    steps: int
    armed: int
    hold: int
    begin: int
    end: int

    @property
    def arm(self) -> NDArray[np.bool_]:
        """Mask of the steps in which the drone is armed, (steps,)."""
        step = np.arange(self.steps)
        return (step >= self.armed) & (step < self.end)


def script(experiment: Experiment, x_start: float = 0.0) -> Script:
    """Return the script of `experiment`: its set-points at 250 Hz, with positions about `x_start` [m].

    Thrust and position are rounded to float32, as messages carry them; the excitation is computed on board.
    """
    thrust_flown, x_flown = on_wire(experiment.thrust), on_wire(x_start)
    steps = round(experiment.duration / PERIOD)
    begin = round(experiment.lead / PERIOD)
    still = round(experiment.still / PERIOD)
    excited = slice(begin, steps - still)
    mode = np.full(steps, OFF, dtype=np.int32)
    thrust, place = np.zeros(steps), np.zeros(steps)
    if experiment.thrust > 0.0:
        mode[still:begin] = MODES.index("attitude" if experiment.rings else "position")
        # In position mode the thrust is the velocity loop's.
        thrust[still:begin] = thrust_flown if experiment.rings else 0.0
        place[still : steps - still] = 0.0 if experiment.rings else x_flown
    mode[excited] = MODES.index(experiment.mode)
    thrust[excited] = thrust_flown
    setpoints: dict[str, NDArray[np.generic]] = {
        "mode": mode,
        "thrust": thrust,
        "use_trim": (mode == OPEN_LOOP) & (thrust > 0.0),
        "x0": place,
    }
    name = SETPOINT[experiment.mode]
    values = np.array(setpoints.get(name, np.zeros(steps)), dtype=np.float64)
    values[excited] += experiment.excitation.at(np.arange(steps - still - begin) * PERIOD)
    return Script(setpoints | {name: values}, steps, min(ARMING, still), still, begin, steps - still)
