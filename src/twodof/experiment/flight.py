"""Flying an experiment on the virtual rig: a start that fits, the flight, and the checks of its data."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.blocks import Diagram
from twodof.blocks.noise import SEEDS
from twodof.blocks.schema.json_form import to_json
from twodof.errors import ExperimentError, ParameterError, is_number
from twodof.experiment.experiments import EXPERIMENTS, SETPOINT, Experiment, Script, script
from twodof.experiment.experiments import experiment as named_experiment
from twodof.flight.core import OUTPUTS
from twodof.flight.gains import DEFAULT, Gains, load_gains
from twodof.flight.starters import load_diagram
from twodof.flight.templates import by_kind
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.provenance import versions
from twodof.flightlog.steps import TRUTH, safety_channel, step_channels, truth_channels
from twodof.parameters import TUNABLES, ParameterSet
from twodof.rig.parameters import load_rig
from twodof.rig.rig import MEASUREMENTS
from twodof.signals import BY_MAT, MODES, PERIOD, TOPICS
from twodof.sim.closed_loop import ClosedLoop, InitialState
from twodof.sim.time_alignment import runs

Signals = Mapping[str, NDArray[Any]]
"""Signals at the control steps of a flight, (steps,) by name; NaN marks a lost sample."""

STOP_MARGIN = 1e-3
"""Distance to a stop [m, rad] that counts as contact: the rig is pressed into a stop by less."""

MOST_LOST = 0.01
"""Largest share of lost samples: the real drone's public logs lack up to .2 % of them and identify well."""

LONGEST_GAP = 0.04
"""Longest gap of samples [s] from the excitation's start on: two periods of the course's 50 Hz messages."""

_EXCITED = {"M_open": "q", "q0": "q", "theta0": "theta", "v0": "v", "x0": "x"}


_SPEED = {"theta": "q", "x": "v"}


@dataclass(frozen=True)
class FlightCheck:
    """Result of one check, with the measured figure `seen`, in words."""

    name: str
    passed: bool
    seen: str


def data_checks(experiment: Experiment, plan: Script, out: Signals, stops: Mapping[str, float]) -> list[FlightCheck]:
    """Check that no stop was touched, and that the response exceeds five standard deviations of the signal before it.

    `stops` holds `pitch_stop` [rad] and `rail_stop` [m]. Pitch and position are the true ones if `out` has them, which
    the check's `seen` tells. The response is that of the estimates, from which models are identified.
    """
    flown = slice(plan.begin, plan.end)
    steepest, by = _farthest(out, "theta", flown)
    swing = f"|theta| up to {np.degrees(steepest):.1f} deg, {by}; stop at {np.degrees(stops['pitch_stop']):.1f} deg"
    checks = [
        FlightCheck("clear of the pitch stop", steepest < stops["pitch_stop"] - STOP_MARGIN, swing),
        _excited(experiment, plan, out),
    ]
    if not experiment.rings:
        farthest, by = _farthest(out, "x", flown)
        way = f"|x| up to {farthest:.3f} m, {by}; stop at {stops['rail_stop']:.3f} m"
        checks.append(FlightCheck("clear of the rail stop", farthest < stops["rail_stop"] - STOP_MARGIN, way))
    return checks


def _farthest(out: Signals, name: str, flown: slice) -> tuple[float, str]:
    """Return the largest magnitude of a signal, and whether it is of the true or the estimated one.

    Each sample is extrapolated to the next one with its own speed. Otherwise a fast swing could bounce off a stop
    between two samples, and the samples would stay up to .01 rad away from it.
    """
    estimate, true = _reached(out, name, "", flown), out.get(f"true_{name}")
    if true is None:
        return _largest(estimate), "estimated values"
    known = np.isfinite(true[flown])
    unknown = int((~known).sum())
    by = f"true values except in {unknown} of {len(known)} steps" if unknown else "true values"
    return _largest(np.where(known, _reached(out, name, "true_", flown), estimate)), by


def _reached(out: Signals, name: str, source: str, flown: slice) -> NDArray[Any]:
    """Return the larger magnitude of each sample and of its extrapolation to the next one."""
    place, speed = out[f"{source}{name}"][flown], out[f"{source}{_SPEED[name]}"][flown]
    return np.where(np.isfinite(speed), np.maximum(np.abs(place), np.abs(place + PERIOD * speed)), np.abs(place))


