"""Content of a plot of a flight: curves in panels, and bands of modes, acts of the failsafe and excitations."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, printable
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES, named_causes
from twodof.flightlog.contents import excitations
from twodof.flightlog.events import MAX_EVENTS, modes
from twodof.flightlog.files import check_folder
from twodof.flightlog.log import Channel, FlightLog, decimate
from twodof.report.content import Span
from twodof.signals import BY_MAT, BY_NAME

Array = NDArray[np.float64]

PICTURES = (".png", ".svg", ".pdf")
"""Suffixes of pictures."""
SUFFIXES = (*PICTURES, ".html")
"""Suffixes of the files into which a flight can be drawn."""

MOST_POINTS = 4000
"""Most points of a line; a longer line is decimated to the lowest and highest sample of each bucket."""

MOST_BANDS = 200
"""Most bands above a plot, for modes, acts of the failsafe and excitations each."""

STILL = 0.02
"""A cart whose estimate moves by less than this [m] stands still: the range sensor has 4 mm of noise."""

_DEGREES = 180.0 / math.pi

PANELS = MappingProxyType(
    {
        "pitch": (_DEGREES, "deg", (("theta_true", "true"), ("theta", "estimated"), ("theta0", "set-point"))),
        "pitch rate": (_DEGREES, "deg/s", (("q_true", "true"), ("q", "estimated"), ("q0", "set-point"))),
        "position": (1.0, "m", (("x_true", "true"), ("x", "estimated"), ("x0", "set-point"))),
        "velocity": (1.0, "m/s", (("v_true", "true"), ("v", "estimated"), ("v0", "set-point"))),
        "motors": (1.0, "–", (("M", "moment M"), ("T", "thrust T"))),
    }
)
"""Panel -> scale, unit, and its channels with their names in the legend."""

SYMBOL = MappingProxyType({"pitch": "θ", "pitch rate": "q", "position": "x", "velocity": "v", "motors": "M, T"})

# A set-point is drawn where its loop is closed; elsewhere it says nothing.
_INNER = ("rate", "attitude", "velocity", "position")
_FOLLOWED = MappingProxyType({"q0": _INNER, "theta0": _INNER[1:], "v0": _INNER[2:], "x0": _INNER[3:]})


@dataclass(frozen=True, eq=False)
class Curve:
    """Samples of one signal, `time` (n,) [s] and `value` (n,), NaN where it is interrupted; `held` between samples."""

    label: str
    channel: str
    time: Array
    value: Array
    held: bool = False


@dataclass(frozen=True, eq=False)
class ExpectedBand:
    """Range in which a signal is expected: from `low` to `high`, each (n,), at `time` (n,) [s]."""

    label: str
    time: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class View:
    """One pair of axes: quantity and unit, its curves, and the band in which they are expected, if there is one."""

    label: str
    curves: tuple[Curve, ...]
    band: ExpectedBand | None = None


@dataclass(frozen=True)
class FlightView:
    """Content of a plot over `span` [s] of the time that `clock` names; `notes` name what is left out and why."""

    title: str
    about: str
    span: tuple[float, float]
    views: tuple[View, ...]
    modes: tuple[Span, ...] = ()
    failsafe: tuple[Span, ...] = ()
    excitations: tuple[Span, ...] = ()
    notes: tuple[str, ...] = ()
    clock: str = "the drone's time"


def check_place(path: str | Path, overwrite: bool = False, suffixes: Sequence[str] = SUFFIXES) -> None:
    """Check that a plot can be written there, before it is drawn. Raises LogError."""
    if Path(path).suffix.lower() not in suffixes:
        raise LogError(f"no picture has the suffix {Path(path).suffix!r}", str(path), f"use {', '.join(suffixes)}")
    check_folder(path, overwrite)


def flight_view(
    log: FlightLog, topics: Iterable[str] = (), window: tuple[float, float] | None = None, title: str = ""
) -> FlightView:
    """Return the view of a log, in `window` [s] if one is given.

    `topics` are names of signals, of their .mat channels or of channels that only this log has. By default the panels
    are pitch, rate, position, velocity and motor commands, with set-points and, if known, the truth. Raises LogError
    for a topic that the log lacks, and for a window in which nothing was logged.
    """
    span = _span(log, window)
    told = log.provenance.get("recovered")
    notes = [f"recovered from {told.get('from')!s:.80}: {told.get('what')!s:.400}"] if isinstance(told, dict) else []
    flown = _modes(log, span, notes)
    asked = list(topics)
    views = [_own(log, name, flown, span) for name in asked] if asked else _usual(log, flown, span, notes)
    if not views:
        raise LogError("nothing of a flight is in it", log.source or title, f"name topics: {', '.join(log)}")
    return FlightView(
        title=printable(title or log.source),
        about=_about(log),
        span=span,
        views=tuple({view.label: view for view in views}.values()),
        modes=_few("modes", flown, notes),
        failsafe=_few("acts of the failsafe", failsafe_bands(log, span), notes),
        excitations=_few("excitations", _excitations(log, span), notes),
        notes=tuple(map(printable, notes)),
    )


def _span(log: FlightLog, window: tuple[float, float] | None) -> tuple[float, float]:
    start, end = log.span
    if window is not None:
        if not window[0] < window[1] or window[1] <= start or window[0] >= end:
            what = f"nothing was logged from {window[0]:g} to {window[1]:g} s"
            raise LogError(what, log.source, f"the log reaches from {start:.3f} to {end:.3f} s")
        start, end = max(start, window[0]), min(end, window[1])
    return start, end


def _usual(log: FlightLog, flown: Sequence[Span], span: tuple[float, float], notes: list[str]) -> list[View]:
    cart = [name for name in ("x_true", "x") if name in log and len(log[name].slice(*span))]
    moved = any(float(np.ptp(log[name].slice(*span).value)) > STILL for name in cart[:1])
    views = []
    for name in PANELS:
        if name in ("position", "velocity") and cart and not moved:
            continue
        view = _panel(log, name, flown, span)
        if view.curves:
            views.append(view)
    if cart and not moved:
        notes.append("the cart stands still: position and velocity are left out")
    return views


def _own(log: FlightLog, name: str, flown: Sequence[Span], span: tuple[float, float]) -> View:
    """Return the panel of a requested signal: a usual one, or one of its own with a line for each field."""
    row = BY_NAME.get(name) or BY_MAT.get(name)
    channel = row.mat if row else name
    if channel not in log:
        raise LogError("the log does not have this signal", f"{log.source}: {name}", f"there are: {', '.join(log)}")
    for panel, (_, _, channels) in PANELS.items():
        if channel in (one for one, _ in channels):
            return _panel(log, panel, flown, span)
    there = log[channel]
    values = there.value if there.value.ndim == 2 else there.value[:, None]
    alone = (row.text if row else "",) if values.shape[1] == 1 else tuple(str(k) for k in range(values.shape[1]))
    labels = there.fields or alone
    held = row is not None and row.rate_hz == 0.0
    curves = tuple(
        Curve(printable(label), channel, *cut_curve(log, channel, there.time, values[:, k], span), held)
        for k, label in enumerate(labels)
    )
    unit = f" [{'–' if there.unit == '-' else there.unit}]" if there.unit else ""
    return View(printable(f"{row.name if row else channel}{unit}"), curves)


_SHOWN = MappingProxyType({"rad": (_DEGREES, "deg"), "rad/s": (_DEGREES, "deg/s"), "-": (1.0, "–")})


def signal_names(log: FlightLog) -> dict[str, tuple[str, str]]:
    """Return description and unit on the screen of each signal: a channel, or `CHANNEL/FIELD` of one with fields."""
    found = {}
    for name, channel in log.channels.items():
        row = BY_MAT.get(name)
        fields = channel.fields or tuple(map(str, range(channel.value.shape[1] if channel.value.ndim == 2 else 0)))
        for one in [f"{name}/{field}" for field in fields] or [name]:
            found[one] = (row.text if row else "", _SHOWN.get(channel.unit, (1.0, channel.unit.replace("^2", "²")))[1])
    return found


def signals_panel(log: FlightLog, names: Sequence[str], window: tuple[float, float] | None = None) -> View:
    """Return one panel with the signals `names`, as `signal_names` has them, without those that the log lacks.

    The unit is in the label if it is the same for all, else with each curve. Raises LogError as `flight_view` does.
    """
    known, span = signal_names(log), _span(log, window)
    there = [name for name in names if name in known]
    units = {known[name][1] for name in there}
    curves = []
    for name in there:
        channel = name if name in log else name.rpartition("/")[0]
        samples = log[channel]
        scale = _SHOWN.get(samples.unit, (1.0, ""))[0]
        value = samples.value if name == channel else _field(samples, name.rpartition("/")[2])
        row = BY_MAT.get(channel)
        held = channel in _FOLLOWED or channel in ("M", "T") or (row is not None and row.rate_hz == 0.0)
        unit = f" [{known[name][1]}]" if len(units) > 1 and known[name][1] else ""
        time, shown = cut_curve(log, channel, samples.time, scale * value, span)
        curves.append(Curve(printable(name + unit), name, time, shown, held))
    common = f" [{unit}]" if len(units) == 1 and (unit := units.pop()) else ""
    return View(printable(", ".join(there) + common), tuple(curves))


def _field(channel: Channel, name: str) -> Array:
    return channel.field(name) if channel.fields else channel.value[:, int(name)]


def _panel(log: FlightLog, name: str, flown: Sequence[Span], span: tuple[float, float]) -> View:
    scale, unit, channels = PANELS[name]
    curves = []
    for channel, label in channels:
        if channel not in log or not len(log[channel]):
            continue
        time, value = log[channel].time, scale * log[channel].value
        followed = channel in _FOLLOWED
        if followed and flown:
            value = _where(time, value, [band for band in flown if band.label in _FOLLOWED[channel]])
        time, value = cut_curve(log, channel, time, value, span)
        if np.isfinite(value).any():
            curves.append(Curve(label, channel, time, value, held=followed or name == "motors"))
    return View(f"{name} {SYMBOL[name]} [{unit}]", tuple(curves))


def _where(time: Array, value: Array, bands: Sequence[Span]) -> Array:
    """Return the values within the bands, NaN elsewhere."""
    inside = np.zeros(time.shape, dtype=bool)
    edges = np.searchsorted(time, np.array([(band.start, band.stop) for band in bands]).reshape(-1, 2))
    for start, stop in edges:
        inside[start:stop] = True
    return np.where(inside, value, np.nan)


def cut_curve(
    log: FlightLog, channel: str, time: Array, value: Array, span: tuple[float, float]
) -> tuple[Array, Array]:
    """Return the points within the span, interrupted by NaN where samples were lost, decimated to MOST_POINTS."""
    # A sample beyond each end, so that a line reaches the edge.
    first, last = np.searchsorted(time, span[0]) - 1, np.searchsorted(time, span[1], side="right") + 1
    part = slice(max(0, int(first)), int(last))
    time, value = time[part], value[part]
    before, after, _, _ = log.gap_table(channel)
    inside = (after > span[0]) & (before < span[1])
    if inside.any():
        at = np.searchsorted(time, after[inside])
        time = np.insert(time, at, 0.5 * (before[inside] + after[inside]))
        value = np.insert(value, at, np.nan)
    return decimate(time, value, MOST_POINTS)


def _few(what: str, bands: tuple[Span, ...], notes: list[str]) -> tuple[Span, ...]:
    """Return the first MOST_BANDS bands, with a note if there are more."""
    if len(bands) > MOST_BANDS:
        notes.append(f"only the first {MOST_BANDS} of {len(bands)} {what} are shown: draw a shorter window")
    return bands[:MOST_BANDS]


def _clipped(spans: Iterable[tuple[float, float, str]], span: tuple[float, float]) -> tuple[Span, ...]:
    """Return the parts of stretches of time (start, end, label) that are within `span`."""
    cut = ((max(start, span[0]), min(stop, span[1]), label) for start, stop, label in spans)
    return tuple(Span(*one) for one in cut if one[1] > one[0])


def _modes(log: FlightLog, span: tuple[float, float], notes: list[str]) -> tuple[Span, ...]:
    try:
        return _clipped(((one.t0, one.t1, one.mode) for one in modes(log)), span)
    except LogError as reason:  # of a log that has only some channels: the rest of it is shown
        notes.append(f"which mode flew is not known: {reason.what}")
        return ()


def _excitations(log: FlightLog, span: tuple[float, float]) -> tuple[Span, ...]:
    try:
        return _clipped(((one.edges[0], one.edges[-1], one.shape) for one in excitations(log)), span)
    except LogError:  # as `_modes`, which has said so
        return ()


def failsafe_bands(log: FlightLog, span: tuple[float, float] | None = None) -> tuple[Span, ...]:
    """Return the failsafe's acts within `span` [s] (None: the whole log) with their deciding causes.

    Motors that are off without a cause are those of a disarmed drone, not an act. Empty without the channel `safety`.
    """
    span = span if span is not None else log.span
    if "safety" not in log or "action" not in log["safety"].fields or not len(log["safety"]):
        return ()
    told = log["safety"]
    # Masks of 2^53 and more are not ours, and what is not a whole number neither.
    masked = "reasons" in told.fields
    why = told.field("reasons") if masked else told.field("reason") if "reason" in told.fields else -np.ones(len(told))
    states = np.clip(np.column_stack([told.field("action"), why]), -1.0, 2.0**53).astype(np.int64)
    starts = np.flatnonzero(np.append(True, (states[1:] != states[:-1]).any(axis=1)))
    if len(starts) > MAX_EVENTS:
        raise LogError(f"more than {MAX_EVENTS} acts of the failsafe", f"{log.source}: safety", "not a flight log")
    ends = [*told.time[starts[1:]].tolist(), log.span[1]]
    bands: list[Span] = []
    for k, end in zip(starts.tolist(), ends, strict=True):
        number, reason = states[k].tolist()
        causes = named_causes(max(reason, 0)) if masked else [CAUSES[reason].name] if 0 <= reason < len(CAUSES) else []
        if 0 < number < len(ACTIONS) and (said := ", ".join(causes)):
            label = f"{ACTIONS[number]}: {said.replace('_', ' ')}"
            start = float(told.time[k])
            if bands and (bands[-1].label, bands[-1].stop) == (label, start):  # of masks with bits that mean nothing
                start = bands.pop().start
            bands += _clipped([(start, end, label)], span)
    return tuple(bands)


def _about(log: FlightLog) -> str:
    """Return a line about the origin of a log."""
    said: dict[str, Any] = dict(log.provenance)
    drone, flown = said.get("drone"), said.get("flown")
    rig = said.get("rig") or (drone.get("rig") if isinstance(drone, dict) else None)
    parts = [str(said["experiment"])] if said.get("experiment") else []
    parts += [f"rig {rig}"] if rig else []
    parts += [f"seed {said['seed']}"] if said.get("seed") else []
    if isinstance(flown, dict):
        parts.append("flown over MAVLink")
        parts += [f"broken off: {flown['reason']}"] if flown.get("reason") else []
    return printable(", ".join(parts))[:200]
