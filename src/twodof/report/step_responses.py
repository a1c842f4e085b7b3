"""Step responses of a flight: rise, overshoot and settling of each step of a set-point."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.events import flown_steps, modes
from twodof.flightlog.log import Channel, FlightLog
from twodof.models.lti import StepFigures, step_figures
from twodof.signals import PERIOD

FOLLOWING = MappingProxyType({"rate": "q", "attitude": "theta", "velocity": "v", "position": "x"})
"""Channel that follows a loop's set-point, by mode, from the innermost loop to the outermost."""

SETTLED = 0.05
"""A response has settled within this share of the step: gusts and noise keep a real drone outside the usual 2 %."""

WINDOW_S = MappingProxyType({"rate": 3.0, "attitude": 3.0, "velocity": 4.0, "position": 8.0})
"""Longest response [s] from which figures are read, by loop: later than that a gust moves it, and not the step."""

# A set-point that is held for less leaves no response to read figures from; a sweep at 50 Hz has no steps.
_HELD_S = 0.25


@dataclass(frozen=True)
class FlownStep:
    """One step of the set-point of `loop` at `time` [s], from `before` to `after` (SI), and the response to it.

    `figures` are of the estimate that follows the set-point, until `end` [s]: the next step, an act of the failsafe, or
    `WINDOW_S` later. Times are in seconds from the step, overshoot is a share of it. `peak_moment` is the largest |M|
    in that time. Settling is to within `SETTLED`, of the mean of `averaged` responses: those of the loop's steps under
    the same parameters, each as a share of its step. So a gust, which moves each of them, moves it less.
    """

    loop: str
    time: float
    before: float
    after: float
    end: float
    figures: StepFigures
    peak_moment: float
    averaged: int = 1

    def to_json(self) -> dict[str, Any]:
        """Return plain data, with None for a figure that the response never reached."""
        rows = {k: v for k, v in asdict(self).items() if k != "figures"} | asdict(self.figures)
        return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in rows.items()}

    def scaled(self, log: FlightLog, goal: float) -> dict[str, Any]:
        """Return the response in `log` as plain data, scaled to go from 0 to `goal`; `time` is from the step [s]."""
        factor = goal / (self.after - self.before)
        flown, figures = log[FOLLOWING[self.loop]].slice(self.time, self.end), self.to_json()
        return {
            "at": self.time,
            "size": self.after - self.before,
            "time": [round(float(t - self.time), 4) for t in flown.time],
            "theta": [float(f"{(v - self.before) * factor:.5g}") for v in flown.value],
            "figures": {name: figures.get(name) for name in ("rise_time", "overshoot", "settling_time", "peak_moment")},
        }


def step_responses(log: FlightLog) -> tuple[FlownStep, ...]:
    """Return the responses to all `flown_steps`, by time; both levels were held for a quarter of a second.

    Raises LogError for a log without the channels of the mode.
    """
    found = []
    for loop in dict.fromkeys(stretch.mode for stretch in modes(log)):
        name = FOLLOWING.get(loop)
        if name is None or name not in log:
            continue
        for step, last in flown_steps(log, loop, _HELD_S):
            end = min(last, step.time + WINDOW_S[loop])
            measured = log[name].slice(step.time, end)
            if len(measured) < 2:
                continue
            figures = step_figures(measured.time - step.time, measured.value, step.before, step.after, SETTLED)
            found.append(
                FlownStep(loop, step.time, step.before, step.after, end, figures, _peak_moment(log, step.time, end))
            )
    return tuple(sorted(_with_mean_settling(log, found), key=lambda one: one.time))


