"""What a plot of a promise shows: its bands, what is expected in their middle, and the steps that were flown."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.design.promise import Promise
from twodof.flightlog.log import FlightLog
from twodof.report.plots.flight_view import Curve, ExpectedBand, FlightView, View

Array = NDArray[np.float64]

_PANELS: Mapping[str, tuple[str, float]] = {
    "theta": ("θ [deg]", 180.0 / math.pi),
    "q": ("q [deg/s]", 180.0 / math.pi),
    "M": ("M about its trim [–]", 1.0),
    "v": ("v [m/s]", 1.0),
    "x": ("x from where it was [m]", 1.0),
}
_MOST_STEPS = 4
"""In one picture; more lines than that are a carpet."""


def promise_view(made: Promise, log: FlightLog | None = None) -> FlightView:
    """The bands of `made` and, with `log`, the first steps of it that were promised, each from its own start.

    Raises ParameterError as the promise's `steps_of`, LogError where channels are missing.
    """
    time = made.time
    flown = [] if log is None else made.steps_of(log)[:_MOST_STEPS]
    step, stepped = made.step, made.step.follows
    about = f"a step of {step.setpoint} by {step.factor * made.goal:g} {step.unit}"
    shown = (stepped, *(name for name in step.channels if name != stepped))
    views = []
    for name in shown:
        label, factor = _PANELS[name]
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
        modes=(),
        failsafe=(),
        excitations=(),
        notes=(),
        clock="time from the step",
    )
