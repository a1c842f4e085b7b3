"""ExpectedAccuracy: before a flight, how well it will tell the unknowns, and how far it will move the drone."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, LogError
from twodof.experiment.experiments import Experiment
from twodof.experiment.flight import Laboratory, flight_log, ready
from twodof.experiment.script import script
from twodof.identify.experiments import KINDS, cut, kind_of
from twodof.identify.from_flight.ready_made import FLOWN_AS, SWING, TRAVEL, structure_for
from twodof.identify.from_flight.sufficiency import LEVEL, PURPOSE, TOLD
from twodof.identify.information import Information, predict
from twodof.identify.record import Record
from twodof.identify.validate import deviations
from twodof.signals import PERIOD

Array = NDArray[np.float64]

NOISE: Mapping[str, float] = {"q": 0.02, "x": 0.004}
"""What a sample is taken to scatter by where no model says so: gyro with vibration [rad/s], range sensor [m]."""

MOST_POINTS = 4000

_SUM = "tau"
"""Of dead time and lag: with the lag held, what the dead time is known to is what the sum is known to."""


@dataclass(frozen=True, eq=False)
class ExpectedAccuracy:
    """`information` is the Cramer-Rao bound; `motion` what the drone will do on the virtual rig, without noise.

    `motion` has `time` [s], `theta` [rad] and `x` [m] from the excitation's start on; `pitch` and `rail` are the shares
    of the pitch stop and of the rail that it uses. `remark` says why there is no information, "" if there is.
    """

    experiment: Experiment
    kind: str
    x_start: float
    information: Information | None
    remark: str
    motion: Mapping[str, Array]
    pitch: float
    rail: float

    def to_json(self) -> dict[str, Any]:
        """Plain data: of each unknown the value assumed, the standard deviation, and whether that is enough."""
        found, rows = self.information, []
        wanted = PURPOSE.get(self.kind, ())
        for i, label in enumerate(found.labels if found is not None else ()):
            assert found is not None
            value, sigma = float(found.values[i]), float(found.sigma[i])
            share = deviations(LEVEL) * sigma / abs(value) if value else math.inf
            rows.append(
                {
                    "name": label,
                    "unit": found.units[i],
                    "value": value,
                    "sigma": sigma,
                    "share": share if math.isfinite(share) else None,
                    "wanted": (_SUM if label == "dead_time" else label) in wanted,
                    "enough": share <= TOLD,
                }
            )
        return {
            "experiment": self.experiment.name,
            "kind": self.kind,
            "duration": self.experiment.duration,
            "x_start": self.x_start,
            "unknowns": rows,
            "condition_number": None if found is None else found.condition_number,
            "remark": self.remark,
            "motion": {name: [float(f"{v:.5g}") for v in values] for name, values in self.motion.items()},
            "pitch_share": self.pitch,
            "rail_share": self.rail,
        }


def expected_accuracy(
    experiment: str | Experiment,
    laboratory: Laboratory,
    values: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
) -> ExpectedAccuracy:
    """Plan a flight: it is flown on the virtual rig without noise, and what that tells is the Fisher information.

    `values` are what the unknowns are thought to be (default: the structure's guesses), `noise` the standard deviation
    of a sample of each output (default: `NOISE`). What gusts take from the accuracy is not in it. Raises
    ExperimentError for an excitation that meets a stop or does not fit the rail.
    """
    one = ready(experiment)
    x_start = laboratory.start(one)
    plan = script(one, x_start)
    out = laboratory.signals(one, plan, x_start)
    theta, x = (out[name][plan.begin : plan.end] for name in ("true_theta", "true_x"))
    step = max(1, -(-len(theta) // MOST_POINTS))
    motion = {"time": PERIOD * np.arange(len(theta))[::step], "theta": theta[::step], "x": x[::step]}
    stops = laboratory.parameters
    pitch = float(np.abs(theta).max()) / stops["pitch_stop"]
    rail = 0.0 if one.rings else float(np.abs(x).max()) / stops["rail_stop"]
    log = flight_log(out, np.asarray(plan.setpoints["mode"], dtype=np.int32), {})
    kind, remark, found = "", "", None
    try:
        kind = FLOWN_AS.get(one.name, one.name)
        if kind not in KINDS:
            kind = kind_of(log).name
        found = _information(cut(log, kind), kind, dict(values or {}), {**NOISE, **(noise or {})})
    except (IdentificationError, LogError) as reason:
        remark = f"what it tells is not known before: {reason.what}"
    return ExpectedAccuracy(one, kind, x_start, found, remark, motion, pitch, rail)


def _information(record: Record, kind: str, values: dict[str, float], noise: Mapping[str, float]) -> Information:
    structure = structure_for(kind)
    output = "x" if kind == "velocity" else "q"
    known = {name: value for name, value in values.items() if name in structure.unknowns}
    wanted: tuple[str, ...]
    if kind == "velocity":
        wanted = TRAVEL
    elif kind == "doublet":
        wanted = tuple(name for name in structure.estimate if name not in SWING)
    else:
        wanted = structure.estimate
    # Dead time and lag have nearly one effect, and the sum of the two is what is asked for: the lag is held.
    wanted = tuple(name for name in wanted if name != "lag")
    inputs = {name: record.inputs[name] for name in structure.inputs}
    return predict(structure, inputs, record.dt, {output: noise[output]}, values=known, estimate=wanted)
