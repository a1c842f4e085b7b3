"""Prediction of the motion in an excitation before it is flown, by the simulated closed loop."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ExperimentError
from twodof.excitation import Excitation, from_dict
from twodof.experiment.experiments import LOOP_MODES, SETPOINT, Experiment
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES, NONE
from twodof.flight.gains import DEFAULT, Gains
from twodof.signals import HOVER, MODES, OFF, PERIOD
from twodof.sim.closed_loop import ARMING, ClosedLoop, InitialState
from twodof.sim.resimulation import estimates_in, identified_rig, load_rig_or_model

LONGEST_S = 120.0
"""Longest predicted part of an excitation [s], which shows the motion and is computed quickly."""

BEFORE_S = 0.2
AFTER_S = 1.0
"""Hover before the excitation, and flight after it [s]."""

_EACH = 5
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """Motion in an excitation, with the rig's noise of one seed.

    `time` [s since the excitation's start], pitch `theta` [rad], position `x` [m] and moment `M` are (n,) at 250 Hz.
    `pitch_stop` [rad] and `rail_stop` [m] are the rig's stops. `failsafe` describes the failsafe's first action, at
    `failsafe_at` [s]; "" and None without one. After it the motion includes this action.
    """

    time: Array
    theta: Array
    x: Array
    M: Array
    pitch_stop: float
    rail_stop: float
    failsafe: str
    failsafe_at: float | None

    @property
    def pitch(self) -> float:
        """Largest pitch [rad]."""
        return float(np.abs(self.theta).max())

    @property
    def rail(self) -> float:
        """Largest distance from the rail's middle [m]."""
        return float(np.abs(self.x).max())

    def to_json(self) -> dict[str, Any]:
        """Return plain data at 50 Hz."""
        curves = {"time": self.time, "theta": self.theta, "x": self.x, "M": self.M}
        return {
            **{name: [float(f"{value:.5g}") for value in values[::_EACH]] for name, values in curves.items()},
            "pitch": self.pitch,
            "pitch_stop": self.pitch_stop,
            "rail": self.rail,
            "rail_stop": self.rail_stop,
            "failsafe": self.failsafe,
            "failsafe_at": self.failsafe_at,
        }


def predict(
    excitation: Excitation,
    loop: str,
    rig: str | Mapping[str, float] = "lab",
    thrust: float = HOVER,
    x: float = 0.0,
    rings: bool = False,
    gains: Gains = DEFAULT,
) -> PredictedMotion:
    """Predict the motion when `loop` ("M", "q", "theta", "v", "x") follows `excitation`, from a hover at `x` [m].

    `rig` is "lab", "paper", a file of a rig or of an identified model, or its parameters, as of
    `sim.resimulation.identified_rig`. At `thrust` 0 the rig is at rest before the excitation. `rings` locks the cart.
    Raises ExperimentError for an unknown loop, a wrong unit, a loop that moves a locked cart, a thrust outside 0 to 1,
    and an `x` beyond the rail.
    """
    if loop not in LOOP_MODES:
        raise ExperimentError(f"unknown loop {loop!r:.80}", "loop", f"use one of {', '.join(LOOP_MODES)}")
    mode = LOOP_MODES[loop]
    Experiment("prediction", mode, excitation, rings, thrust)  # refuses what cannot be flown
    values = dict(rig) if isinstance(rig, Mapping) else load_rig_or_model(rig)
    begin = round(BEFORE_S / PERIOD) + (0 if thrust > 0.0 else ARMING)
    lasts = min(excitation.duration, LONGEST_S) + AFTER_S
    steps = begin + round(lasts / PERIOD)
    closed = ClosedLoop(gains, conditions=values | {"rings": rings, "ring_place": x}, failsafe=True)
    closed.start(InitialState(x=x, hover=thrust > 0.0))
    since: Array = (np.arange(steps, dtype=np.float64) - begin) * np.float64(PERIOD)
    setpoints = {
        "mode": np.where(np.arange(steps) < begin, _before(thrust, rings), MODES.index(mode)).astype(np.int32),
        "thrust": thrust,
        "use_trim": mode == "open-loop" and thrust > 0.0,
        "x0": np.full(steps, x),
    }
    name = SETPOINT[mode]
    base = x if name == "x0" else 0.0
    out = closed.fly(
        steps, setpoints | {name: base + np.where(since >= 0.0, excitation.at(np.maximum(since, 0.0)), 0.0)}
    )
    said, at = _failsafe(np.asarray(out["action"]), np.asarray(out["reason"]), since, begin)
    return PredictedMotion(
        since[begin:],
        np.asarray(out["true_theta"][begin:], dtype=np.float64),
        np.asarray(out["true_x"][begin:], dtype=np.float64),
        np.asarray(out["M"][begin:], dtype=np.float64),
        float(closed.machine.get("rig.pitch_stop")),
        float(closed.machine.get("rig.rail_stop")),
        said,
        at,
    )


def predicted(
    excitation: Mapping[str, Any],
    loop: str,
    rig: str,
    thrust: float,
    x: float,
    rings: bool,
    gains: Gains,
    model: tuple[str, Mapping[str, Any]] | None = None,
) -> dict[str, Any]:
    """Return the plain data of `predict` and the predictor's name, from an excitation's `to_dict`.

    `model` is the name and the JSON document of an identified model, whose values replace those of the rig.
    """
    given: str | Mapping[str, float] = rig
    by = f"the virtual rig '{rig}'"
    estimates = None if model is None else estimates_in(model[1])
    if model is not None and estimates is not None:
        given, by = identified_rig(estimates, rig), f"the identified model '{model[0]}'"
    motion = predict(from_dict(excitation), loop, given, thrust, x, rings, gains)
    return {**motion.to_json(), "by": f"{by} with the gains that fly"}


def _before(thrust: float, rings: bool) -> int:
    if thrust == 0.0:
        return OFF
    return MODES.index("attitude" if rings else "position")


def _failsafe(
    action: NDArray[np.int32], reason: NDArray[np.int32], since: Array, begin: int
) -> tuple[str, float | None]:
    """Describe the failsafe's first action from the excitation's start on; return its time [s] too."""
    acts = np.flatnonzero(action[begin:] != NONE)
    if not acts.size:
        return "", None
    step = begin + int(acts[0])
    causes = [cause.text for place, cause in enumerate(CAUSES) if int(reason[step]) & 1 << place]
    return f"{ACTIONS[int(action[step])]}: {'; '.join(causes) or 'no cause given'}", float(since[step])
