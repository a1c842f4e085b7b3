"""Segment of a logged flight on the control grid: modes, set-points, start, trim and bias."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import from_json
from twodof.errors import LogError, TwodofError
from twodof.flight.gains import Gains
from twodof.flight.templates import TEMPLATES, check_template
from twodof.flightlog.events import SETPOINTS, Event, Stretch, mode_at, modes, window
from twodof.flightlog.log import FlightLog
from twodof.signals import MODES, PERIOD, VELOCITY
from twodof.sim.time_alignment import step_clock

Change = tuple[float, str, float]
"""Change of a parameter: time [s] of the last step with the old value, the parameter's name or path, new value."""

_MOST = 3e38


@dataclass(frozen=True)
class FlownParameters:
    """Gains at the start of a log, None if it does not tell them, and the `changes` in flight in order of time.

    `controllers` are the user's diagrams by template, `tuning` their parameters at the start by path. `unknown` names
    the templates of the user's controllers whose diagram the log lacks.
    """

    gains: Gains | None = None
    changes: tuple[Change, ...] = ()
    controllers: Mapping[str, Diagram] = field(default_factory=dict)
    tuning: Mapping[str, Any] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()

    @classmethod
    def of(cls, provenance: Mapping[str, Any]) -> FlownParameters:
        """Return the parameters in a log's provenance. Invalid entries are ignored, as the log is not trusted."""
        drone = provenance.get("drone")
        drone = drone if isinstance(drone, Mapping) else {}
        noted = provenance.get("controllers") or drone.get("controllers") or {}
        found: dict[str, Diagram] = {}
        tuning: dict[str, Any] = {}
        unknown = []
        for template, row in noted.items() if isinstance(noted, Mapping) else [(str(noted), None)]:
            diagram = _diagram(template, row)
            if diagram is None:
                unknown.append(str(template))
            else:
                found[template] = diagram
                values = row.get("parameters") if isinstance(row, Mapping) else None
                inside = values if isinstance(values, Mapping) else {}
                tuning |= {f"{template}.{path}": value for path, value in inside.items()}
        changes = tuple(sorted(_changes(provenance.get("changes"))))
        return cls(Gains.from_provenance(provenance), changes, found, tuning, tuple(unknown))

    def gains_in_flight(self, start: Gains) -> list[tuple[float, Gains]]:
        """Return each time [s] at which the gains changed, with the gains from then on; `start` are the first gains."""
        found: list[tuple[float, Gains]] = []
        now = start
        for time, name, value in self.changes:
            changed = now.changed(name, value)
            if changed != now:
                now = changed
                found.append((time, now))
        return found


def _diagram(template: str, row: object) -> Diagram | None:
    """Return a log's diagram of a user's controller; None if there is none, or its template does not fit."""
    if not isinstance(row, Mapping) or not isinstance(row.get("diagram"), Mapping) or template not in TEMPLATES:
        return None
    try:
        diagram = from_json(json.dumps(row["diagram"]))
        check_template(diagram, template)
    except (TwodofError, ValueError):
        return None
    return diagram


def _changes(rows: object) -> Iterator[Change]:
    """Yield the changes whose numbers are finite and fit float32."""
    for row in rows if isinstance(rows, list) else ():
        match row:
            case [int() | float() as time, str() as name, int() | float() as value]:
                if abs(time) < _MOST and abs(value) < _MOST and not isinstance(value, bool):
                    yield float(time), name, value


Floats = NDArray[np.float64]

MAX_STEPS = 450_000
"""Largest number of control steps in a window: half an hour."""

HISTORY = 24
"""Number of control steps before the window whose commands fill the delay lines: more than the longest delay."""

_SETTLE = 0.5  # s after arming until the hold counts, as the rotors and the rate loop settle
_SETTLE_STEP = 2.0  # s after a set-point step
_HOLD = 6.0  # s, longest hold used
_BALANCE = 5.0  # s, least time with thrust that says something of the rail
_HANDED_OVER = 5e-4  # m
_FILTER = 100  # steps over which the derivative's state is rebuilt; it forgets .714 a step