@dataclass(frozen=True, eq=False)
class FoldedSteps:
    """Responses to a loop's steps under the same parameters, each as a share of its step: 0 before it, 1 its new level.

    `after_s` is the time [s] of the last change of a parameter before them, None without one. `shares` (k, n) at `time`
    (n,) [s] from the step are those that last as long as half of `steps`.
    """

    loop: str
    after_s: float | None
    steps: tuple[FlownStep, ...]
    time: NDArray[np.float64]
    shares: NDArray[np.float64]

    def statistics(self) -> dict[str, tuple[float, ...]]:
        """Return of each figure how many steps have it, its mean, standard deviation, least and greatest value."""
        figures = {
            "rise [s]": [one.figures.rise_time for one in self.steps],
            "overshoot [%]": [100.0 * one.figures.overshoot for one in self.steps],
            "peak |M|": [one.peak_moment for one in self.steps],
        }
        known = {name: np.array(values)[np.isfinite(values)] for name, values in figures.items()}
        return {
            name: (len(of), of.mean(), of.std(ddof=1) if len(of) > 1 else math.nan, of.min(), of.max())
            for name, of in known.items()
            if len(of)
        }

    def to_json(self, most: int) -> dict[str, Any]:
        """Return plain data with the last `most` responses, and mean and standard deviation of all."""
        return {
            "loop": self.loop,
            "after_s": self.after_s,
            "statistics": self.statistics(),
            "time": self.time.tolist(),
            "shares": self.shares[-most:].tolist(),
            "mean": self.shares.mean(axis=0).tolist(),
            "deviation": self.shares.std(axis=0, ddof=int(len(self.shares) > 1)).tolist(),
        }


def folded_steps(log: FlightLog, found: Sequence[FlownStep]) -> list[FoldedSteps]:
    """Lay steps, as `step_responses` returns them, over each other: by loop, and by the parameters that they flew."""
    changes = log.provenance.get("changes")
    rows = [row for row in changes if isinstance(row, list) and row] if isinstance(changes, list) else []
    changed = sorted(float(row[0]) for row in rows if isinstance(row[0], int | float))
    groups: dict[tuple[str, int], list[FlownStep]] = {}
    for one in found:
        groups.setdefault((one.loop, bisect_right(changed, one.time)), []).append(one)
    return [
        FoldedSteps(loop, changed[k - 1] if k else None, tuple(group), *_shares(log[FOLLOWING[loop]], group))
        for (loop, k), group in groups.items()
    ]


def _with_mean_settling(log: FlightLog, found: Sequence[FlownStep]) -> list[FlownStep]:
    """Replace the settling of each step by that of the mean response of its loop under the same parameters."""
    return [
        replace(one, figures=replace(one.figures, settling_time=settling), averaged=len(fold.shares))
        for fold in folded_steps(log, found)
        for settling in [step_figures(fold.time, fold.shares.mean(axis=0), 0.0, 1.0, SETTLED).settling_time]
        for one in fold.steps
    ]


def _shares(followed: Channel, group: Sequence[FlownStep]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times [s] and the responses (k, n) that last as long as half of them, each as a share of its step."""
    lasting = sorted(one.end - one.time for one in group)[(len(group) - 1) // 2]
    time = PERIOD * np.arange(int(lasting / PERIOD + 1e-6) + 1)
    shares = []
    for one in group:
        if one.end - one.time >= lasting - 1e-6:
            part = followed.slice(one.time, one.end)
            share = (part.value - one.before) / (one.after - one.before)
            shares.append(np.interp(time, part.time - one.time, share))
    return np.asarray(time, np.float64), np.array(shares, np.float64)


def _peak_moment(log: FlightLog, start: float, end: float) -> float:
    """Return the largest |M|, NaN without samples. M answers a set-point at once and is stamped a little before it."""
    if "M" not in log:
        return math.nan
    early = 0.5 * PERIOD
    moment = log["M"].slice(start - early, end - early).value
    return float(np.abs(moment).max()) if moment.size else math.nan


def most_stepped(responses: Sequence[FlownStep]) -> tuple[FlownStep, ...]:
    """Return the responses of the loop that was stepped most often; of several, of the outermost."""
    by_loop = [tuple(one for one in responses if one.loop == loop) for loop in reversed(FOLLOWING)]
    return max(by_loop, key=len)