def _largest(values: NDArray[Any]) -> float:
    """Return the largest magnitude; NaN, which passes no check, without any sample."""
    known = values[np.isfinite(values)]
    return float(np.abs(known).max()) if known.size else float("nan")


def _excited(experiment: Experiment, plan: Script, out: Signals) -> FlightCheck:
    name = _EXCITED[SETPOINT[experiment.mode]]
    before = out[name][max(0, plan.begin - 250) : plan.begin]
    before = before[np.isfinite(before)]
    if not before.size:
        return FlightCheck("excited", False, f"no sample of {name} before the excitation")
    largest = _largest(out[name][plan.begin : plan.end] - before.mean())
    return FlightCheck(
        "excited",
        largest > 5.0 * float(before.std()),
        f"{name} moves by {largest:.3g} {BY_MAT[name].unit}, its noise before is {before.std():.2g}",
    )


def commanded(out: Signals) -> FlightCheck:
    """Check that the controllers' outputs are finite throughout."""
    lost = {name: np.flatnonzero(~np.isfinite(out[name])) for name in ("M", "T")}
    first = {name: steps[0] * PERIOD for name, steps in lost.items() if steps.size}
    if not first:
        return FlightCheck("commands finite", True, "M and T")
    name = min(first, key=lambda name: first[name])
    return FlightCheck(
        "commands finite",
        False,
        f"{name} is not finite from {first[name]:.3f} s on, in {lost[name].size} steps, where the motors were stopped",
    )


def not_judged(reason: str) -> FlightCheck:
    """Return the failed check that replaces the data checks of an aborted flight."""
    return FlightCheck("data", False, f"not judged: {reason}")


def received(plan: Script, have: NDArray[np.bool_]) -> FlightCheck:
    """Check that enough samples were received; `have` (n,) marks the control steps with one."""
    missing = int((~have).sum())
    gap = max((b - a for a, b in runs(~have[plan.begin : plan.end])), default=0) * PERIOD
    good = missing <= MOST_LOST * len(have) and gap <= LONGEST_GAP
    seen = f"{len(have) - missing} of {len(have)}" + (
        f", longest gap in the excitation {1e3 * gap:.0f} ms" if gap else ""
    )
    return FlightCheck("samples received", good, seen)


MARGIN = 0.02
"""Rail kept free at each end [m]."""

PITCH_MARGIN = np.radians(2.0)
"""Pitch kept free before each stop [rad]."""

_LONG_RAIL = 5.0


@dataclass(frozen=True, eq=False)
class Flight:
    """Flown experiment: its log, its start, and the checks of its data. The same seed gives the same bits.

    `reason` says why a flight over MAVLink was aborted, "" if it was not.
    """

    experiment: Experiment
    log: FlightLog
    x_start: float
    seed: int
    checks: tuple[FlightCheck, ...]
    reason: str = ""

    @property
    def good(self) -> bool:
        """True if every check passed."""
        return all(check.passed for check in self.checks)

    def __repr__(self) -> str:
        failed = ", ".join(f"{check.name} {check.seen}" for check in self.checks if not check.passed)
        state = self.reason or (f"failed checks: {failed}" if failed else "good")
        return f"<Flight {self.experiment.name}, seed {self.seed}: {state}; log={self.log!r}>"


