"""Expected accuracy of an experiment before it is flown, and how far it will move the drone."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, LogError
from twodof.experiment.experiments import Experiment, script
from twodof.experiment.flight import Laboratory, flight_log, ready
from twodof.identify.disturbance.autoregression import Autoregression, from_covariance
from twodof.identify.disturbance.disturbance_model import DisturbanceModel
from twodof.identify.experiments import KINDS, cut, free_swing, kind_of
from twodof.identify.information import Information, predict
from twodof.identify.ready_made import (
    ENOUGH_SHARE,
    FLOWN_AS,
    LEVEL,
    PURPOSE,
    SWING,
    SWUNG,
    TRAVEL,
    FlownMachine,
    known_cart,
    priors_of,
    structure_for,
    true_values,
)
from twodof.identify.record import Record
from twodof.identify.validate import deviations
from twodof.models.structure import Structure
from twodof.rig.rotors import lift
from twodof.signals import HOVER, PERIOD, Q_AGE

Array = NDArray[np.float64]

_ORDER = 40
"""Order of the autoregression of q's noise, as in a fit: .16 s, which covers a gust's correlation time."""
_RESPONSE = 1 << 12
_VIBRATION = 400


def gyro_covariance(rig: Mapping[str, float], steps: int, dt: float, load: float = 1.0) -> Array:
    """Return the autocovariance (steps,) of the gyro: white noise, rounding, and vibration.

    The rotors' lines count as white noise. They are narrow in hover, but move with M, and an excitation moves it.
    """
    radius, turn = rig["vibration_r2"], (1.0 + rig["vibration_r2"]) * np.cos(2.0 * np.pi * rig["vibration_hz"] * dt)
    pulse = np.sqrt(0.5 * (1.0 - radius))
    driven = {0: pulse, 2: -pulse}
    band, before, last = np.zeros(_VIBRATION + 2000), 0.0, 0.0
    for k in range(band.size):  # scipy.signal, which has this as lfilter, takes a second to import
        before, last = last, turn * last - radius * before + driven.get(k, 0.0)
        band[k] = last
    covariance = np.array([band[: band.size - k] @ band[k:] for k in range(min(steps, _VIBRATION))])
    full = np.zeros(steps)
    full[: covariance.size] = (load * rig["gyro_hover"]) ** 2 * covariance
    full[0] += rig["gyro_idle"] ** 2 + rig["gyro_step"] ** 2 / 12.0 + (load * rig["gyro_line"]) ** 2
    return full


def range_variance(rig: Mapping[str, float]) -> float:
    """Return the variance [m^2] of the range sensor's noise and rounding."""
    return rig["tof_noise"] ** 2 + rig["tof_step"] ** 2 / 12.0


