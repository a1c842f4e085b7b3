"""Content of a plot of several flights, aligned at their first steps, or of a flight over the bands of a promise."""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from statistics import median
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from twodof.errors import LogError, printable
from twodof.flightlog.events import SETPOINTS
from twodof.flightlog.log import FlightLog
from twodof.parameters import PARAMETERS
from twodof.report.plots.flight_view import PANELS, SYMBOL, Curve, ExpectedBand, FlightView, View, cut_curve
from twodof.report.step_responses import FOLLOWING, FlownStep, most_stepped, step_responses

if TYPE_CHECKING:
    from twodof.design.promise import Promise

MOST_FLIGHTS = 6
"""Most flights in one picture: there are no more colours than that."""

_BEFORE_S, _AFTER_S = 0.5, 3.0
_PANEL_OF = {"rate": "pitch rate", "attitude": "pitch", "velocity": "velocity", "position": "position"}
_PROMISED: Mapping[str, tuple[str, float]] = {
    "theta": ("θ [deg]", 180.0 / math.pi),
    "q": ("q [deg/s]", 180.0 / math.pi),
    "M": ("M about its trim [–]", 1.0),
    "v": ("v [m/s]", 1.0),
    "x": ("x from where it was [m]", 1.0),
}
_MOST_NAMED = 3
"""Most parameters in the name of a flight."""
_DEFAULTS = {row.name: row.default for row in PARAMETERS if row.tuning}
_MOST_STEPS = 4
"""Most steps over the bands of a promise in one picture."""


class Align(StrEnum):
    """Time 0 of several flights: at the first step of a set-point, or at their starts."""

    step = "step"
    start = "start"


def flight_steps(logs: Mapping[str, FlightLog]) -> dict[str, tuple[FlownStep, ...]]:
    """Return the steps of each flight's loop that was stepped most often, by the flight's name.

    Raises LogError for a flight without a step, and for flights that stepped different loops.
    """
    found = {name: most_stepped(step_responses(log)) for name, log in logs.items()}
    for name, steps in found.items():
        if not steps:
            raise LogError(
                "no set-point steps in this flight", name, "compare flights with steps, or align them at their starts"
            )
    loops = {name: steps[0].loop for name, steps in found.items()}
    if len(set(loops.values())) > 1:
        told = ", ".join(f"{name}: {loop}" for name, loop in loops.items())
        raise LogError("their steps are of different loops", told, "compare flights of one kind")
    return found


def common_steps(logs: Mapping[str, FlightLog]) -> tuple[dict[str, tuple[FlownStep, ...]], str]:
    """Return `flight_steps` and "", or no steps and the reason why the flights cannot be aligned at them."""
    try:
        return flight_steps(logs), ""
    except LogError as reason:
        return {}, f"{reason.what} ({reason.where})"


def flight_names(logs: Mapping[str, FlightLog]) -> dict[str, str]:
    """Return a name for each flight by what differs among them: drone, controller and parameters, up to three.

    Parameters count if all flights tell them, with the values that a flight ended with. Flights that agree in these get
    the time at which they were recorded as well, or their key.
    """
    told = {key: _flown_with(log) for key, log in logs.items()}
    first, *others = told.values()
    differ = [name for name in first if any(first[name] != other.get(name, first[name]) for other in others)]
    differ = [name for name in differ if all(name in other for other in others)][:_MOST_NAMED]
    found = {key: ", ".join(_named(name, values[name]) for name in differ) for key, values in told.items()}
    for key in [key for key, name in found.items() if not name or [*found.values()].count(name) > 1]:
        recorded = logs[key].provenance.get("recorded")
        began = str(recorded.get("began") or "")[:19] if isinstance(recorded, dict) else ""
        found[key] = f"{found[key]}, {began or key}".removeprefix(", ")
    return found if len({*found.values()}) == len(found) else {key: key for key in logs}


