"""The set-points of an experiment at every step of the flight controller."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.experiment.experiments import SETPOINT, Experiment
from twodof.signals import MODES, OFF, OPEN_LOOP, PERIOD
from twodof.sim.closed_loop import ARMING


def on_wire(value: float) -> float:
    """A set-point as a MAVLink message carries it: rounded to float32."""
    return float(np.float32(value))


@dataclass(frozen=True, eq=False)
class Script:
    """`setpoints` (steps,) by name, as the closed loop takes them.

    The drone is armed at step `armed`, and the thrust comes up at step `hold`. The excitation plays from step `begin`
    on. At step `end` the drone is disarmed and the motors go off.
    """

    setpoints: Mapping[str, NDArray[np.generic]]
    steps: int
    armed: int
    hold: int
    begin: int
    end: int

    @property
    def arm(self) -> NDArray[np.bool_]:
        """Whether the drone is armed, (steps,)."""
        step = np.arange(self.steps)
        return (step >= self.armed) & (step < self.end)


def script(experiment: Experiment, x_start: float = 0.0) -> Script:
    """`experiment` written out at 250 Hz, with positions about `x_start` [m].

    Thrust and place are those that a flight's messages carry, float32; an excitation is played on board as it is.
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
