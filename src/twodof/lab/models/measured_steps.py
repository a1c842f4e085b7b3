"""Steps of theta as they were flown, scaled to one size: what a page lays over the band that was predicted."""

from __future__ import annotations

from typing import Any

from twodof.errors import LogError
from twodof.flightlog.log import FlightLog
from twodof.lab.logbook.read_logs import kept_log
from twodof.report.step_responses import FlownStep, step_responses

SHOWN_S = 3.0
LEAST = 0.035
"""A smaller step [rad] is mostly noise once it is scaled."""
MOST_STEPS = 12


def measured_steps(path: str, goal: float) -> dict[str, Any]:
    """The last steps of the attitude's set-point in a log, each turned, moved and scaled to go from 0 to `goal` [rad].

    `time` [s] is from the step on, up to the next. `unclear` says why there are none in a log that tells no modes, or
    cannot be read.
    """
    try:
        log = kept_log(path)
        flown = [one for one in step_responses(log) if one.loop == "attitude"]
    except LogError as reason:
        return {"steps": [], "unclear": reason.what}
    ends = [*(one.time for one in flown[1:]), float("inf")]
    found = [
        _scaled(log, one, goal, min(SHOWN_S, end - one.time))
        for one, end in zip(flown, ends, strict=False)
        if abs(one.after - one.before) >= LEAST
    ]
    return {"steps": found[-MOST_STEPS:], "unclear": ""}


def _scaled(log: FlightLog, step: FlownStep, goal: float, shown: float) -> dict[str, Any]:
    factor = goal / (step.after - step.before)
    flown = log["theta"].slice(step.time, step.time + shown)
    figures = step.to_json()
    return {
        "at": step.time,
        "size": step.after - step.before,
        "time": [round(float(t - step.time), 4) for t in flown.time],
        "theta": [float(f"{(v - step.before) * factor:.5g}") for v in flown.value],
        "figures": {name: figures.get(name) for name in ("rise_time", "overshoot", "settling_time", "peak_moment")},
    }
