"""What a plot of a promise shows: its bands, what is expected in their middle, and the steps that were flown."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.design.uncertain.promise import Promise
from twodof.design.uncertain.step_statistics import TRIM
from twodof.flightlog.log import FlightLog
from twodof.report.plots.flight_view import Curve, ExpectedBand, FlightView, View
from twodof.signals import PERIOD

Array = NDArray[np.float64]

_PANELS: Mapping[str, tuple[str, float]] = {
    "theta": ("θ [deg]", 180.0 / math.pi),
    "q": ("q [deg/s]", 180.0 / math.pi),
    "M": ("M about its trim [–]", 1.0),
}
_MOST_STEPS = 4
"""In one picture; more lines than that are a carpet."""


def promise_view(made: Promise, log: FlightLog | None = None) -> FlightView:
    """The bands of `made` and, with `log`, the first steps of it that were promised, each from its own start.

    Raises ParameterError as `Promise.steps_of`, LogError where channels are missing.
    """
    time = made.time
    flown = [] if log is None else made.steps_of(log)[:_MOST_STEPS]
    views = []
    for name, (label, factor) in _PANELS.items():
        curves = [Curve("expected", name, time, factor * made.middle[name])]
        curves += [
            Curve(f"step {number}" if len(flown) > 1 else "flown", name, at, factor * signals[name])
            for number, (at, signals) in enumerate(flown, 1)
        ]
        if name == "theta":
            curves.append(Curve("set-point", name, time, np.full(time.size, factor * made.goal)))
        band = ExpectedBand(
            f"{100.0 * made.level:g} % of flights", time, factor * made.low[name], factor * made.high[name]
        )
        views.append(View(label, tuple(curves), band))
    return FlightView(
        title=f"{made.controller}: {'promised' if log is None else 'promised and flown'}",
        about=f"a step of θ by {math.degrees(made.goal):g} deg; {made.members} members of the identified family",
        span=(-TRIM * PERIOD * bool(flown), float(time[-1])),
        views=tuple(views),
        modes=(),
        failsafe=(),
        excitations=(),
        notes=(),
        clock="time from the step",
    )