class Laboratory:
    """Virtual rig for experiments, compiled once.

    `rig` is "paper", "lab", a file or a set of parameters; `gains` are "default", "student", a file or a set of gains;
    `conditions` are further rig parameters such as `trim` or `rail_force`; `noise` scales all noise (0: none).
    `controllers` fly in place of the stock loops and mixer, at most one of each template (`flight.templates`). They are
    diagrams, JSON files, or names of starter diagrams such as "lqr-attitude"; `tuning` sets their parameters by path,
    such as "attitude_control.k_theta", and those of the flight code, such as "RATE_KP". `precision` is "float64" or
    "float32", that of a flight controller. With `failsafe` the failsafe is part of the flight code, as on board. It is
    armed and disarmed as `script` says, and its actions are in `signals`. Without a fault the flight has the same bits
    as without failsafe.

    Raises ParameterError for a rig, gains or tuning that cannot be read or set, and for a `noise` below 0 or not
    finite; DiagramError for a controller that cannot be read or fits no template.
    """

    def __init__(
        self,
        rig: str | Path | ParameterSet = "paper",
        gains: str | Path | Gains = DEFAULT,
        noise: float = 1.0,
        conditions: Mapping[str, Any] | None = None,
        controllers: Iterable[str | Path | Diagram] = (),
        tuning: Mapping[str, Any] | None = None,
        precision: str = "float64",
        failsafe: bool = False,
    ) -> None:
        if not is_number(noise, 0.0):
            raise ParameterError(
                f"{noise!r:.80} is not a factor of the noise", "noise", "give 0 (none) or more; 1 is the rig's own"
            )
        self.rig_name: str = "own" if isinstance(rig, ParameterSet) else str(rig)
        self.parameters: ParameterSet = rig if isinstance(rig, ParameterSet) else load_rig(rig)
        self.noise: float = noise
        diagrams = (c if isinstance(c, Diagram) else load_diagram(c) for c in controllers)
        self.controllers: dict[str, Diagram] = by_kind(diagrams)
        self.precision: str = precision
        self._conditions: dict[str, Any] = dict(conditions or {})

        flown = gains if isinstance(gains, Gains) else load_gains(gains)
        self._tuned: dict[str, float] = flown.tuned()

        def loop(failsafe: bool) -> ClosedLoop:
            made = ClosedLoop(
                flown,
                self.parameters,
                conditions,
                controllers=self.controllers.values(),
                precision=precision,
                failsafe=failsafe,
            )
            made.tune_controllers(tuning or {})
            return made

        self.loop: ClosedLoop = loop(failsafe)
        stock = {name: value for name, value in (tuning or {}).items() if name not in self.loop.controllers}
        self._tuned |= {TUNABLES[name].name or name if name in TUNABLES else name: stock[name] for name in stock}
        # The start is planned on a long rail, where the failsafe would brake.
        self._planning: ClosedLoop = loop(False) if failsafe else self.loop

    def fly(self, experiment: str | Experiment, seed: int = 1) -> Flight:
        """Fly `experiment`, or the ready-made one of that name, with the noise of `seed`.

        The start centres the flight on the rail. Raises ExperimentError if none fits or the pitch would reach a stop,
        for an unknown name, and for a seed that is not an integer from 0 to 2^32 - 1.

        With your own controller a flight without a fitting start begins in the middle of the rail, and the checks
        report the fault. If a moment or thrust is not finite, the motors stop, and the log leaves the value out.
        """
        experiment, seed = ready(experiment), _checked_seed(seed)
        try:
            x_start = self.start(experiment)
        except ExperimentError:
            if not self.controllers:
                raise
            x_start = 0.0
        plan = script(experiment, x_start)
        out = self.signals(experiment, plan, x_start, seed)
        provenance = {
            "experiment": experiment.name,
            "excitation": experiment.excitation.to_dict(),
            "rig": self.rig_name,
            "seed": seed,
            "versions": versions(),
            "parameters": self._tuned,
        }
        if self.controllers:
            provenance["controllers"] = {
                kind: row | {"diagram": json.loads(to_json(self.controllers[kind]))}
                for kind, row in self.described_controllers().items()
            }
        log = flight_log(out, np.asarray(plan.setpoints["mode"], dtype=np.int32), provenance)
        checks = data_checks(experiment, plan, out, self.parameters)
        if self.controllers:
            checks.append(commanded(out))
        return Flight(experiment, log, x_start, seed, tuple(checks))

    def signals(
        self, experiment: Experiment, plan: Script, x_start: float = 0.0, seed: int = 1
    ) -> dict[str, NDArray[Any]]:
        """Fly the script `plan` of `experiment` from `x_start` [m]; return each signal at the control steps, (steps,).

        The log of `fly` consists of these signals, as does the on-board log of the same flight over MAVLink. Raises
        ExperimentError for an invalid seed.
        """
        return self._fly(self.loop, experiment, plan, x_start, seed=_checked_seed(seed), noise=self.noise)

    def start(self, experiment: str | Experiment) -> float:
        """Return the start x [m] that centres the flight on the rail, from a flight without noise on a long rail.

        Raises ExperimentError if the rail is too short or the pitch would reach a stop.
        """
        experiment = ready(experiment)
        plan = script(experiment)
        out = self._fly(self._planning, experiment, plan, 0.0, seed=1, noise=0.0, rail_stop=_LONG_RAIL)
        flown = slice(plan.begin, plan.end)
        steepest = float(np.abs(out["true_theta"][flown]).max())
        stop = self.parameters["pitch_stop"]
        if steepest > stop - PITCH_MARGIN:
            raise ExperimentError(
                f"the pitch would reach {np.degrees(steepest):.0f} deg, and the stop is at {np.degrees(stop):.0f} deg",
                experiment.name,
                "use a smaller or shorter excitation",
            )
        if experiment.rings:
            return 0.0
        low, high = float(out["true_x"][flown].min()), float(out["true_x"][flown].max())
        room = 2.0 * (self.parameters["rail_stop"] - MARGIN)
        if high - low > room:
            what = f"the cart would travel {high - low:.2f} m, and the rail leaves {room:.2f} m"
            raise ExperimentError(what, experiment.name, "use a smaller or shorter excitation")
        return -0.5 * (low + high)

    def described_controllers(self) -> dict[str, dict[str, Any]]:
        """Return the user's controllers by template: name, SHA-256 of the JSON form, and values of parameters."""
        values = {path: value for path, (_, value) in self.loop.controller_parameters().items()}
        return {
            kind: {
                "name": diagram.name,
                "sha256": hashlib.sha256(to_json(diagram).encode()).hexdigest(),
                "parameters": {
                    path.removeprefix(f"{kind}."): _jsonable(value)
                    for path, value in values.items()
                    if path.startswith(f"{kind}.")
                },
            }
            for kind, diagram in self.controllers.items()
        }

    def _fly(
        self, loop: ClosedLoop, experiment: Experiment, plan: Script, x_start: float, **conditions: float
    ) -> dict[str, NDArray[Any]]:
        machine = {"rail_stop": self.parameters["rail_stop"]} | self._conditions
        loop.configure(machine | {"rings": experiment.rings, "ring_place": x_start} | conditions)
        loop.start(InitialState(x=x_start))
        return loop.fly(plan.steps, {**plan.setpoints, **({"arm": plan.arm} if loop.failsafe else {})})


