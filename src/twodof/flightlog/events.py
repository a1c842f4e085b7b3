"""Events of a flight (thrust switched, set-points stepped, loop opened), and the stretches of each mode."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.log import MAX_STRETCHES, FlightLog
from twodof.signals import MODES, OFF, OPEN_LOOP, PERIOD, POSITION

# A set-point that comes from outside is sent at 50 Hz and held for 20 ms or more; one that a loop computes
# changes with its measurement, at 250 Hz or, from x and v, at 100 Hz (intervals up to 13.5 ms).
HELD_S = 0.015
# Shorter stretches are transients of a switch-over, not a mode that somebody flew.
SHORTEST_MODE_S = 0.1
# The message and M reach the log in float32 and float64: half a unit in the last place of float32 at 1.
_SAME_M = 1e-7

MAX_EVENTS = 100_000
"""Most events of one kind: one a second in a flight of a day."""

SETPOINTS = {"rate": "q0", "attitude": "theta0", "velocity": "v0", "position": "x0"}
"""Channel of a closed loop's set-point, by mode."""


@dataclass(frozen=True)
class Event:
    """Change of a channel at `time` [s] from `before` to `after`; `kind` is "thrust on", "step", "loop opened", ..."""

    time: float
    kind: str
    channel: str
    before: float
    after: float


@dataclass(frozen=True)
class Stretch:
    """A time from `t0` to `t1` [s] flown in one mode of twodof.signals.MODES."""

    t0: float
    t1: float
    mode: str

    @property
    def duration(self) -> float:
        """Return the length [s]."""
        return self.t1 - self.t0


def thrust_edges(log: FlightLog) -> list[Event]:
    """Return the switches of the thrust. Raises LogError without channel `T`."""
    channel = log["T"]
    edges = np.flatnonzero(np.diff((channel.value > 0.0).astype(np.int8))) + 1
    _check_count(edges.size, "changes of the thrust", f"{log.source}: T")
    kinds = ["thrust on" if on else "thrust off" for on in channel.value[edges] > 0.0]
    return [_event(channel.time, channel.value, kind, "T", k) for kind, k in zip(kinds, edges, strict=True)]


def _event(time: NDArray[np.float64], value: NDArray[np.float64], kind: str, name: str, at: np.intp) -> Event:
    """Return the change to sample `at` from the sample before it."""
    return Event(float(time[at]), kind, name, float(value[at - 1]), float(value[at]))


def setpoint_steps(log: FlightLog, name: str, held_s: float = 0.1) -> list[Event]:
    """Return the steps of a set-point between levels that were each held for `held_s` [s] or more. Raises LogError."""
    channel = log[name]
    if len(channel) < 2:
        return []
    first = _run_starts(channel.value)
    ends = np.append(channel.time[first[1:]], channel.time[-1])
    levels = first[ends - channel.time[first] >= held_s]
    _check_count(levels.size, "steps", f"{log.source}: {name}")
    return [
        Event(float(channel.time[b]), "step", name, float(channel.value[a]), float(channel.value[b]))
        for a, b in pairwise(levels)
        if channel.value[b] != channel.value[a]
    ]


def failsafe_acts(log: FlightLog) -> list[tuple[float, float]]:
    """Return the times (start, end) [s] at which the failsafe acts; none for a log without the channel `safety`."""
    if "safety" not in log or "action" not in log["safety"].fields or not len(log["safety"]):
        return []
    time, acts = log["safety"].time, log["safety"].field("action") > 0.0
    starts = _run_starts(acts)
    _check_count(starts.size, "acts of the failsafe", f"{log.source}: safety")
    ends = np.append(time[starts[1:]], max(time[-1], log.span[1]))
    return [(float(time[a]), float(end)) for a, end in zip(starts, ends, strict=True) if acts[a]]


