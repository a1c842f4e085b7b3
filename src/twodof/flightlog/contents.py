"""Table of contents of a log: channels, gaps, stretches with thrust, events, and the experiments found in it."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import islice, pairwise
from typing import Any

import numpy as np

from twodof.errors import LogError
from twodof.flightlog.events import (
    SETPOINTS,
    Event,
    Stretch,
    failsafe_acts,
    modes,
    openloop_edges,
    setpoint_steps,
    thrust_edges,
    window,
)
from twodof.flightlog.log import FlightLog, Gap
from twodof.flightlog.ulog_writer import OWN
from twodof.signals import BY_MAT, PERIOD

MAX_LISTED = 1000
"""Most gaps that are listed one by one."""

# A sweep is sent as a new set-point every 20 to 60 ms; nobody steps by hand that often.
_SWEEP_CHANGES = 20
_SWEEP_HOLD_S = 0.1
_SWEEP_PAUSE_S = 0.5
_SWEEP_SHARE = 0.1


@dataclass(frozen=True)
class DetectedExcitation:
    """An excitation found in a log: `name` is mode and shape, such as `attitude-steps`.

    `amplitude` is the largest distance from the first level, in the unit of `channel`. `edges` are the times of its
    steps [s]; of a sweep, of its first and last change. `window` is the time from shortly before the excitation to the
    end of the response [s].
    """

    name: str
    mode: str
    shape: str
    channel: str
    amplitude: float
    edges: tuple[float, ...]
    window: tuple[float, float]

    @property
    def duration(self) -> float:
        """Return the time from the first to the last edge [s]."""
        return self.edges[-1] - self.edges[0]


def excitations(log: FlightLog) -> list[DetectedExcitation]:
    """Return the excitations in a log, in order of time. An act of the failsafe ends one, and begins the next.

    Raises LogError if `T`, `q0` or `theta0` is missing.
    """
    found = []
    edges = openloop_edges(log) if "lmnf" in log else []
    for stretch, calm in _calm_stretches(log):
        excitation = _open_loop(log, stretch, edges) if stretch.mode == "open-loop" else _closed_loop(log, stretch)
        if excitation is not None:
            (start, stop), (first, last) = excitation.window, calm
            found.append(replace(excitation, window=(max(start, first), min(stop, last))))
    return found


def _calm_stretches(log: FlightLog) -> Iterator[tuple[Stretch, tuple[float, float]]]:
    """Yield the parts of the modes in which the failsafe does not act, with the times [s] of its acts around each."""
    # M of a step is stamped before that step's word of the failsafe, by less than half a period.
    acts = [(start - 0.5 * PERIOD, stop) for start, stop in failsafe_acts(log)]
    calm = [(stop, start) for (_, stop), (start, _) in pairwise([(-np.inf, -np.inf), *acts, (np.inf, np.inf)])]
    for stretch in modes(log):
        for k in range(bisect_right(calm, stretch.t0, key=lambda one: one[1]), len(calm)):
            start, stop = max(stretch.t0, calm[k][0]), min(stretch.t1, calm[k][1])
            if start >= stop:
                break
            yield Stretch(start, stop, stretch.mode), calm[k]


def find_excitation(log: FlightLog, name: str) -> DetectedExcitation:
    """Return the longest excitation called `name`: in full (`attitude-steps`) or by shape (`doublet`).

    Singular and plural find both. Raises LogError, with the names of those found, if there is none.
    """
    found = excitations(log)
    wanted = name.removesuffix("s")
    named = [one for one in found if wanted in (one.name.removesuffix("s"), one.shape.removesuffix("s"))]
    if not named:
        there = ", ".join(dict.fromkeys(one.name for one in found)) or "none"
        raise LogError(f"no excitation {name!r}", log.source, f"the log has: {there}")
    return max(named, key=lambda one: one.duration)


def describe(log: FlightLog) -> dict[str, Any]:
    """Return the table of contents of a log, as JSON values.

    Keys: `source`, `provenance`, `span_s`, `duration_s`; `channels` (name, unit, fields, samples, rate_hz, span_s,
    gaps, gaps_armed, missing, longest_gap_s); `gaps` (the first MAX_LISTED); `armed_s`; `modes`; `modes_unclear` (the
    reason why none could be found, or ""); `events`; `excitations`; `experiment` (the longest excitation, or None).
    An entry for which the log lacks the channels is an empty list.
    """
    gaps = {name: log.gap_table(name) for name in log}
    rows = ((name, zip(*(column[:MAX_LISTED].tolist() for column in gaps[name]), strict=True)) for name in gaps)
    listed = list(islice((Gap(name, *row) for name, table in rows for row in table), MAX_LISTED))
    start, end = log.span
    channels = []
    for name, channel in log.channels.items():
        period = channel.period()
        t0, t1, lost, armed = gaps[name]
        channels.append(
            {
                "name": name,
                "unit": channel.unit,
                "fields": list(channel.fields),
                "samples": len(channel),
                "rate_hz": 1.0 / period if np.isfinite(period) else None,
                "span_s": [float(channel.time[0]), float(channel.time[-1])] if len(channel) else None,
                "gaps": len(lost),
                "gaps_armed": int(armed.sum()),
                "missing": sum(lost.tolist()),
                "longest_gap_s": float(np.max(t1 - t0, initial=0.0)),
            }
        )
    loops = all(name in log for name in ("T", "q0", "theta0"))
    found: list[DetectedExcitation] = []
    flown: list[Stretch] = []
    unclear = "" if loops else "the log lacks T, q0 or theta0"
    try:
        flown, found = (modes(log), excitations(log)) if loops else ([], [])
    except LogError as reason:  # the channels of others may not overlap: all else about them still holds
        unclear = str(reason)
    return {
        "source": log.source,
        "provenance": log.provenance,
        "span_s": [start, end],
        "duration_s": end - start,
        "channels": channels,
        "gaps": [asdict(gap) for gap in listed],
        "armed_s": [list(stretch) for stretch in log.armed()] if "T" in log else [],
        "modes": [asdict(stretch) for stretch in flown],
        "modes_unclear": unclear,
        "events": [asdict(event) for event in _events(log, found)],
        "excitations": [asdict(excitation) for excitation in found],
        "experiment": asdict(max(found, key=lambda one: one.duration)) if found else None,
    }


def _events(log: FlightLog, found: Sequence[DetectedExcitation]) -> list[Event]:
    events = thrust_edges(log) if "T" in log else []
    if "lmnf" in log:
        events += openloop_edges(log)
    for channel in sorted({one.channel for one in found if one.channel in log and one.shape != "sweep"}):
        events += setpoint_steps(log, channel)
    return sorted(events, key=lambda event: event.time)


def _open_loop(log: FlightLog, stretch: Stretch, edges: Sequence[Event]) -> DetectedExcitation | None:
    # The message that opened the loop is up to 20 ms older than the first M made from it.
    first = bisect_left(edges, stretch.t0 - 0.02, key=lambda event: event.time)
    last = bisect_right(edges, stretch.t1, key=lambda event: event.time)
    steps = [event for event in edges[first:last] if event.channel == "lmnf.M"]
    if not steps:
        return None
    shape = _shape(steps, stretch.t1)
    start, stop = window(log, steps)
    # What levels the drone afterwards is not part of a doublet: ten times its moment, in the window's last samples.
    stop = min(stop, stretch.t1 - 0.5 * PERIOD)
    # An impulse is flown for the free response after it.
    return _excitation("open-loop", shape, steps, (start, stretch.t1 if shape == "impulse" else stop))


def _closed_loop(log: FlightLog, stretch: Stretch) -> DetectedExcitation | None:
    name = SETPOINTS.get(stretch.mode)
    if name is None or name not in log:
        return None
    channel = log[name].slice(stretch.t0, stretch.t1)
    changes = np.flatnonzero(np.diff(channel.value)) + 1
    # A set-point that is handed over with the mode is no step.
    changes = changes[channel.time[changes] > stretch.t0 + _SWEEP_HOLD_S]
    pauses = np.flatnonzero(np.diff(channel.time[changes]) > _SWEEP_PAUSE_S) + 1
    swept = max(np.split(changes, pauses), key=len)
    # A set-point that follows the drone, as while it is caught by hand, moves by millimetres.
    wide = swept.size > 0 and np.ptp(channel.value[swept]) > _SWEEP_SHARE * np.ptp(channel.value)
    if wide and swept.size > _SWEEP_CHANGES and np.median(np.diff(channel.time[swept])) < _SWEEP_HOLD_S:
        base = float(channel.value[swept[0] - 1])
        farthest = swept[np.argmax(np.abs(channel.value[swept] - base))]
        ends = [
            Event(float(channel.time[k]), "sweep", name, base, float(channel.value[farthest]))
            for k in (swept[0], swept[-1])
        ]
        return _excitation(stretch.mode, "sweep", ends, window(log, ends))
    part = FlightLog({name: channel}, log.provenance)
    steps = [event for event in setpoint_steps(part, name) if event.time > stretch.t0 + _SWEEP_HOLD_S]
    if not steps:
        return None
    return _excitation(stretch.mode, _shape(steps, stretch.t1), steps, window(log, steps))


def _excitation(mode: str, shape: str, steps: Sequence[Event], bounds: tuple[float, float]) -> DetectedExcitation:
    amplitude = max(abs(event.after - steps[0].before) for event in steps)
    edges = tuple(event.time for event in steps)
    return DetectedExcitation(f"{mode}-{shape}", mode, shape, steps[0].channel, amplitude, edges, bounds)


def _shape(steps: Sequence[Event], end: float) -> str:
    """Return "impulse", "doublet(s)", "3-2-1-1" or "steps", from the levels between the first and the last edge."""
    base = steps[0].before
    reach = max(abs(event.after - base) for event in steps)
    # Levels come back through float32: a thousandth of the amplitude is no level of its own.
    signs = [0 if abs(event.after - base) < 1e-3 * reach else int(np.sign(event.after - base)) for event in steps]
    lengths = [b - a for a, b in pairwise([event.time for event in steps] + [end])][: len(steps) - 1]
    inside, returned = signs[:-1], signs[-1] == 0
    if returned and len(inside) == 1 and lengths[0] < 1.0:
        return "impulse"
    alternate = all(a == -b != 0 for a, b in pairwise(inside))
    if not returned or len(inside) < 2 or len(inside) % 2 or not alternate:
        return "steps"
    unit = sum(lengths) / 7
    if len(inside) == 4 and np.allclose(lengths, [3 * unit, 2 * unit, unit, unit], rtol=0.15):
        return "3-2-1-1"
    return "doublet" if len(inside) == 2 else "doublets"


SPARK_COLUMNS = 96
_SPARKS = ("theta", "x", "q", "M")
_MOST_TEXT, _MOST_TUNED = 200, 6


def log_summary(log: FlightLog) -> dict[str, Any]:
    """Return a log's row of a list as plain data, with None for unknown fields, and a small curve of it."""
    start, end = log.span
    told = log.provenance
    flown, drone, recorded = (_table(told, name) for name in ("flown", "drone", "recorded"))
    return {
        "span": [start, end],
        "duration": end - start,
        "began": _short_text(recorded.get("began")),
        "experiment": _short_text(told.get("experiment")) or _likely(log),
        "rig": _short_text(told.get("rig")) or _short_text(drone.get("rig")),
        "virtual": _flag(flown.get("virtual"), drone.get("virtual")),
        "drone": drone.get("system") if isinstance(drone.get("system"), int) else None,
        "controller": _short_text(flown.get("controller")) or _short_text(drone.get("controller")),
        "tuned": _tuned(told.get("parameters", drone.get("parameters"))) if "ulog" not in told else [],
        "seed": told["seed"] if isinstance(told.get("seed"), int) else None,
        "reason": _short_text(flown.get("reason")),
        "channels": len(log.channels),
        "spark": _spark(log),
    }


