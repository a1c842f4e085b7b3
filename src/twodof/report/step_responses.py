"""Step responses of a flight: rise, overshoot and settling of each step of a set-point."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.flightlog.events import SETPOINTS, modes, setpoint_steps
from twodof.flightlog.log import FlightLog
from twodof.models.lti import StepFigures, step_figures
from twodof.signals import PERIOD

FOLLOWING = MappingProxyType({"rate": "q", "attitude": "theta", "velocity": "v", "position": "x"})
"""Channel that follows a loop's set-point, by mode, from the innermost loop to the outermost."""

SETTLED = 0.05
"""A response has settled within this share of the step: gusts and noise keep a real drone outside the usual 2 %."""

# A set-point that is held for less leaves no response to read figures from; a sweep at 50 Hz has no steps.
_HELD_S = 0.25


@dataclass(frozen=True)
class FlownStep:
    """One step of the set-point of `loop` at `time` [s], from `before` to `after` (SI), and the response to it.

    `figures` are of the estimate that follows the set-point, until the next step. Times are in seconds from the step,
    settling is to within `SETTLED`, overshoot a share of it. `peak_moment` is the largest |M| in that time.
    """

    loop: str
    time: float
    before: float
    after: float
    figures: StepFigures
    peak_moment: float

    def to_json(self) -> dict[str, Any]:
        """Return plain data, with None for a figure that the response never reached."""
        rows = {k: v for k, v in asdict(self).items() if k != "figures"} | asdict(self.figures)
        return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in rows.items()}


def step_responses(log: FlightLog) -> tuple[FlownStep, ...]:
    """Return the responses to all steps of set-points that were in use, by time.

    A step counts if its loop was the outermost closed one and both levels were held for a quarter of a second. Raises
    LogError for a log without the channels of the mode.
    """
    found = []
    for stretch in modes(log):
        name = FOLLOWING.get(stretch.mode)
        if name is None or name not in log:
            continue
        wanted = SETPOINTS[stretch.mode]
        steps = [step for step in setpoint_steps(log, wanted, _HELD_S) if stretch.t0 < step.time < stretch.t1]
        ends = [step.time for step in steps[1:]] + [stretch.t1] * bool(steps)
        for step, end in zip(steps, ends, strict=True):
            measured = log[name].slice(step.time, end)
            if len(measured) < 2:
                continue
            figures = step_figures(measured.time - step.time, measured.value, step.before, step.after, SETTLED)
            peak = _peak_moment(log, step.time, end)
            found.append(FlownStep(stretch.mode, step.time, step.before, step.after, figures, peak))
    return tuple(found)


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