@dataclass(frozen=True)
class FlightSegment:
    """A window of a log on the control grid of n steps, and the start of its simulation.

    `time` (n,) [s] are the steps by the drone's clock; `mode` (n,) indices into `signals.MODES`; `setpoint[name]` (n,)
    for x0, v0, theta0, q0, M_open, thrust. In 1DoF, if the log lacks the cart's signals, x0 and v0, and x and v of
    `start`, are 0. `hold` [s] is the time before the window from which the trim is taken, None without one. The trim is
    `trim_moment`, the mean M, at the mean pitch `trim_theta`. `velocity_bias` [m/s], and with a free cart `balance`,
    are from before the window too: `balance` is the mean pitch [rad], speed [m/s] and acceleration [m/s2] over all time
    with thrust.
    `commands` are (M, T) of the `HISTORY` steps before, `states` the controllers' states at the first step. `spun_up`
    [s] is the time since the rotors started, `tof_elapsed` [s] that since the last range sample. `runs` (from, to) [s]
    are the times with thrust before the first step, counted back from it.
    """

    time: Floats
    mode: NDArray[np.int32]
    setpoint: Mapping[str, Floats]
    commands: tuple[tuple[float, float], ...]
    start: Mapping[str, float]
    states: Mapping[str, float]
    hold: tuple[float, float] | None
    trim_moment: float | None
    trim_theta: float
    balance: tuple[float, float, float]
    velocity_bias: float
    spun_up: float
    tof_elapsed: float
    runs: tuple[tuple[float, float], ...]
    window: tuple[float, float]

    @property
    def rails(self) -> bool:
        """Return True if the cart was free: velocity or position mode at some step of the window."""
        return bool(np.any(self.mode >= VELOCITY))


def default_window(log: FlightLog) -> tuple[float, float]:
    """Return the window [s] from .3 s before the first set-point step to 2 s after the last one, in one mode.

    Of the stretches flown in one mode, that with most steps is taken. Raises LogError for a log without steps.
    """
    best: tuple[int, Stretch, Floats] | None = None
    for stretch in modes(log):
        if stretch.mode == "off":
            continue
        times = _steps(log, stretch)
        if times.size and (best is None or times.size > best[0]):
            best = (times.size, stretch, times)
    if best is None:
        raise LogError("no set-point has a step in this log", log.source, "give a window with --window T0 T1")
    _, stretch, times = best
    ends = [Event(float(time), "step", stretch.mode, 0.0, 0.0) for time in times[[0, -1]]]
    return window(log, ends)


def _steps(log: FlightLog, stretch: Stretch) -> Floats:
    """Return the times at which the set-point of a stretch changes; the switches into and out of its mode do not count.

    Changes below .2 % of the set-point's range are not meant: a set-point that follows its measurement drifts. Nor is a
    jump to where the cart is: the loop is handed over there.
    """
    name = SETPOINTS.get(stretch.mode, "M")
    if stretch.duration <= 0.1:
        return np.empty(0)
    channel = log[name].slice(stretch.t0 + 0.05, stretch.t1 - 0.05)
    if not len(channel):
        return np.empty(0)
    changed = np.flatnonzero(np.abs(np.diff(channel.value)) > max(1e-6, 0.002 * float(np.ptp(channel.value)))) + 1
    if stretch.mode == "position":
        away = np.abs(channel.value[changed] - _held(log, "x", channel.time[changed])) > _HANDED_OVER
        changed = changed[away]
    return channel.time[changed]