def flown_steps(log: FlightLog, mode: str, held_s: float = 0.1) -> list[tuple[Event, float]]:
    """Return the steps of the set-point of `mode` that were asked for and flown, each with the end [s] of its response.

    Both levels were held for `held_s` [s], in this mode. What the failsafe flies does not count. The return to the
    set-point after it does not count either. The response ends at the next step, with the mode, or where the failsafe
    acts. Raises LogError.
    """
    acts, found = failsafe_acts(log), list[tuple[Event, float]]()
    if SETPOINTS[mode] not in log:  # PX4 logs the set-points of some loops, and its mode
        return found
    steps = setpoint_steps(log, SETPOINTS[mode], held_s)
    for stretch in modes(log):
        if stretch.mode != mode:
            continue
        inside = [step for step in steps if stretch.t0 < step.time < stretch.t1]
        ends = [*(step.time for step in inside[1:]), stretch.t1]
        for step, end in zip(inside, ends, strict=False):
            # A set-point is stamped some microseconds after the word of the failsafe in the same step.
            if not any(start - PERIOD <= step.time <= stop + PERIOD for start, stop in acts):
                found.append((step, min([end, *(start for start, _ in acts if start > step.time)])))
    return found


def steps_by(log: FlightLog, mode: str, size: float, lasting: float, tolerance: float = 0.05) -> list[Event]:
    """Return the `flown_steps` by `size`, up or down, whose response lasts for `lasting` [s] or more.

    `tolerance` is a share of the size. Raises LogError.
    """
    return [
        step
        for step, end in flown_steps(log, mode)
        if abs(abs(step.after - step.before) - size) <= tolerance * size and end - step.time >= lasting
    ]


def openloop_edges(log: FlightLog) -> list[Event]:
    """Return the open-loop messages that opened or closed the loop, or changed M or T while it was open.

    Each event has the time of its message; M follows one or two samples later. Raises LogError without `lmnf`.
    """
    channel = log["lmnf"]
    opened = channel.field("openloop") > 0.0
    found = []
    for k in np.flatnonzero(opened != np.append(False, opened[:-1])):
        kind = "loop opened" if opened[k] else "loop closed"
        found.append(Event(float(channel.time[k]), kind, "lmnf.openloop", float(not opened[k]), float(opened[k])))
        _check_count(len(found), "openings", f"{log.source}: lmnf")
    for part in ("M", "T"):
        value = channel.field(part)
        changed = np.flatnonzero(opened[1:] & opened[:-1] & (value[1:] != value[:-1])) + 1
        _check_count(changed.size, "steps", f"{log.source}: lmnf")
        found += [_event(channel.time, value, "step", f"lmnf.{part}", k) for k in changed]
    return sorted(found, key=lambda event: event.time)


def modes(log: FlightLog) -> list[Stretch]:
    """Return the stretches of each mode, in order and without holes, on the set-points' time stamps.

    The channel `mode` decides if the log has it. Otherwise the mode is found from other channels. The loop is open
    where M equals that of the latest open-loop message or, without such messages, where M stands still. The mode is off
    where thrust is off. Of the loops, the closed one has a held set-point, since a loop computes the set-points below
    it at every sample. A stretch under 0.1 s joins the one before. Raises LogError without `T`, `q0` or `theta0`.
    """
    if "mode" in log:
        time, code = log["mode"].time, log["mode"].value.astype(np.intp)
        if code.size and (code.min() < 0 or code.max() >= len(MODES)):
            what = f"mode numbers from {code.min()} to {code.max()} are out of range"
            raise LogError(what, f"{log.source}: mode", f"give 0 to {len(MODES) - 1}")
    else:
        time, code = log["q0"].time, _mode_codes(log)
    if not time.size:
        raise LogError("no set-point was logged", f"{log.source}: q0", "give a log with samples of q0")
    starts = _run_starts(code)
    _check_count(starts.size, "changes of the mode", log.source)
    ends = np.append(time[starts[1:]], time[-1])
    merged: list[Stretch] = []
    for start, end in zip(starts, ends, strict=True):
        mode = MODES[code[start]]
        brief = end - time[start] < SHORTEST_MODE_S and "mode" not in log
        if merged and (brief or merged[-1].mode == mode):
            merged[-1] = Stretch(merged[-1].t0, float(end), merged[-1].mode)
        elif merged and merged[-1].duration < SHORTEST_MODE_S and "mode" not in log:
            merged[-1] = Stretch(merged[-1].t0, float(end), mode)
        else:
            merged.append(Stretch(float(time[start]), float(end), mode))
    if len(merged) > MAX_STRETCHES:
        raise LogError(
            f"{len(merged)} stretches of one mode", log.source, "this is not a flight log: give another file"
        )
    return merged


