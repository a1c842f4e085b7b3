"""Flying an experiment, or a series of them, over MAVLink: a virtual drone or a real one, lockstep or real time."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import product
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any, NamedTuple

import numpy as np

from twodof.errors import ExperimentError, LinkLost, Rejected, Timeout, TwodofError
from twodof.experiment.experiments import LOOP, Experiment, Script, on_wire, script
from twodof.experiment.flight import (
    COLUMNS,
    MARGIN,
    PITCH_MARGIN,
    Flight,
    FlightCheck,
    Laboratory,
    ReceivedSamples,
    data_checks,
    not_judged,
    ready,
    received,
    safety_in,
)
from twodof.fleet.virtual_drone import virtual_drone
from twodof.flight.failsafe.causes_and_actions import CAUSES
from twodof.flightlog.provenance import versions
from twodof.gcs.active_controller import ActiveController, ParameterChanges
from twodof.gcs.drone import Drone
from twodof.gcs.drone_state import StatusText
from twodof.gcs.full_rate import BatchRows, TruthRows
from twodof.gcs.recording import safety_row, seconds
from twodof.rig.parameters import NAMES
from twodof.signals import PERIOD

Progress = Callable[[str, float], None]
"""Callback with the current phase and the share of the flight that is done, 0 to 1."""

WATCH = round(0.1 / PERIOD)
"""Control steps between two checks from the ground; the failsafe on board checks every step."""

UPLOAD = round(0.5 / PERIOD)
"""Control steps between the upload of an excitation and its start."""

START = round(0.1 / PERIOD)
"""Control steps before a flight in real time starts: subscribed streams have started by then."""

LEVEL = round(1.0 / PERIOD)
"""Control steps of level hold before an aborted flight is disarmed."""

LEAST_STILL = 0.2
"""Shortest time [s] with the motors off, in which the drone receives its sensors and arms."""

OUT_OF_PLACE = 0.08
"""Largest distance [m] from the start at which an excitation begins: gusts move the lab rig's cart by .05."""

TILTED = 0.2
"""Largest pitch [rad] at which an excitation begins; a level hold stays within .05."""