def _table(told: dict[str, Any], name: str) -> dict[str, Any]:
    found = told.get(name)
    return found if isinstance(found, dict) else {}


def _tuned(parameters: object) -> list[list[Any]]:
    """Return name and value of parameters that differ from their defaults, `_MOST_TUNED` at most."""
    known = [*parameters.items()] if isinstance(parameters, dict) else []
    return [[str(name)[:80], value] for name, value in known if isinstance(value, int | float)][:_MOST_TUNED]


def _short_text(value: object) -> str | None:
    return value[:_MOST_TEXT] if isinstance(value, str) and value else None


def _flag(*values: object) -> bool | None:
    return next((value for value in values if isinstance(value, bool)), None)


def _likely(log: FlightLog) -> str | None:
    vehicle = _table(_table(log.provenance, "ulog"), "info").get("sys_name", OWN)
    with suppress(LogError):  # a log of others that lacks what tells it
        found = excitations(log) if vehicle == OWN else []  # PX4's set-points follow sticks and missions
        return max(found, key=lambda one: one.duration).name if found else None
    return None


def _spark(log: FlightLog) -> dict[str, Any] | None:
    """Return a small curve: the lowest and highest value of each of `SPARK_COLUMNS` parts, None for an empty part."""
    known = [name for name in (*_SPARKS, *log) if name in log and len(log[name]) > 1 and log[name].value.ndim == 1]
    if not known:
        return None
    channel = log[known[0]]
    start, end = log.span
    edges = np.searchsorted(channel.time, np.linspace(start, end, SPARK_COLUMNS + 1))
    edges[-1] = len(channel)
    parts = [channel.value[first:last] for first, last in pairwise(edges.tolist())]
    row = BY_MAT.get(known[0])
    return {
        "channel": known[0],
        "text": row.text if row else known[0],
        "unit": channel.unit,
        "low": [float(part.min()) if part.size else None for part in parts],
        "high": [float(part.max()) if part.size else None for part in parts],
    }
