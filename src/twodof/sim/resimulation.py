"""Like: a logged flight flown again in simulation, noise-free and in closed loop, and how well it fits."""

import json
from collections.abc import Mapping
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
from twodof.rig.steady_state import model_parameters, moment_gain, rail_force, trim_moment, velocity_gain
from twodof.signals import GRAVITY, HOVER, PERIOD, Q_AGE
from twodof.sim.closed_loop import FLIGHT, ClosedLoop, InitialState
from twodof.sim.drone_estimator import HISTORY, settled
from twodof.sim.flight_segment import FlightSegment, logged, read_segment

MODEL = ("w_n", "xi", "mu", "tau", "k_v", "p_v")
"""What of a model is taken over, SI units; `lag` [s] too, the part of tau that is the rotors' lag."""

_USED = (*MODEL, "lag")
MAX_BYTES = 1 << 20


def identified_rig(model: Mapping[str, float], base: str | Mapping[str, float] = "paper") -> dict[str, float]:
    """Parameters of the rig that behaves as `model` in hover; what the model does not say stays as in `base`.

    The rig then has the model's figures: `rig.steady_state.model_parameters` gives them back. Names other than `MODEL`
    and "lag" are not looked at. Raises ParameterError for a model without any of them, and for one that is not a
    finite number or that no rig has.
    """
    given = {name: float(model[name]) for name in _USED if name in model}
    if not given.keys() & set(MODEL):
        raise ParameterError(
            f"the model says none of {', '.join(MODEL)}, but {listed(model)}", "rig", "identify pitch-rate or velocity"
        )
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
    rig["spring"] = wanted["w_n"] ** 2 * inertia - GRAVITY * rig["mass_drone"] * rig["offset"]
    damping = 2.0 * wanted["w_n"] * inertia
    if "xi" in given:
        rig["viscous_idle"] = rig["viscous_run"] = given["xi"] * damping
    if "tau" in given:
        rig["lag"] = given.get("lag", rig["lag"])
        rig["delay"] = given["tau"] + Q_AGE - rig["lag"]
    _check(rig, given)
    return rig


def load_rig_or_model(source: str | Path) -> dict[str, float]:
    """Parameters of the rig called `source` ("lab", "paper"), of a rig's JSON file, or of an identified model's.

    A model's file is what `twodof identify --json` prints, an `Estimate.to_json()`, or {"mu": 358.5, ...}. Raises
    ParameterError for a file that is neither, and as `identified_rig`.
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
    """Return the values in a fit's JSON, held ones too, or in {"mu": 358.5, ...}; None for anything else."""
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
            f"no rig has {said}: {'; '.join(faults)}", "identified_rig", "identify it again, or fix what is not known"
        )


CHANNELS = ("theta", "q", "x", "v")
"""Logged estimates that are compared; of a 1DoF log, those that it holds."""

_FILTER = f"{FLIGHT}estimator.filter"


@dataclass(frozen=True)
class ResimulationFit:
    """How a simulated flight compares with the logged one.

    `fit` by channel, 100 (1 - |y - y_sim| / |y - mean(y)|) [%]; `time[name]`, `logged[name]`, `simulated[name]` (n,) at
    the logged stamps; `windows` [s]. In 1DoF (rings) x and v stand still and their FIT says nothing; where a 1DoF log
    lacks them they are left out.
    """

    fit: Mapping[str, float]
    time: Mapping[str, NDArray[np.float64]]
    logged: Mapping[str, NDArray[np.float64]]
    simulated: Mapping[str, NDArray[np.float64]]
    windows: tuple[tuple[float, float], ...]
    flight: FlightSegment

    def to_json(self) -> dict[str, Any]:
        """`{"fit_percent": {"theta": ..., ...}, "windows_s": [[t0, t1]]}`."""
        return {
            "fit_percent": {name: float(value) for name, value in self.fit.items()},
            "windows_s": [[float(a), float(b)] for a, b in self.windows],
        }


def fit_percent(logged: NDArray[np.float64], simulated: NDArray[np.float64]) -> float:
    """100 (1 - |y - y_sim| / |y - mean(y)|) [%]; NaN for a constant y."""
    spread = float(np.linalg.norm(logged - logged.mean()))
    return 100.0 * (1.0 - float(np.linalg.norm(logged - simulated)) / spread) if spread > 0.0 else float("nan")


def resimulation_loop() -> ClosedLoop:
    """Return the compiled loop of `LoggedFlight.simulate`; it serves any number of flights, rigs and gains.

    Its estimator is the drone's own (`sim.drone_estimator`), but it does not learn the gyro's bias: an error lasts for
    a flight. In the log where it shows, the gyro drifts as fast as its bias is learnt.
    """
    # The filter's outputs at each step; the published ones are held at 100 Hz.
    log = (f"{_FILTER}.x", f"{_FILTER}.v")
    tuning = {"estimator.filter.k_bias": 0.0}
    return ClosedLoop(conditions={"noise": 0.0}, position_filter="drone", tuning=tuning, log=log)


class LoggedFlight:
    """A window of a log, read once and simulated as often as wanted.

    `gains` are those it was flown with, `window` [s] as in `twodof.sim.flight_segment.read_segment`.
    It raises the errors of that function.
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
        """Return the simulated estimates at the logged stamps, by channel, for rig parameters `rig`.

        `conditions` are further conditions of the flight, such as `charge_start`, or `noise` and `seed`; left out: a
        full battery and no noise. Raises ParameterError for one that the rig does not know.
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
        """Simulate as `simulate` does, and compare with the log."""
        simulated = self.simulate(loop, rig, conditions)
        fit = {name: fit_percent(self.logged[name], values) for name, values in simulated.items()}
        return ResimulationFit(fit, self.time, self.logged, simulated, (self.flown.window,), self.flown)


def resimulate(
    log: FlightLog,
    rig: ParameterSet | None = None,
    gains: Gains = DEFAULT,
    window: tuple[float, float] | None = None,
) -> ResimulationFit:
    """Flies the logged set-points in closed loop on the noise-free `rig` (None: `lab`) from the logged initial state.

    The mode is found from the log. The trim moment, the tilt of the rail and the velocity bias are those of the flight
    before the window; the battery is full. A step of the simulation stands for a control step of the log, whose clock
    runs up to .15 % slow; estimates are compared at the logged stamps. Raises LogError for a log that lacks a channel,
    steps or flight in the window.
    """
    values = (lab() if rig is None else rig).snapshot()
    return LoggedFlight(log, gains, window).compare(resimulation_loop(), values)