def fly(
    experiment: str | Experiment,
    drone: Drone,
    seed: int = 1,
    noise: float = 1.0,
    x_start: float | None = None,
    laboratory: Laboratory | None = None,
    progress: Progress | None = None,
    interrupted: Callable[[Flight], None] | None = None,
) -> Flight:
    """Fly `experiment`, or the ready-made one of that name, with `drone`: arm, hold, excite on board, disarm.

    A virtual drone is reset to the start first, with the noise of `seed` times `noise`. In lockstep the flight has the
    bits of `Laboratory.fly`: `experiments.script` is followed to the tick. In real time it begins as soon as the drone
    is there. A real drone's rings must be set as the experiment needs them; with the cart free it flies to the start
    during the hold.

    `x_start` [m] is the start of a flight with the cart free. None takes the start that centres the flight on the rail
    of `laboratory`, by default the virtual rig of the drone's name, else "lab".

    Pitch and position are checked from the ground ten times a second. A limit, an action of the failsafe, a refusal or
    a lost link aborts the flight: level, then disarmed. It is then returned with its `reason`, its samples so far and
    failed checks. Ctrl-C disarms, passes the samples so far to `interrupted`, and is raised again.

    Raises ExperimentError for an experiment that cannot be flown, before anything moves, and the errors of `Drone`
    while the drone is reset.
    """
    experiment = ready(experiment)
    rig = drone.state.rig
    if experiment.still < LEAST_STILL:
        remedy = f"give {LEAST_STILL:g} s or more: the drone receives its sensors and arms in this time"
        raise ExperimentError(f"the motors are off for {experiment.still:g} s only", f"{experiment.name}.still", remedy)
    if not rig.virtual and rig.rings_locked != experiment.rings:
        asked, found = ("locked", "free") if experiment.rings else ("free", "locked")
        raise ExperimentError(
            f"the experiment needs the cart {asked}, and it is {found}", experiment.name, "set the rings, then fly"
        )
    model = laboratory if laboratory is not None else Laboratory(rig.name if rig.name in NAMES else "lab")
    if x_start is None:
        x_start = 0.0 if experiment.rings else model.start(experiment)
    room = model.parameters["rail_stop"] - MARGIN
    if not abs(x_start) <= room:
        remedy = f"start within {room:.2f} m of the rail's middle"
        raise ExperimentError(f"x = {x_start:g} m is not a valid start", experiment.name, remedy)
    plan = script(experiment, x_start)
    if rig.virtual:
        drone.reset(seed=seed, x=x_start, noise=noise, rings=experiment.rings)
    flown_seed = seed if rig.virtual else 0
    what = _flies(drone)
    with _listening(drone, what) as heard, drone.batch(COLUMNS) as rows, _truth(drone) as truth:
        course = _Course(
            experiment, plan, x_start, drone, rows, model.parameters, progress or (lambda text, share: None)
        )

        def flight(reason: str) -> Flight:
            known = (truth.ticks, truth.values) if truth is not None else ()
            samples = ReceivedSamples.of(rows.ticks, rows.values, course.first, plan.steps, *known)
            out, have = samples.on_grid(course.first, plan.steps)
            checks = [
                FlightCheck("flown to its end", not reason, reason or "yes"),
                FlightCheck("failsafe silent", not course.acted, course.acted or "yes"),
                received(plan, have[: course.flown]),
            ]
            if reason:
                checks.append(not_judged("the flight was broken off"))
            else:
                checks += data_checks(experiment, plan, out, model.parameters)
            provenance: dict[str, object] = {
                "experiment": experiment.name,
                "excitation": experiment.excitation.to_dict(),
                "rig": rig.name,
                "seed": flown_seed,
                "versions": versions(),
                "flown": {"url": drone.url, "virtual": rig.virtual, "controller": rig.controller, "reason": reason},
                "texts": [list(line) for line in heard.texts],
                "changes": [list(row) for row in heard.changes],
                **what.provenance(),
            }
            log = samples.log(provenance, safety_in(heard.safety, course.first, plan.steps))
            return Flight(experiment, log, x_start, flown_seed, tuple(checks), reason)

        try:
            reason = course.fly()
        except KeyboardInterrupt:
            if interrupted is not None and len(rows.ticks):
                interrupted(flight("interrupted"))
            raise
    return flight(reason)


@contextmanager
def _truth(drone: Drone) -> Iterator[TruthRows | None]:
    """Subscribe to the true state of a virtual rig; None if the drone does not send it."""
    with ExitStack() as stack:
        rows = None
        if drone.state.rig.virtual:
            with suppress(Rejected):  # the truth is optional
                rows = stack.enter_context(drone.truth())
        yield rows


def _flies(drone: Drone) -> ActiveController:
    """Return the active controller; unknown if the drone does not report it."""
    with suppress(Rejected, Timeout):
        return drone.active_controller()
    return ActiveController(known=False)


class _Heard(NamedTuple):
    """Messages of the drone in flight: TWODOF_SAFETY as (tick, row of the channel), texts as (s, severity, text).

    `changes` of parameters are (s, name, value).
    """

    safety: list[tuple[int, tuple[int, int, int]]]
    texts: list[tuple[float, str, str]]
    changes: list[tuple[float, str, float]]


@contextmanager
def _listening(drone: Drone, what: ActiveController) -> Iterator[_Heard]:
    changes, there = ParameterChanges(what), drone.there
    heard = _Heard([], [], changes.rows)

    def said(line: StatusText) -> None:
        heard.texts.append((seconds(there.tick), line.severity, line.text))

    def safety(got: Any) -> None:
        heard.safety.append((got.tick, safety_row(got)))

    def parameter(got: Any) -> None:
        changes.add(seconds(there.tick), got)

    session = there.session
    with (
        session.handling(safety, "TWODOF_SAFETY"),
        session.handling(parameter, "PARAM_VALUE"),
        session.handling(said, StatusText),
    ):
        yield heard