def read_segment(log: FlightLog, gains: Gains, window: tuple[float, float] | None = None) -> FlightSegment:
    """Read a window (None: the default one) of `log`, flown with `gains`.

    Raises LogError for a window without 10 control steps, and as `FlightLog` does for missing channels. The cart's
    channels (x, v, x0, v0) must be there only if a mode of the window needs the cart.
    """
    t0, t1 = window if window is not None else default_window(log)
    grid = _grid(log, t0, t1)
    mode = mode_at(log, grid + 0.5 * PERIOD)
    if not mode.any():
        raise LogError(
            f"nothing is flown between {grid[0]:g} and {grid[-1]:g} s", log.source, "give a window with thrust or M"
        )
    ahead = grid + 0.5 * PERIOD
    rails = bool(np.any(mode >= VELOCITY))
    setpoint = {name: _held(log, name, ahead) for name in ("x0", "v0") if rails or logged(log, name)}
    setpoint = dict.fromkeys(("x0", "v0"), np.zeros(len(grid))) | setpoint
    setpoint |= {name: _held(log, name, ahead) for name in ("theta0", "q0")}
    setpoint |= {"M_open": _held(log, "M", ahead), "thrust": _held(log, "T", ahead)}
    begin = float(grid[0])
    history = begin + PERIOD * np.arange(-HISTORY, 0)
    commands = tuple(zip(_held(log, "M", history + 0.5 * PERIOD), _held(log, "T", history + 0.5 * PERIOD), strict=True))
    armed_at, hold = _hold(log, begin)
    known = ("theta", "q", *(name for name in ("x", "v") if rails or logged(log, name)))
    start = {"x": 0.0, "v": 0.0}
    start |= {name: float(np.interp(begin, log[name].time, log[name].value)) for name in known}
    start["theta_previous"] = float(_held(log, "theta", np.array([begin]))[0])
    # The rail's bias is not the mean pitch of this hold, which is mostly what stiction leaves: see `_balance`.
    means = {} if hold is None else {name: float(np.mean(log[name].slice(*hold).value)) for name in ("M", "theta")}
    ranges = log["dist"].time if "dist" in log else np.empty(0)
    earlier = ranges[ranges < begin]
    return FlightSegment(
        time=grid,
        mode=mode,
        setpoint=setpoint,
        commands=tuple((float(m), float(t)) for m, t in commands),
        start=start,
        states=_controller_states(log, gains, begin, MODES[mode[0]]),
        hold=hold,
        trim_moment=means.get("M"),
        trim_theta=means.get("theta", 0.0),
        balance=_balance(log, begin) if rails else (0.0, 0.0, 0.0),
        velocity_bias=_velocity_bias(log, begin) if rails else 0.0,
        spun_up=begin - armed_at if armed_at is not None else 0.0,
        tof_elapsed=float(begin - earlier[-1]) if earlier.size else 0.0,
        runs=tuple((begin - a, max(0.0, begin - b)) for a, b in log.armed() if a < begin),
        window=(t0, t1),
    )


def logged(log: FlightLog, name: str) -> bool:
    """Return True if the log holds samples of the channel `name`."""
    return name in log and len(log[name]) > 0


def _grid(log: FlightLog, t0: float, t1: float) -> Floats:
    """Return the control steps from t0 to t1 by the drone's clock: a line through the jittering stamps of M."""
    if not t0 < t1:
        raise LogError(f"window {t0!s} to {t1!s} s is empty", log.source, "give t0 < t1, in seconds")
    stamps = log["M"].slice(t0 - PERIOD, t1 + PERIOD).time
    if len(stamps) < 10:
        raise LogError(
            f"only {len(stamps)} control steps between {t0:g} and {t1:g} s", log.source, "give a longer window"
        )
    period, origin, _ = step_clock(stamps)
    first = int(np.ceil((t0 - origin) / period))
    last = int(np.floor((t1 - origin) / period))
    if last - first > MAX_STEPS:
        what = f"{last - first} control steps from {t0:g} to {t1:g} s are too many"
        raise LogError(what, log.source, f"give a window of at most {MAX_STEPS * PERIOD:g} s")
    return np.asarray(origin + period * np.arange(first, last + 1), dtype=np.float64)


def _held(log: FlightLog, name: str, at: ArrayLike) -> Floats:
    """Return the latest sample of a channel at or before each time; the first one before that."""
    channel = log[name]
    if not len(channel):
        raise LogError("the channel is empty", f"{log.source}: {name}", "give a log of a whole flight")
    return channel.value[np.maximum(channel.index(at, "hold"), 0)]