def pushed_rate(values: Mapping[str, float], steps: int, dt: float) -> Array:
    """Return the response (steps,) of q to an angular acceleration of 1 in the first step."""
    from scipy.linalg import expm  # imported late: most commands start without it

    a = np.array([[0.0, 1.0], [-(values["w_n"] ** 2), -2.0 * values["xi"] * values["w_n"]]])
    step = expm(dt * np.block([[a, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]))
    response, state = np.zeros(steps), step[:2, 2]
    for k in range(1, steps):
        response[k], state = state[1], step[:2, :2] @ state
    return response


def pitch_noise(rig: Mapping[str, float], values: Mapping[str, float], dt: float, load: float) -> Autoregression:
    """Return the noise of the measured q: gusts through the pitch of `values`, plus the gyro's own."""
    keep = np.exp(-dt / rig["gust_time"])
    turn = 2.0 * np.pi * np.arange(_RESPONSE + 1) / (2 * _RESPONSE)
    gust = (1.0 - keep**2) / (1.0 - 2.0 * keep * np.cos(turn) + keep**2)
    power = np.abs(np.fft.rfft(pushed_rate(values, _RESPONSE, dt), 2 * _RESPONSE)) ** 2
    pushed = np.fft.irfft(power * gust, 2 * _RESPONSE)[: _ORDER + 1]
    moment = load * rig["gust"] / rig["inertia"]
    return from_covariance(moment**2 * pushed + gyro_covariance(rig, _ORDER + 1, dt, load))


def rail_covariance(
    rig: Mapping[str, float], values: Mapping[str, float], position: Array, steps: int, dt: float, load: float = 1.0
) -> Array:
    """Return the covariance of the range samples' errors, (m, m), about the motion predicted from the measured q.

    `position` (m,) are their times in steps. The integral of the gyro's noise is an error of the pitch, which the cart
    follows; the range sensor adds its own noise.
    """
    from scipy.linalg import matmul_toeplitz  # imported late: most commands start without it

    k_v, p_v = values["k_v"], values["p_v"]
    # An error of one sample offsets the pitch by `dt` for good: v' = -k_v dt - p_v v.
    late = np.maximum(dt * np.arange(steps) - values["tau"], 0.0)
    moved = -k_v * dt * (late / p_v + np.expm1(-p_v * late) / p_v**2)
    age = position[:, None] - np.arange(steps)[None, :]
    spread = np.where(age > 0.0, np.interp(age, np.arange(steps), moved), 0.0)
    covariance = spread @ matmul_toeplitz(gyro_covariance(rig, steps, dt, load), spread.T)
    return np.asarray(covariance + range_variance(rig) * np.eye(position.size))


MOST_POINTS = 4000

_SUM = "tau"
"""Sum of dead time and lag. With the lag held, its standard deviation is the dead time's."""


@dataclass(frozen=True, eq=False)
class ExpectedAccuracy:
    """Cramer-Rao bound of a planned flight (`information`), and its `motion` on the virtual rig without noise.

    `motion` has `time` [s], `theta` [rad] and `x` [m] from the excitation's start on; `pitch` and `rail` are the shares
    of the pitch stop and of the rail that it uses. `remark` says why the information is missing, else "". `worse`
    is the ratio of the wanted standard deviations to those with white sensor noise alone.
    """

    experiment: Experiment
    kind: str
    x_start: float
    information: Information | None
    remark: str
    motion: Mapping[str, Array]
    pitch: float
    rail: float
    worse: float = 1.0

    def to_json(self) -> dict[str, Any]:
        """Return plain data: for each unknown the assumed value, the standard deviation, and if it is small enough."""
        found, rows = self.information, []
        wanted = PURPOSE.get(self.kind, ())
        for label, unit, value, sigma in () if found is None else _rows(found):
            share = deviations(LEVEL) * sigma / abs(value) if value else math.inf
            alone = found is not None and "lag" not in found.labels
            rows.append(
                {
                    "name": label,
                    "unit": unit,
                    "value": value,
                    "sigma": sigma,
                    "share": share if math.isfinite(share) else None,
                    "wanted": (_wanted_as(label) if alone else label) in wanted,
                    "enough": share <= ENOUGH_SHARE,
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
            "worse": self.worse,
        }


def expected_accuracy(
    experiment: str | Experiment,
    laboratory: Laboratory,
    values: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
) -> ExpectedAccuracy:
    """Return the expected accuracy of a flight: the Fisher information of a flight on the virtual rig without noise.

    `values` are the assumed values of the unknowns (default: those of the laboratory's rig). `noise` is the standard
    deviation of a sample of each output, as white noise; by default the noise is the rig's own, with gusts and
    vibration (`gyro_covariance`). Raises ExperimentError for an excitation that meets a stop or does not fit the rail.
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
    kind, remark, found, worse = "", "", None, 1.0
    try:
        kind = FLOWN_AS.get(one.name, one.name)
        if kind not in KINDS:
            kind = kind_of(log).name
        structure, record, first = structure_for(kind), cut(log, kind), dict[str, float]()
        if kind == "impulse":
            record, first = free_swing(record)
        before = priors_of(stops, structure) if kind == "attitude" else {}
        own = {"dead_time": stops["delay"] - Q_AGE, "lag": stops["lag"]}
        own |= known_cart(stops, structure, free=not one.rings)
        own |= true_values(stops, kind, log, record.start, float(record.time[-1])) | first
        if kind == "velocity":
            own["coulomb"] = 0.0  # dry friction holds the cart at the start, where no speed can be told
        # A rig may be beyond the structure's bounds: `paper` has no lag.
        bounds = {name: (row.lower, row.upper) for name, row in structure.unknowns.items() if name in own}
        known = {name: min(max(own[name], low), high) for name, (low, high) in bounds.items()} | dict(values or {})
        planned = _Plan(record, kind, known, before, free=not one.rings)
        # Gusts and vibration grow with the thrust, here over that of hover.
        load = float(lift(one.thrust, stops["curve"]) / lift(HOVER, stops["curve"]))
        found, worse = planned.information(stops, load, noise)
    except (IdentificationError, LogError) as reason:
        remark = f"the expected accuracy is unknown: {reason.what}"
    return ExpectedAccuracy(one, kind, x_start, found, remark, motion, pitch, rail, worse)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Record that will be fitted, its `kind` of identification, and prior knowledge of the unknowns."""

    record: Record
    kind: str
    values: dict[str, float]
    before: Mapping[str, tuple[float, float]]
    free: bool

    def information(
        self, rig: Mapping[str, float], load: float, noise: Mapping[str, float] | None
    ) -> tuple[Information, float]:
        """Return the information with white `noise`, else with the rig's own, and its ratio to that of white noise."""
        structure, record = structure_for(self.kind), self.record
        if noise is not None:
            return self._predicted(structure, noise), 1.0
        known = {name: row.value for name, row in structure.unknowns.items()} | self.values
        if self.kind == "velocity":
            white = self._predicted(structure, {"x": math.sqrt(range_variance(rig))})
            position = record.outputs["x"].position
            covariance = rail_covariance(rig, known, position, record.steps, record.dt, load)
            found = self._predicted(structure, {"x": 1.0}, covariance={"x": covariance})
        else:
            white = self._predicted(structure, {"q": math.sqrt(gyro_covariance(rig, 1, record.dt, load)[0])})
            model = DisturbanceModel("ar", {"q": pitch_noise(rig, known, record.dt, load)}, dt=record.dt)
            found = self._predicted(structure, {"q": 1.0}, disturbance=model)
        # Vibration in a band leaves the residual almost white: a fit then does not model its colour.
        found = max(found, white, key=lambda one: float(one.sigma @ (1.0 / white.sigma)))
        wanted = [k for k, label in enumerate(found.labels) if _wanted_as(label) in PURPOSE.get(self.kind, ())]
        return found, float(max((found.sigma[k] / white.sigma[k] for k in wanted), default=1.0))

    def _predicted(self, structure: Structure, noise: Mapping[str, float], **of_noise: Any) -> Information:
        wanted: tuple[str, ...]
        if self.kind == "velocity":
            wanted = TRAVEL
        elif self.kind == "attitude":
            # A controller hides the poles and the friction: they have priors. A virtual rig has no bend.
            wanted = FlownMachine(free=self.free, virtual=True).estimate(structure)
            of_noise["prior"] = {name: one for name, one in self.before.items() if name in wanted}
        elif self.kind == "doublet":
            wanted = tuple(name for name in structure.estimate if name not in SWING)
        else:
            wanted = tuple(name for name in SWUNG if name != "coulomb" or self.values[name] > 0.0)
        # In a short flight dead time and lag have nearly the same effect, and their sum is wanted: the lag is held.
        # A closed loop separates them.
        wanted = wanted if self.kind == "attitude" else tuple(name for name in wanted if name != "lag")
        values = {name: value for name, value in self.values.items() if name in structure.unknowns}
        inputs = {name: self.record.inputs[name] for name in structure.inputs}
        sampled = {name: self.record.outputs[name].position for name in noise}
        noise = {name: noise[name] for name in sampled}
        return predict(
            structure, inputs, self.record.dt, noise, values=values, estimate=wanted, sampled=sampled, **of_noise
        )


def _rows(found: Information) -> Iterator[tuple[str, str, float, float]]:
    """Yield name, unit, value and standard deviation of each unknown, and of dead time plus lag if both are free."""
    for i, label in enumerate(found.labels):
        yield label, found.units[i], float(found.values[i]), float(found.sigma[i])
    parts = [found.labels.index(name) for name in ("dead_time", "lag") if name in found.labels]
    if len(parts) == 2:
        spread = np.linalg.inv(found.matrix)[np.ix_(parts, parts)]
        yield _SUM, found.units[parts[0]], float(found.values[parts].sum()), math.sqrt(float(spread.sum()))


def _wanted_as(label: str) -> str:
    """Return the label under which an unknown is wanted: with the lag held, the dead time stands for `tau`."""
    return _SUM if label == "dead_time" else label
