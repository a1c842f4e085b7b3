"""Check: a controller beside what is asked of it, figure by figure."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from twodof.design.margins import LoopMargins, margins
from twodof.design.synthesis.specification import Specification
from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.pitch_loop import PitchLoop
from twodof.design.uncertain.promise import Promise
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.errors import ParameterError

_HALF_POWER = math.sqrt(0.5)
_PROMISED = {"rise_time": "rise_time", "overshoot": "overshoot", "peak_moment": "peak_M"}


@dataclass(frozen=True)
class Requirement:
    """One figure: `asked`, at least or `at_most`, and what the controller has, `got`."""

    name: str
    asked: float
    got: float
    at_most: bool

    @property
    def met(self) -> bool:
        """Whether it is so; a figure that is not a number is not."""
        return self.got <= self.asked if self.at_most else self.got >= self.asked

    @property
    def text(self) -> str:
        """In a line."""
        way = "at most" if self.at_most else "at least"
        return (
            f"{'ok    ' if self.met else 'MISSED'} {self.name.replace('_', ' ')}: {self.got:.4g}, {way} {self.asked:g}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**vars(self), "got": self.got if math.isfinite(self.got) else None, "met": self.met}


def check(
    specification: Specification,
    controller: SampledController,
    family: PitchFamily,
    promised: Promise | None = None,
) -> tuple[Requirement, ...]:
    """What `specification` asks, in its order.

    Bandwidth and margins are those of the family's estimate. What a step is asked for is the `promised` interval's far
    end. Raises ParameterError where the step is asked for and `promised` is missing or of another step.
    """
    asked = specification.to_json()
    step = [name for name in _PROMISED if name in asked]
    if step and (promised is None or abs(promised.goal - math.radians(specification.step_deg)) > 1e-6):
        raise ParameterError(
            f"{', '.join(step)} are asked of a step by {specification.step_deg:g} deg, which is not promised",
            "check",
            "promise that step",
        )
    loop = PitchLoop(family.nominal(), controller)
    found: LoopMargins | None = None
    if any(name.endswith(("_margin", "_margin_db", "_margin_deg", "_sensitivity")) for name in asked):
        found = margins(loop.loop_transfer())
    rows = []
    for name, value in asked.items():
        if name == "step_deg":
            continue
        if name == "bandwidth":
            got = bandwidth(loop)
        elif name in _PROMISED and promised is not None:
            got = promised.figures[_PROMISED[name]][2] if promised.robust else math.nan
        elif found is not None:
            got = (found.ms if name == "peak_sensitivity" else getattr(found, name)) if found.stable else math.nan
        rows.append(Requirement(name, float(value), float(got), name in (*_PROMISED, "peak_sensitivity")))
    return tuple(rows)


def bandwidth(loop: PitchLoop) -> float:
    """The first frequency [rad/s] at which theta of the first member follows theta_0 by less than -3 dB."""
    omega = np.geomspace(0.01, 600.0, 3000)
    size = np.abs(loop.theta_response(omega)[0])
    below = np.flatnonzero(size < _HALF_POWER)
    return float(omega[below[0]]) if below.size else math.inf
