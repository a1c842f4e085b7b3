"""The set-points of an experiment at every step of the flight controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.experiment.protocol import SETPOINT, Experiment
from twodof.flight.core import PERIOD
from twodof.signals import MODES


@dataclass(frozen=True, eq=False)
class Script:
    """`setpoints` (steps,) by name, as the closed loop takes them.

    The excitation plays from step `begin` on; at step `end` the motors go off.
    """

    setpoints: Mapping[str, NDArray[np.generic]]
    steps: int
    begin: int
    end: int


def script(experiment: Experiment, x_start: float = 0.0) -> Script:
    """`experiment` written out at 250 Hz, with positions about `x_start` [m]."""
    steps = round(experiment.duration / PERIOD)
    begin = round(experiment.lead / PERIOD)
    still = round(experiment.still / PERIOD)
    powered = slice(still, steps - still)
    mode = np.full(steps, MODES.index("off"), dtype=np.int32)
    thrust = np.zeros(steps)
    if experiment.thrust > 0.0:
        mode[still:begin] = MODES.index("attitude" if experiment.rings else "position")
        thrust[powered] = experiment.thrust
    excited = slice(begin, steps - still)
    mode[excited] = MODES.index(experiment.mode)
    setpoints: dict[str, NDArray[np.generic]] = {
        "mode": mode,
        "thrust": thrust,
        "use_trim": np.full(steps, experiment.mode == "open-loop" and experiment.thrust > 0.0),
        "x0": np.full(steps, x_start),
    }
    name = SETPOINT[experiment.mode]
    values = np.array(setpoints.get(name, np.zeros(steps)), dtype=np.float64)
    values[excited] += experiment.excitation.at(np.arange(steps - still - begin) * PERIOD)
    return Script(setpoints | {name: values}, steps, begin, steps - still)
