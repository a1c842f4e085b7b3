"""Flying an experiment on the virtual rig: a start that fits, the flight, and whether its data are good enough."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.blocks.noise import SEEDS
from twodof.blocks.schema.json_form import to_json
from twodof.errors import ExperimentError, ParameterError
from twodof.experiment.checks import FlightCheck, commanded, data_checks
from twodof.experiment.experiments import EXPERIMENTS, Experiment
from twodof.experiment.experiments import experiment as named_experiment
from twodof.experiment.script import Script, script
from twodof.flight.gains import DEFAULT, Gains, load_gains
from twodof.flight.starters import load_diagram
from twodof.flight.templates import by_kind
from twodof.flightlog.log import FlightLog
from twodof.flightlog.provenance import versions
from twodof.flightlog.steps import step_channels
from twodof.parameters import ParameterSet
from twodof.rig.parameters import load_rig
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.initial_state import InitialState

MARGIN = 0.02
"""Rail kept free at each end [m]."""

PITCH_MARGIN = np.radians(2.0)
"""Pitch kept free before each stop [rad]."""

_LONG_RAIL = 5.0


@dataclass(frozen=True, eq=False)
class Flight:
    """A flown experiment: its log, where it started, and the checks of its data. The same seed gives the same bits.

    `reason` says why a flight over MAVLink ended before its end, "" if it did not.
    """

    experiment: Experiment
    log: FlightLog
    x_start: float
    seed: int
    checks: tuple[FlightCheck, ...]
    reason: str = ""

    @property
    def good(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)


class Laboratory:
    """A virtual rig on which experiments are flown, compiled once.

    `rig` is "paper", "lab", a file or a set of parameters; `gains` are "default", "student", a file or a set of gains;
    `conditions` are further rig parameters such as `trim` or `rail_force`; `noise` scales all noise (0: none).
    `controllers` fly in place of the stock loops and mixer, at most one of each template (`flight.templates`). They are
    diagrams, JSON files, or names of starter diagrams such as "lqr-attitude"; `tuning` sets their parameters by path,
    such as "attitude_control.k_theta". `precision` is "float64" or "float32", that of a flight controller. With
    `failsafe` the flight code has its last gate, as on board: it is armed and disarmed as `script` says, and what it
    does shows in `signals`. Where nothing fails the flight has the same bits as without.

    Raises ParameterError for a rig, gains or tuning that cannot be read or set, and for a `noise` below 0 or not
    finite; DiagramError for a controller that cannot be read or fits no template.
    """

    def __init__(
        self,
        rig: str | Path | ParameterSet = "paper",
        gains: str | Path | Gains = DEFAULT,
        noise: float = 1.0,
        conditions: Mapping[str, Any] | None = None,
        position_filter: str = "joint",
        controllers: Iterable[str | Path | Diagram] = (),
        tuning: Mapping[str, Any] | None = None,
        precision: str = "float64",
        failsafe: bool = False,
    ) -> None:
        if not (isinstance(noise, Real) and math.isfinite(noise) and noise >= 0.0):
            raise ParameterError(f"a noise of {noise!r:.80}", "noise", "give 0 (none) or more; 1 is the rig's own")
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
                position_filter,
                controllers=self.controllers.values(),
                precision=precision,
                failsafe=failsafe,
            )
            made.tune_controllers(tuning or {})
            return made

        self.loop: ClosedLoop = loop(failsafe)
        # Where a flight is to start is seen on a rail that is too long for the failsafe, which would brake.
        self._planning: ClosedLoop = loop(False) if failsafe else self.loop

    def fly(self, experiment: str | Experiment, seed: int = 1) -> Flight:
        """Flies `experiment` (or the ready-made one of that name) with the noise of `seed`, from a start that fits.

        Raises ExperimentError if no start on the rail will do, or if the pitch would reach a stop. It also does so for
        an unknown name, and for a seed that is not an integer from 0 to 2^32 - 1.

        Your own controller may fly badly: then it starts from the middle of the rail, and the checks say what went
        wrong. If a moment or thrust is not finite, the motors stop there, and the log leaves the value out.
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
        """Every signal at the control steps, (steps,) by name, of `experiment` flown as `plan` says from `x_start`.

        What the log of `fly` is made of, and what the on-board log of the same flight over MAVLink holds. Raises
        ExperimentError for a seed that `fly` would not take.
        """
        return self._fly(self.loop, experiment, plan, x_start, seed=_checked_seed(seed), noise=self.noise)

    def start(self, experiment: str | Experiment) -> float:
        """The x [m] from which the flight stays in the middle of the rail: it is flown without noise on a long one.

        Raises ExperimentError if it needs more rail than there is, or more pitch.
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
            raise ExperimentError(
                f"the cart would travel {high - low:.2f} m, and the rail leaves {room:.2f} m",
                experiment.name,
                "use a smaller or shorter excitation",
            )
        return -0.5 * (low + high)

    def described_controllers(self) -> dict[str, dict[str, Any]]:
        """The user's controllers by template: name, SHA-256 of the JSON form, and the values of parameters."""
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
    """The drone's log of a flight whose signals at the control steps are `out`, as `ClosedLoop.fly` gives them.

    Samples that are not finite, which a user's controller may give, are left out: the channel has a gap there.
    """
    return FlightLog(step_channels(np.arange(len(mode), dtype=np.int64), out, mode), provenance)


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= seed < SEEDS:
        raise ExperimentError(
            f"seed must be an integer 0 to {SEEDS - 1}, not {seed!r:.80}", "experiment", "give another seed"
        )
    return int(seed)


def ready(experiment: str | Experiment) -> Experiment:
    """The experiment itself, or the ready-made one of that name. Raises ExperimentError for anything else."""
    if isinstance(experiment, str):
        return named_experiment(experiment)
    if not isinstance(experiment, Experiment):
        raise ExperimentError(
            f"a {type(experiment).__name__} is not an experiment", "", f"name one: {', '.join(EXPERIMENTS)}"
        )
    return experiment


def _jsonable(value: Any) -> Any:
    """A parameter's value as JSON has it: an infinity or a NaN as its name."""
    if isinstance(value, list):
        return [_jsonable(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def simulate(
    experiment: str | Experiment,
    rig: str | Path | ParameterSet = "paper",
    seed: int = 1,
    gains: str | Path | Gains = DEFAULT,
) -> Flight:
    """Flies `experiment` once on the virtual rig; for several flights keep a `Laboratory`, whose errors it raises."""
    return Laboratory(rig, gains).fly(experiment, seed)