def _flown_with(log: FlightLog) -> dict[str, float | str]:
    """Return drone and controller in words, and the values of the parameters that a flight ended with."""
    told, values = log.provenance, dict[str, float | str]()
    drone, changes = told.get("drone"), told.get("changes")
    if isinstance(drone, dict) and isinstance(drone.get("system"), int):
        values["drone"] = f"drone {drone['system']}"
    for source in (drone, told.get("flown")):
        if isinstance(source, dict) and isinstance(source.get("controller"), str):
            values["controller"] = f"{source['controller']} controller"
    parameters = told.get("parameters", drone.get("parameters") if isinstance(drone, dict) else None)
    rows = [*parameters.items()] if isinstance(parameters, dict) else []
    if isinstance(parameters, dict) and "ulog" not in told:  # these are the ones that differ from the defaults
        rows = [*_DEFAULTS.items(), *rows]
    made = changes if isinstance(changes, list) else []
    rows += [(row[1], row[2]) for row in made if isinstance(row, list) and len(row) == 3]
    return values | {str(name): value for name, value in rows if isinstance(value, int | float)}


def _named(name: str, value: float | str) -> str:
    return value if isinstance(value, str) else f"{name} {value:.4g}"


def comparison_view(
    logs: Mapping[str, FlightLog],
    align: Align = Align.step,
    window: tuple[float, float] | None = None,
    zero: Mapping[str, float] = MappingProxyType({}),
) -> FlightView:
    """Return the view of the flights `logs`, by their names in the legend, one over the other.

    `zero` has the time 0 [s] of flights that are aligned elsewhere, such as at a later step. `window` [s] counts from
    the alignment. The default is from half a second before the first step to three seconds after the last, or the whole
    flights. Raises LogError for fewer than two flights or more than `MOST_FLIGHTS`, for a
    window in which nothing was logged, and as `flight_steps` does.
    """
    if not 2 <= len(logs) <= MOST_FLIGHTS:
        raise LogError(f"{len(logs)} flights", "comparison", f"give 2 to {MOST_FLIGHTS}, each with a name of its own")
    notes = []
    if align is Align.step:
        steps = flight_steps(logs)
        loop = next(iter(steps.values()))[0].loop
        zero = {name: found[0].time for name, found in steps.items()} | dict(zero)
        first = min(found[0].time - zero[name] for name, found in steps.items())
        last = max(found[-1].time - zero[name] for name, found in steps.items())
        span = (first - _BEFORE_S, last + _AFTER_S)
        panels = list(dict.fromkeys((_PANEL_OF[loop], "pitch" if loop != "rate" else "pitch rate", "motors")))
        notes = [_figures(name, found) for name, found in steps.items()]
        clock = "time from the first step"
    else:
        zero = {name: log.span[0] for name, log in logs.items()} | dict(zero)
        span = (
            min(log.span[0] - zero[name] for name, log in logs.items()),
            max(log.span[1] - zero[name] for name, log in logs.items()),
        )
        panels, clock = ["position", "velocity", "pitch", "pitch rate", "motors"], "time from the start"
    if window is not None:
        if not window[0] < window[1]:
            raise LogError(f"window {window[0]:g} to {window[1]:g} s is empty", "comparison", "give T0 < T1")
        span = window
    views = [view for panel in panels if (view := _panel(panel, logs, zero, span)).curves]
    # A sample beyond each end is cut along, so that a line reaches the edge.
    seen = [(curve.time >= span[0]) & (curve.time <= span[1]) for view in views for curve in view.curves]
    if not any(inside.any() for inside in seen):
        raise LogError(f"nothing was logged from {span[0]:g} to {span[1]:g} s", "comparison", f"that is {clock}")
    return FlightView(
        title=printable(", ".join(logs)),
        about="",
        span=span,
        views=tuple(views),
        notes=tuple(map(printable, notes)),
        clock=clock,
    )


def _panel(name: str, logs: Mapping[str, FlightLog], zero: Mapping[str, float], span: tuple[float, float]) -> View:
    """Return the panel of each flight's followed channel with the first one's set-point; of the motors, M."""
    scale, unit, _ = PANELS[name]
    loop = next((loop for loop, panel in _PANEL_OF.items() if panel == name), "")
    channel = FOLLOWING.get(loop, "M")
    curves = []
    if loop:
        first = next(iter(logs))
        curves += _curve(logs[first], SETPOINTS[loop], "set-point", scale, zero[first], span, held=True)
    for flight, log in logs.items():
        curves += _curve(log, channel, printable(flight), scale, zero[flight], span, held=not loop)
    return View(f"{name} {SYMBOL[name]} [{unit}]" if loop else "moment M [–]", tuple(curves))


