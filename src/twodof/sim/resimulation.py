"""Resimulation: a logged flight is simulated again, without noise and in closed loop, and compared with the log."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, ParameterError, listed
from twodof.flight.gains import DEFAULT, Gains
from twodof.flightlog.log import FlightLog
from twodof.flightlog.provenance import read_bytes
from twodof.parameters import ParameterSet
from twodof.rig.parameters import lab, load_rig
from twodof.rig.rig import model_parameters, moment_gain, rail_force, trim_moment, velocity_gain
from twodof.signals import GRAVITY, HOVER, PERIOD, Q_AGE
from twodof.sim.closed_loop import FLIGHT, ClosedLoop, InitialState
from twodof.sim.drone_estimator import HISTORY, settled
from twodof.sim.flight_segment import FlightSegment, logged, read_segment

MODEL = ("w_n", "xi", "mu", "tau", "k_v", "p_v")
"""Parameters that an identified model may set, in SI units, besides `lag` [s], the part of tau due to the rotors."""

_USED = (*MODEL, "lag")
MAX_BYTES = 1 << 20


def identified_rig(model: Mapping[str, float], base: str | Mapping[str, float] = "paper") -> dict[str, float]:
    """Return the parameters of a rig that behaves as `model` in hover, with everything else as in the rig `base`.

    `rig.rig.model_parameters` of the result gives the model's values. Names other than `MODEL` and "lag" are
    ignored. Raises ParameterError for a model without any name of `MODEL`, and for a value that is not finite or not
    possible for a rig.
    """
    given = {name: float(model[name]) for name in _USED if name in model}
    if not given.keys() & set(MODEL):
        what = f"a rig needs one of {', '.join(MODEL)}, and the model has only {listed(model)}"
        raise ParameterError(what, "rig", "identify with --model pitch-rate or --model velocity")
    values = dict(load_rig(base).snapshot() if isinstance(base, str) else base)
    rig = {name: float(value) for name, value in values.items()}
    wanted = model_parameters(rig) | given
    mass = rig["mass_drone"] + rig["mass_cart"]
    if "k_v" in given:
        rig["pair_thrust"] *= given["k_v"] / velocity_gain(rig)
    if "p_v" in given:
        rig["rail_viscous"] = given["p_v"] * mass
    if given.keys() & {"mu", "k_v"}:
        rig["inertia"] *= moment_gain(rig, HOVER) / wanted["mu"]
    inertia = rig["inertia"]
    # Gravity and the spring make the stiffness. What is softer than by gravity alone has its mass nearer the bearing.
    weight, restoring = GRAVITY * rig["mass_drone"], wanted["w_n"] ** 2 * inertia
    rig["offset"] = min(rig["offset"], restoring / weight)
    rig["spring"] = max(0.0, restoring - weight * rig["offset"])
    damping = 2.0 * wanted["w_n"] * inertia
    if "xi" in given:
        rig["viscous_idle"] = rig["viscous_run"] = given["xi"] * damping
    if "tau" in given:
        rig["lag"] = given.get("lag", rig["lag"])
        rig["delay"] = given["tau"] + Q_AGE - rig["lag"]
    _check(rig, given)
    return rig


def load_rig_or_model(source: str | Path) -> dict[str, float]:
    """Return the parameters of the rig "lab" or "paper", or of the JSON file `source` of a rig or an identified model.

    A model's file holds the output of `twodof identify --json`, an `Estimate.to_json()`, or {"mu": 358.5, ...}. Raises
    ParameterError for another file, and as `identified_rig`.
    """
    if str(source) not in ("lab", "paper"):
        try:
            found = json.loads(read_bytes(source, MAX_BYTES))
        except (LogError, ValueError, RecursionError):
            found = None  # load_rig says what is wrong
        estimates = estimates_in(found)
        if estimates is not None:
            return identified_rig(estimates)
    return {name: float(value) for name, value in load_rig(source).snapshot().items()}


def estimates_in(found: object) -> dict[str, float] | None:
    """Return the values by name in an estimate's JSON, fixed ones too, or in {"mu": 358.5, ...}; else None."""
    if not isinstance(found, dict):
        return None
    rows = found.get("estimates", found)
    if not isinstance(rows, dict) or not rows.keys() & set(MODEL):
        return None
    held = found.get("fixed")
    values = dict(held) if isinstance(held, dict) else {}
    values |= {name: row.get("value") if isinstance(row, dict) else row for name, row in rows.items()}
    return {
        str(name): float(value)
        for name, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def _check(rig: Mapping[str, float], given: Mapping[str, float]) -> None:
    load = load_rig("paper")
    _, faults = load.check(dict(rig))
    if faults:
        said = ", ".join(f"{name} {value:.4g}" for name, value in given.items())
        raise ParameterError(
            f"no rig can have {said}: {'; '.join(faults)}", "identified_rig", "identify it again, or fix known values"
        )


CHANNELS = ("theta", "q", "x", "v")
"""Logged estimates that are compared; x and v of a 1DoF log only if it holds them."""

_FILTER = f"{FLIGHT}estimator.filter"


@dataclass(frozen=True)
class ResimulationFit:
    """Comparison of a simulated flight with the logged one.

    `fit` by channel is 100 (1 - |y - y_sim| / |y - mean(y)|) [%]; `time[name]`, `logged[name]` and `simulated[name]`
    are (n,) at the logged stamps; `windows` [s]. In 1DoF (rings) x and v do not move, so their fit has no meaning; they
    are left out if the log lacks them.
    """

    fit: Mapping[str, float]
    time: Mapping[str, NDArray[np.float64]]
    logged: Mapping[str, NDArray[np.float64]]
    simulated: Mapping[str, NDArray[np.float64]]
    windows: tuple[tuple[float, float], ...]
    flight: FlightSegment

    def to_json(self) -> dict[str, Any]:
        """Return `{"fit_percent": {"theta": ..., ...}, "windows_s": [[t0, t1]]}`."""
        return {
            "fit_percent": {name: float(value) for name, value in self.fit.items()},
            "windows_s": [[float(a), float(b)] for a, b in self.windows],
        }


def fit_percent(logged: NDArray[np.float64], simulated: NDArray[np.float64]) -> float:
    """Return the fit 100 (1 - |y - y_sim| / |y - mean(y)|) [%] of two signals (n,); NaN for a constant logged y."""
    spread = float(np.linalg.norm(logged - logged.mean()))
    return 100.0 * (1.0 - float(np.linalg.norm(logged - simulated)) / spread) if spread > 0.0 else float("nan")


def resimulation_loop() -> ClosedLoop:
    """Return the compiled loop for `LoggedFlight.simulate`, for any number of flights, rigs and gains.

    Its estimator is the real drone's (`sim.drone_estimator`), but with a constant gyro bias. On the one log where the
    difference is visible, the gyro drifts as fast as the drone's estimator learns its bias.
    """
    # The filter's outputs at each step; the published ones are held at 100 Hz.
    log = (f"{_FILTER}.x", f"{_FILTER}.v")
    tuning = {"estimator.filter.k_bias": 0.0}
    return ClosedLoop(conditions={"noise": 0.0}, position_filter="drone", tuning=tuning, log=log)


class LoggedFlight:
    """A window of a log, read once and simulated any number of times.

    `gains` are those with which it was flown; `window` [s] as in `twodof.sim.flight_segment.read_segment`, whose errors
    it raises.
    """

    def __init__(self, log: FlightLog, gains: Gains = DEFAULT, window: tuple[float, float] | None = None) -> None:
        self.gains = gains
        self.flown = read_segment(log, gains, window)
        t0, t1 = self.flown.window
        self.before = self._estimates_before(log)
        end = min(t1, float(self.flown.time[-1]))
        needed = CHANNELS if self.flown.rails else ("theta", "q")
        cut = {name: log[name].slice(t0, end) for name in CHANNELS if name in needed or logged(log, name)}
        self.time = {name: channel.time for name, channel in cut.items()}
        self.logged = {name: channel.value for name, channel in cut.items()}

    def _estimates_before(self, log: FlightLog) -> dict[str, NDArray[np.float64]]:
        """Return theta, x and v at the steps before the window. A cart in its rings stands still: v is then 0."""
        time = float(self.flown.time[0]) + PERIOD * np.arange(-HISTORY, 0)

        def at(name: str) -> NDArray[np.float64]:
            return np.asarray(np.interp(time, log[name].time, log[name].value))

        if self.flown.rails:
            return {name: at(name) for name in ("theta", "x", "v")}
        return {"theta": at("theta"), "x": np.full(HISTORY, self.flown.start["x"]), "v": np.zeros(HISTORY)}

    def simulate(
        self, loop: ClosedLoop, rig: Mapping[str, float], conditions: Mapping[str, Any] | None = None
    ) -> dict[str, NDArray[np.float64]]:
        """Return the simulated estimates at the logged stamps, by channel, for the rig parameters `rig`.

        `conditions` are further conditions of the flight, such as `charge_start`, `noise` and `seed`; by default the
        battery is full and the sensors have no noise. Raises ParameterError for one that is not a parameter of the rig.
        """
        flight = self.flown
        start, bias = flight.start, flight.velocity_bias
        own = settled(**self.before, velocity_bias=bias, range_rate=rig["tof_rate"])
        loop.tune(self.gains)
        loop.configure({**rig, **self._conditions(rig, own.theta), **(conditions or {})})
        loop.start(
            InitialState(
                theta=(start["theta"] - own.theta) / rig["gyro_scale"],
                q=start["q"] / rig["gyro_scale"],
                x=start["x"] - own.x,
                v=start["v"] - bias if flight.rails else 0.0,
                estimates={name: start[name] for name in ("theta", "x", "v")},
                commands=flight.commands,
                wake=1.0 - float(np.exp(-flight.spun_up / rig["wake_lag"])),
                polarised=_polarised(flight.runs, rig["polarised_time"]),
                states={
                    "flight.previous.theta": start["theta_previous"],
                    **{f"flight.cascade.{path}": value for path, value in flight.states.items()},
                    **{f"{_FILTER}.{name}": value for name, value in own.states.items()},
                },
            )
        )
        out = loop.fly(len(flight.time), {"mode": flight.mode, **flight.setpoint})
        steps = {"theta": out["theta"], "q": out["q"], "x": out[f"{_FILTER}.x"], "v": out[f"{_FILTER}.v"]}
        return {name: np.interp(self.time[name], flight.time, steps[name]) for name in self.time}

    def _conditions(self, rig: Mapping[str, float], tilt: float) -> dict[str, Any]:
        """Return the conditions of a flight whose estimated pitch is `tilt` [rad] too large."""
        flight = self.flown
        pitch, *motion = flight.balance
        trim = 0.0 if flight.trim_moment is None else trim_moment(rig, flight.trim_moment, flight.trim_theta - tilt)
        return {
            "noise": 0.0,
            "charge_start": 1.0,
            "rings": not flight.rails,
            "ring_place": flight.start["x"],
            "rail_force": rail_force(rig, pitch - tilt, *motion),
            "trim": trim,
            "tof_phase": (flight.tof_elapsed * rig["tof_rate"]) % 1.0,
        }

    def compare(
        self, loop: ClosedLoop, rig: Mapping[str, float], conditions: Mapping[str, Any] | None = None
    ) -> ResimulationFit:
        """Simulate the flight as `simulate` does, and return the comparison with the log."""
        simulated = self.simulate(loop, rig, conditions)
        fit = {name: fit_percent(self.logged[name], values) for name, values in simulated.items()}
        return ResimulationFit(fit, self.time, self.logged, simulated, (self.flown.window,), self.flown)


def _polarised(runs: Sequence[tuple[float, float]], time: float) -> float:
    """Return the share of a hover's polarisation that stands after hovers in `runs` (from, to) [s] ago."""
    return float(sum(np.exp(-to / time) - np.exp(-begun / time) for begun, to in runs))


def resimulate(
    log: FlightLog, rig: ParameterSet | None = None, gains: Gains = DEFAULT, window: tuple[float, float] | None = None
) -> ResimulationFit:
    """Fly the logged set-points in closed loop on the noise-free `rig` (None: `lab`) from the logged initial state.

    The modes are those of the log. The trim moment, the tilt of the rail and the velocity bias are found from the
    flight before the window; the battery is full. Each simulated step corresponds to a control step of the log, whose
    clock runs up to .15 % slow; estimates are compared at the logged stamps. Raises LogError for a log without a needed
    channel, or a window without steps or flight.
    """
    values = (lab() if rig is None else rig).snapshot()
    return LoggedFlight(log, gains, window).compare(resimulation_loop(), values)