def mode_at(log: FlightLog, time: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the mode (n,) at each `time` (n,) [s], as an index into `signals.MODES`; outside of `modes` it is "off".

    A step's set-points are stamped some microseconds after its M: ask half a period after M's stamp. Raises as `modes`.
    """
    found = np.full(time.shape, OFF, dtype=np.int32)
    for stretch in modes(log):
        found[(time >= stretch.t0) & (time < stretch.t1)] = MODES.index(stretch.mode)
    return found


def window(log: FlightLog, events: Sequence[Event], before: float = 0.3, after: float = 2.0) -> tuple[float, float]:
    """Return the window (start, end) from `before` the first event to `after` the last [s], in the stretch with thrust.

    Without thrust the ends of the log bound it instead. Raises LogError without an event.
    """
    if not events:
        raise LogError("no event to put a window around", log.source, "describe(log) lists the log's events")
    first, last = events[0].time, events[-1].time
    start, end = log.span
    armed = log.armed()
    at = bisect_right(armed, (first, np.inf)) - 1
    if at >= 0 and armed[at][0] <= first <= armed[at][1]:
        start, end = armed[at]
    return max(first - before, start), min(last + after, end)


def _mode_codes(log: FlightLog) -> NDArray[np.intp]:
    time = log["q0"].time
    on = np.zeros(time.shape, dtype=bool)
    stretches = np.array(log.armed()).reshape(-1, 2)
    # T's sample is a few microseconds older than the set-points' of the same step.
    ends = np.searchsorted(time, stretches[:, 1] + HELD_S / 5, side="right")
    for start, end in zip(np.searchsorted(time, stretches[:, 0]), ends, strict=True):
        on[start:end] = True
    held = {mode: _held(log, channel, time) for mode, channel in SETPOINTS.items()}
    code = np.select(
        [~on, held["rate"], held["attitude"], held["velocity"]],
        [MODES.index(mode) for mode in ("off", "rate", "attitude", "velocity")],
        POSITION,
    )
    return np.where(_open(log, time, on), OPEN_LOOP, code)


def _held(log: FlightLog, name: str, time: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return True for the times in a run of equal values of HELD_S or more; for all if the set-point is not logged."""
    if name in ("v0", "x0") and name not in log:
        return np.ones(time.shape, dtype=bool)
    channel = log[name]
    if not len(channel):
        return np.ones(time.shape, dtype=bool)
    starts = _run_starts(channel.value)
    ends = np.append(channel.time[starts[1:]], np.inf)
    long = ends - channel.time[starts] >= HELD_S
    run = np.searchsorted(channel.time[starts], time, side="right") - 1
    return np.where(run >= 0, long[np.maximum(run, 0)], long[0])


def _open(log: FlightLog, time: NDArray[np.float64], on: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return True for the times at which the loop is open: M equals that of the last message of the last 0.5 s.

    Without logged messages, the loop is open where M stands still, as no closed loop's does, with thrust or M not 0.
    """
    if "M" not in log or not len(log["M"]):
        return np.zeros(time.shape, dtype=bool)
    if "lmnf" not in log or not len(log["lmnf"]):
        now = log["M"].value[np.maximum(log["M"].index(time), 0)]
        still: NDArray[np.bool_] = _held(log, "M", time) & (on | (now != 0.0))
        return still
    message, moment = log["lmnf"], log["M"]
    # M's sample is 3 to 36 us older than the set-points'; the message before that sample made it.
    sample = moment.index(time)
    made = message.index(moment.time[np.maximum(sample, 0)])
    said = message.value[np.maximum(made, 0)]
    opened = said[:, message.fields.index("openloop")] > 0.0
    same = np.abs(moment.value[np.maximum(sample, 0)] - said[:, message.fields.index("M")]) <= _SAME_M
    return opened & same & (sample >= 0) & (made >= 0)


def _check_count(count: int, what: str, where: str) -> None:
    if count > MAX_EVENTS:
        raise LogError(f"more than {MAX_EVENTS} {what}", where, "this is not a flight log: give another file")


def _run_starts(values: NDArray[np.generic]) -> NDArray[np.intp]:
    """Return the index of the first of each run of equal values."""
    return np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1)).astype(np.intp)