def _curve(
    log: FlightLog, channel: str, label: str, scale: float, zero: float, span: tuple[float, float], held: bool
) -> list[Curve]:
    if channel not in log or not len(log[channel]):
        return []
    there = log[channel]
    time, value = cut_curve(log, channel, there.time, scale * there.value, (span[0] + zero, span[1] + zero))
    return [Curve(label, channel, time - zero, value, held)]


def _figures(name: str, steps: Sequence[FlownStep]) -> str:
    """Return the medians over a flight's steps, in a line."""
    rise, settling, over = (
        _median([getattr(step.figures, figure) for step in steps])
        for figure in ("rise_time", "settling_time", "overshoot")
    )
    moment = _median([step.peak_moment for step in steps])
    return (
        f"{name}, median of {len(steps)} steps: rise {_said(rise, 's')}, overshoot {_said(100.0 * over, '%')}, "
        f"settling {_said(settling, 's')}, peak |M| {_said(moment, '')}"
    )


def _median(values: Sequence[float]) -> float:
    return median(values) if np.isfinite(values).all() else float("nan")


def _said(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".strip() if np.isfinite(value) else "not reached"


def step_rows(steps: Mapping[str, Sequence[FlownStep]]) -> list[tuple[str, ...]]:
    """Return a row of text for each step.

    Columns: flight, time [s], step, rise [s], overshoot [%], settling [s], peak, peak |M|. Settling of the mean
    response of several equal steps says of how many.
    """
    rows: list[tuple[str, ...]] = []
    for name, found in steps.items():
        for step in found:
            (scale, unit, _), figures = PANELS[_PANEL_OF[step.loop]], step.figures
            # A set-point of 0 may be logged as 1e-16.
            before, after = (round(scale * level, 9) + 0.0 for level in (step.before, step.after))
            change = f"{before:.3g} to {after:.3g} {unit}"
            shown = (
                _said(figures.rise_time, ""),
                _said(100.0 * figures.overshoot, ""),
                _said(figures.settling_time, "") + (f", mean of {step.averaged}" if step.averaged > 1 else ""),
                f"{scale * figures.peak:.3g}",
                _said(step.peak_moment, ""),
            )
            rows.append((printable(name), f"{step.time:.2f}", change, *shown))
    return rows


def promise_view(made: "Promise", log: FlightLog | None = None) -> FlightView:
    """Return the view of a promise's bands and, with `log`, of its first promised steps, each from its own start.

    Raises ParameterError as the promise's `steps_of`, LogError where channels are missing.
    """
    time = made.time
    flown = [] if log is None else made.steps_of(log)[:_MOST_STEPS]
    step, stepped = made.step, made.step.follows
    about = f"a step of {step.setpoint} by {step.factor * made.goal:g} {step.unit}"
    shown = (stepped, *(name for name in step.channels if name != stepped))
    views = []
    for name in shown:
        label, factor = _PROMISED[name]
        curves = [Curve("expected", name, time, factor * made.middle[name])]
        curves += [
            Curve(f"step {number}" if len(flown) > 1 else "flown", name, at, factor * signals[name])
            for number, (at, signals) in enumerate(flown, 1)
        ]
        if name == stepped:
            curves.append(Curve("set-point", name, time, np.full(time.size, factor * made.goal)))
        band = ExpectedBand(
            f"{100.0 * made.level:g} % of flights", time, factor * made.low[name], factor * made.high[name]
        )
        views.append(View(label, tuple(curves), band))
    return FlightView(
        title=f"{made.controller}: {'promised' if log is None else 'promised and flown'}",
        about=f"{about}; {made.members} members of the identified family",
        span=(float(flown[0][0][0]) if flown else 0.0, float(time[-1])),
        views=tuple(views),
        clock="time from the step",
    )