@dataclass
class _Course:
    """One flight in progress; `first` is the tick of step 0, `flown` the number of steps flown.

    `acted` is the action of the failsafe, "" for none.
    """

    experiment: Experiment
    plan: Script
    x_start: float
    drone: Drone
    rows: BatchRows
    stops: Mapping[str, float]
    progress: Progress
    first: int = 0
    flown: int = 0
    acted: str = ""
    _seen: int = 0
    _flying: bool = False

    def fly(self) -> str:
        """Fly the script; return the reason of an abort, "" without one."""
        self.first = self.drone.tick if self.drone.state.rig.lockstep else self.drone.tick + START
        try:
            reason = self._follow()
        except (Rejected, Timeout, LinkLost) as error:
            reason = str(error)
        except BaseException:
            # Ctrl-C above all: the motors must not keep running.
            self.flown = self._steps()
            self._end()
            raise
        self.flown = self._steps()
        return reason if not reason else "; ".join([reason, *self._break_off()])

    def _steps(self) -> int:
        return min(max(0, self.drone.tick - self.first), self.plan.steps)

    def _follow(self) -> str:
        plan, held = self.plan, self.experiment.thrust > 0.0
        upload = max(plan.begin - UPLOAD, plan.hold if held else plan.armed)
        course: list[tuple[int, str, Callable[[], str]]] = [
            (plan.armed, "arm", self._arm),
            *([(plan.armed, "arm", self._offer), (plan.hold, "hold", self._hold)] if held else []),
            (upload, "excite", self._excite),
            (plan.end, "disarm", self._end),
            (plan.steps, "done", lambda: ""),
        ]
        for step, text, act in course:
            reason = self._watch_until(step)
            if not reason:
                self.progress(text, step / plan.steps)
                reason = act()
            if reason:
                return reason
        return ""

    def _arm(self) -> str:
        self._flying = True  # also without an answer: the drone is disarmed in any case
        try:
            self.drone.arm()
        except Rejected:
            self._flying = False
            raise
        return ""

    def _offer(self) -> str:
        # Offboard mode needs set-points first. These have no thrust: the hold begins at its tick.
        self.drone.set_pitch(0.0, thrust=0.0)
        return ""

    def _hold(self) -> str:
        if self.experiment.rings:
            self.drone.set_pitch(0.0, thrust=on_wire(self.experiment.thrust))
        else:
            self.drone.set_position(on_wire(self.x_start))
        return ""

    def _excite(self) -> str:
        theta, x = (self._latest(name) for name in ("estimate.theta", "estimate.x"))
        if not abs(theta) <= TILTED:
            return f"the drone does not hold level: the pitch is {np.degrees(theta):.0f} deg"
        if not (self.experiment.rings or abs(x - self.x_start) <= OUT_OF_PLACE):
            return f"the drone does not hold its position: the cart is at {x:+.2f} m, not at {self.x_start:+.2f} m"
        excitation = self.experiment.excitation
        # The rest is flown as a part of the excitation, so that the loop stays as it is.
        longer = replace(excitation, settle=excitation.settle + self.experiment.rest)
        self.drone.excite(
            longer,
            loop=LOOP[self.experiment.mode],
            thrust=on_wire(self.experiment.thrust),
            at=self.first + self.plan.begin,
            wait=False,
        )
        return ""

    def _end(self) -> str:
        self._flying = False
        self.drone.disarm()
        return ""

    def _break_off(self) -> list[str]:
        """Level, then disarm; return the failures."""
        failed = []
        for what, act in (("level", self._level), ("disarm", self._end)):
            if self._flying:
                try:
                    act()
                except (Rejected, Timeout, LinkLost) as error:
                    failed.append(f"{what}: {error}")
        return failed

    def _level(self) -> None:
        if self.experiment.thrust > 0.0 and not self.acted:
            self.drone.level_hold()
        self.drone.run_until(self.drone.tick + LEVEL)

    def _watch_until(self, step: int) -> str:
        """Let the drone's time pass up to `step`; return the reason of an abort, "" without one."""
        until = self.first + step
        while self.drone.tick < until:
            self.drone.run_until(min(until, self.drone.tick + WATCH))
            self.progress("", min(1.0, (self.drone.tick - self.first) / self.plan.steps))
            if self._flying and (reason := self._wrong()):
                return reason
        return ""

    def _wrong(self) -> str:
        state = self.drone.state
        if state.safety.action != "none" and state.safety.reason:
            texts = {cause.name: cause.text for cause in CAUSES}
            causes = map(str.strip, state.safety.reason.split(","))
            why = "; ".join(texts.get(name, name) for name in causes)
            self.acted = f"{state.safety.action}, since {why} ({state.safety.reason})"
            return f"the failsafe acts: {self.acted}"
        if not state.armed:
            # After a disarm command the failsafe stops the motors and gives no reason.
            self._flying = False
            said = self.drone.messages
            return f"disarmed; last message {said[-1].text!r}" if said else "disarmed"
        new = np.asarray(self.rows.values[self._seen :], dtype=np.float64)
        self._seen += len(new)
        limits = [("estimate.theta", self.stops["pitch_stop"] - PITCH_MARGIN, "pitch", "rad")]
        if not self.experiment.rings:
            limits.append(("estimate.x", self.stops["rail_stop"] - MARGIN, "cart", "m"))
        for column, limit, name, unit in limits:
            values = np.abs(new[:, COLUMNS.index(column)])
            if (values > limit).any():
                return f"the {name} is at {np.nanmax(values):.2f} {unit}, beyond {limit:.2f}"
        return ""

    def _latest(self, column: str) -> float:
        """Return the latest sample of a column, NaN without any."""
        values = np.asarray(self.rows.values, dtype=np.float64)[:, COLUMNS.index(column)]
        known = values[np.isfinite(values)]
        return float(known[-1]) if known.size else float("nan")