def flight_log(out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32], provenance: dict[str, Any]) -> FlightLog:
    """Return the drone's log of a flight with the signals `out`, as `ClosedLoop.fly` returns them.

    Samples that are not finite, from a faulty controller, are left out: the channel has a gap there.
    """
    return FlightLog(step_channels(np.arange(len(mode), dtype=np.int64), out, mode), provenance)


def _checked_seed(seed: int) -> int:
    if not is_number(seed, 0, SEEDS - 1, whole=True):
        raise ExperimentError(
            f"seed must be an integer 0 to {SEEDS - 1}, not {seed!r:.80}", "experiment", "give another seed"
        )
    return int(seed)


def ready(experiment: str | Experiment) -> Experiment:
    """Return the experiment itself, or the ready-made one of that name. Raises ExperimentError."""
    if isinstance(experiment, str):
        return named_experiment(experiment)
    if not isinstance(experiment, Experiment):
        raise ExperimentError(
            f"a {type(experiment).__name__} is not an experiment", "", f"name one: {', '.join(EXPERIMENTS)}"
        )
    return experiment


def _jsonable(value: Any) -> Any:
    """Return a value for JSON, with an infinity or NaN as its name."""
    if isinstance(value, list):
        return [_jsonable(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def simulate(
    experiment: str | Experiment,
    rig: str | Path | ParameterSet = "paper",
    seed: int = 1,
    gains: str | Path | Gains = DEFAULT,
) -> Flight:
    """Fly `experiment` once on the virtual rig. For several flights make a `Laboratory`. Raises its errors."""
    return Laboratory(rig, gains).fly(experiment, seed)


_SIMULATED = {*MEASUREMENTS, *(name for name, _, _ in OUTPUTS), "mode", "voltage", "charge"}
_LOGGED = [
    (column, name)
    for row in TOPICS
    for column, name in zip(row.columns, row.source, strict=bool(row.source))
    if name in _SIMULATED and row.rate_hz
]

COLUMNS = tuple(column for column, _ in _LOGGED)
"""Columns of `signals.TOPICS` in the log of a flight."""

NAMES = tuple(name for _, name in _LOGGED)
"""Names of these columns in the closed loop, in the same order."""


@dataclass(frozen=True, eq=False)
class ReceivedSamples:
    """Received rows of `COLUMNS`: `values` (n, k) at the `ticks` (n,), NaN where a channel had no new sample.

    `truth` (m, 4) has the states `flightlog.steps.TRUTH` of a virtual rig at `truth_ticks` (m,); m is 0 with a real
    drone.
    """

    ticks: NDArray[np.int64]
    values: NDArray[np.float64]
    truth_ticks: NDArray[np.int64]
    truth: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        ticks: ArrayLike,
        values: ArrayLike,
        first: int,
        steps: int,
        truth_ticks: ArrayLike = (),
        truth: ArrayLike = (),
    ) -> ReceivedSamples:
        """Return the samples of `steps` control steps from the tick `first` on, sorted, without repetitions."""
        rows = _within(ticks, np.reshape(np.asarray(values, dtype=np.float64), (-1, len(COLUMNS))), first, steps)
        return cls(
            *rows, *_within(truth_ticks, np.reshape(np.asarray(truth, np.float64), (-1, len(TRUTH))), first, steps)
        )

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column by its name in the closed loop, (n,)."""
        return self.values[:, NAMES.index(name)]

    def log(self, provenance: dict[str, Any], safety: Channel | None = None) -> FlightLog:
        """Return a flight log, with the channel `safety` if given; lost samples are gaps."""
        out: dict[str, NDArray[Any]] = {name: self.column(name) for name in NAMES}
        mode = np.nan_to_num(out["mode"], nan=0.0)
        out |= {row.when: np.isfinite(out[row.source[0]]) for row in TOPICS if row.own_rate}
        channels = step_channels(self.ticks, out, np.clip(mode, 0, len(MODES) - 1).astype(np.int32))
        if len(self.truth_ticks):
            channels |= truth_channels(self.truth_ticks, dict(zip(TRUTH, self.truth.T, strict=True)))
        return FlightLog(channels if safety is None else {**channels, "safety": safety}, provenance)

    def on_grid(self, first: int, steps: int) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Return signals by their names in the closed loop, and a mask of the received steps: (steps,) each.

        NaN marks a missing sample. True states (`true_theta`, ...) are included if any were received.
        """
        have = np.zeros(steps, dtype=bool)
        have[self.ticks - first] = True
        out = _spread(NAMES, self.ticks - first, self.values, steps)
        if len(self.truth_ticks):
            out |= _spread([f"true_{name}" for name in TRUTH], self.truth_ticks - first, self.truth, steps)
        return out, have


def safety_in(told: Sequence[tuple[int, tuple[int, ...]]], first: int, steps: int) -> Channel | None:
    """Return the channel `safety` of the messages (tick, row) in `steps` steps from the tick `first`; None if none."""
    rows = {tick: row for tick, row in told if first <= tick < first + steps}
    ticks = np.array(sorted(rows), dtype=np.int64)
    values = np.array([rows[tick] for tick in ticks.tolist()], dtype=np.float64)
    return safety_channel(ticks, values) if len(ticks) else None


def _within(
    ticks: ArrayLike, rows: NDArray[np.float64], first: int, steps: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the ticks within `steps` steps from `first` on and their rows, sorted, without repetitions."""
    tick = np.asarray(ticks, dtype=np.int64)
    inside = np.flatnonzero((tick >= first) & (tick < first + steps))
    tick, index = np.unique(tick[inside], return_index=True)
    return tick, rows[inside[index]]


def _spread(
    names: Sequence[str], place: NDArray[np.int64], rows: NDArray[np.float64], steps: int
) -> dict[str, NDArray[Any]]:
    """Put each column of `rows` on a grid of `steps`, by name; NaN marks a missing row."""
    grid = np.full((steps, len(names)), np.nan)
    grid[place] = rows
    return {name: grid[:, k] for k, name in enumerate(names)}