def _hold(log: FlightLog, begin: float) -> tuple[float | None, tuple[float, float] | None]:
    """(when the rotors started, the hold) before `begin`.

    What is held is a pitch or a place. What was flown in open loop, or with the rate or velocity loop alone, does not
    count. Where nothing else was flown since the rotors started, the hold is that of the flight before.
    """
    armed_at, found = None, None
    for a, b in log.armed():
        if a > begin:
            break
        if b >= begin:
            armed_at = a
        end = min(b, _loop_opened(log, begin) if b >= begin else b)
        start = max(a + _SETTLE, end - _HOLD, _last_step(log, a, end) + _SETTLE_STEP)
        if end - start > 0.2:
            found = (start, end)
    return armed_at, found


def _last_step(log: FlightLog, a: float, b: float) -> float:
    """Time of the last step of theta0 or x0 between a and b, their first .3 s left out; minus infinity if none."""
    latest = -np.inf
    for name in ("theta0", "x0"):
        if name not in log:
            continue
        channel = log[name].slice(a + 0.3, b)
        steps = np.flatnonzero(np.abs(np.diff(channel.value)) > 0.02) + 1
        if steps.size:
            latest = max(latest, float(channel.time[steps[-1]]))
    return latest


def _loop_opened(log: FlightLog, begin: float) -> float:
    """When the mode that is flown at `begin` was entered, or `begin` if that mode holds the pitch or the place."""
    for stretch in modes(log):
        if stretch.t0 <= begin < stretch.t1 and stretch.mode in ("open-loop", "rate", "velocity"):
            return stretch.t0
    return begin


def _balance(log: FlightLog, begin: float) -> tuple[float, float, float]:
    """Mean (theta, v, v') over all time with thrust before `begin`; zeros for less than 5 s of it.

    The longer it is, the more often the cart has moved, and the less of the mean pitch is stiction. Over 5 s it still
    wanders by .01 rad. The speed is from x, which does not drift.
    """
    stretches = [(a, min(b, begin)) for a, b in log.armed() if a < begin]
    duration = sum(b - a for a, b in stretches)
    if duration < _BALANCE:
        return 0.0, 0.0, 0.0

    def risen(name: str) -> float:
        ends = np.interp(stretches, log[name].time, log[name].value)
        return float(np.sum(ends[:, 1] - ends[:, 0])) / duration

    pitch = np.concatenate([log["theta"].slice(a, b).value for a, b in stretches])
    return float(np.mean(pitch)) if pitch.size else 0.0, risen("x"), risen("v")


def _velocity_bias(log: FlightLog, begin: float) -> float:
    """Mean estimated v less the way that the estimated x went, over the last 6 s before `begin`, motors on or off.

    x cannot drift away from its range sensor, so over 6 s this is good to 1 mm/s; over a short hold it is not.
    """
    since = max(begin - _HOLD, float(log["x"].time[0]))
    v, x = log["v"].slice(since, begin), log["x"].slice(since, begin)
    if len(v) < 2 or len(x) < 2 or begin - since < 1.0:
        return 0.0
    return float(np.mean(v.value) - (x.value[-1] - x.value[0]) / (x.time[-1] - x.time[0]))


def _controller_states(log: FlightLog, gains: Gains, begin: float, mode: str) -> dict[str, float]:
    """Return integrals and derivative state by the log before the step `begin`: I = M - Kp e - Kd D."""
    if mode not in SETPOINTS:
        return {}
    kp, _, kd = gains.rate
    steps = begin + PERIOD * np.arange(-_FILTER, 0)
    error = _held(log, "q0", steps + 0.5 * PERIOD) - _held(log, "q", steps)
    lag = 1.0 / 100.0
    slope, previous = 0.0, float(error[0])
    for e in error[1:]:
        slope = (lag * slope + (float(e) - previous)) / (lag + PERIOD)
        previous = float(e)
    moment = float(_held(log, "M", steps[-1:] + 0.5 * PERIOD)[0])
    states = {"rate.sum": moment - kp * previous - kd * slope, "rate.slope": slope, "rate.error": previous}
    if mode in ("velocity", "position"):
        force = -np.tan(_held(log, "theta0", steps[-1:] + 0.5 * PERIOD)[0]) * 0.4 * 6.3386
        e = _held(log, "v0", steps[-1:] + 0.5 * PERIOD)[0] - _held(log, "v", steps[-1:])[0]
        states["velocity.sum"] = float(force - gains.velocity[0] * e)
    return states