SeriesFlight = tuple[str, str, int, Flight]
"""Rig, experiment, seed and the flight."""


def fly_series(rigs: Iterable[str], names: Sequence[str], seeds: Iterable[int]) -> Iterator[SeriesFlight]:
    """Fly the experiments `names` with each of the `seeds` on a virtual drone of each rig, in lockstep, side by side.

    Yields each flight when it ends. Raises what `fly` raises. All drones end with the iterator.
    """
    plan = list(product(names, seeds))
    events: SimpleQueue[SeriesFlight | TwodofError | None] = SimpleQueue()
    ended = Event()

    def go_on(phase: str, share: float) -> None:
        if ended.is_set():
            raise ExperimentError("the series has ended", "fly_series")

    def fly_all(rig: str) -> None:
        last: TwodofError | None = ExperimentError("its flights ended by a fault", f"rig {rig}", "read the output")
        try:
            laboratory = Laboratory(rig)
            with virtual_drone(rig) as url, Drone.connect(url) as drone:
                drone.parameters["SDLOG_MODE"] = -1  # no log on board
                for name, seed in plan:
                    events.put((rig, name, seed, fly(name, drone, seed, laboratory=laboratory, progress=go_on)))
            last = None
        except TwodofError as error:
            last = error
        finally:
            events.put(last)

    threads = [Thread(target=fly_all, args=(rig,), daemon=True) for rig in rigs]
    for thread in threads:
        thread.start()
    left = len(threads)
    try:
        while left:
            event = events.get()
            if isinstance(event, TwodofError):
                raise event
            if event is None:
                left -= 1
            else:
                yield event
    finally:
        ended.set()
        for thread in threads:
            thread.join()
