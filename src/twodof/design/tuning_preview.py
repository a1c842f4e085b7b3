"""TuningPreview: the effect of gains on an identified family before they are sent; PitchLaw: the law that flies."""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.schema.json_form import from_json
from twodof.design.margins import LoopMargins, margins
from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import PITCH_LOOPS, PitchLoop, pitch_loops
from twodof.design.promise import (
    CHANNELS,
    GOAL,
    LEVEL,
    SIDES,
    Promise,
    bounded,
    interval,
    promise,
    simulated_steps,
    step_bands,
)
from twodof.design.robustness import Robustness, robustness
from twodof.design.sampled_controller import SampledController
from twodof.errors import ParameterError, finite
from twodof.flight.gains import Gains
from twodof.flight.templates import ATTITUDE
from twodof.signals import PERIOD

Array = NDArray[np.float64]

SETTLED = 0.05
"""Share of the step: a response that stays this near its set-point has settled."""

SHOWN: Mapping[str, float] = {"theta": math.pi, "q": 50.0, "M": 5.0}
"""Where a band is cut off [rad, rad/s, -]: beyond it an unstable loop draws nothing that a person could read."""

_FIGURES = ("rise_time", "overshoot", "settling_time", "peak_q", "peak_M")


@dataclass(frozen=True, eq=False)
class TuningPreview:
    """Preview of `gains` on a family: `loops`, bands of a step of theta by `goal` [rad], its figures, and the verdict.

    `gains` is None for a controller other than the stock cascade. `loops` has the margins of the estimate at each of
    `PITCH_LOOPS`, for another controller those at the motors alone. `low`, `middle` and `high` are bands of `CHANNELS`,
    (steps,) at the times `time` [s] from the step on: a share `level` of flights stays inside all the time. `figures`
    has intervals (low, middle, high) with the same share: rise_time [s], overshoot (a share), settling_time [s],
    peak_q [rad/s], peak_M. The settling time is that without gusts and noise; a time that is never reached is infinite.
    """

    gains: Gains | None
    goal: float
    level: float
    members: int
    loops: Mapping[str, LoopMargins]
    time: Array = field(repr=False)
    low: Mapping[str, Array] = field(repr=False)
    middle: Mapping[str, Array] = field(repr=False)
    high: Mapping[str, Array] = field(repr=False)
    figures: Mapping[str, tuple[float, float, float]]
    verdict: Robustness

    def to_json(self) -> dict[str, Any]:
        """Return plain data with lists for arrays; an infinite number is null."""
        return {
            "gains": None if self.gains is None else self.gains.to_json(),
            "goal": self.goal,
            "level": self.level,
            "members": self.members,
            "loops": {name: finite(_told(loop)) for name, loop in self.loops.items()},
            "time": _rounded(self.time),
            "bands": {name: {side: _rounded(getattr(self, side)[name]) for side in SIDES} for name in CHANNELS},
            "figures": {name: finite(dict(zip(SIDES, row, strict=True))) for name, row in self.figures.items()},
            "verdict": {**self.verdict.to_json(), "text": self.verdict.text},
        }


def tuning_preview(
    family: PitchFamily,
    law: Gains | SampledController,
    *,
    members: int = 200,
    seed: int = 1,
    goal: float = GOAL,
    progress: Callable[[float], None] = lambda share: None,
) -> TuningPreview:
    """Return a preview of the pitch loops of `family` under `law`: margins, a step by `goal` [rad], and the verdict.

    `law` is the gains of the stock cascade, or any controller of the pitch, for which only the margins at the motors
    are given. `family` is that of a model file: `PitchFamily.from_identified(json)`. The same `seed` draws the same
    members and gusts, so two calls with other gains differ by the gains alone. `progress` is called with the share
    done, some ten times a second; an exception from it ends the work. Raise ParameterError for numbers out of range.
    """
    gains = law if isinstance(law, Gains) else None
    if isinstance(law, Gains):
        controller = SampledController.of_cascade(*law.rate, law.attitude)
        broken = pitch_loops(family.nominal(), law)
    else:
        controller = law
        broken = {PITCH_LOOPS[0]: PitchLoop(family.nominal(), controller).loop_transfer()}
    made = promise(
        controller, family, goal=goal, members=members, seed=seed, name="preview", progress=lambda s: progress(0.5 * s)
    )
    settled = _settling(family, controller, made, lambda s: progress(0.5 + 0.2 * s))
    every = {**made.figures, "settling_time": interval(settled, LEVEL)}
    loops = {}
    for k, (name, loop) in enumerate(broken.items()):
        progress(0.7 + 0.1 * k / len(PITCH_LOOPS))
        loops[name] = margins(loop)
    sure = robustness(controller, family, seed=seed, progress=lambda s: progress(0.8 + 0.2 * s))
    band = [_cut(side) for side in (made.low, made.middle, made.high)]
    figures = {name: every[name] for name in _FIGURES}
    return TuningPreview(gains, goal, LEVEL, members, loops, made.time, band[0], band[1], band[2], figures, sure)


def _cut(side: Mapping[str, Array]) -> dict[str, Array]:
    return {name: np.clip(rows, -SHOWN[name], SHOWN[name]) for name, rows in side.items()}


def _settling(
    family: PitchFamily, controller: SampledController, made: Promise, progress: Callable[[float], None]
) -> Array:
    """Return each member's settling time [s] without gust and noise; infinite if it is longer than the time shown."""
    loop = PitchLoop(family.draw(made.members, made.seed), controller, family.gust_time)
    with np.errstate(over="ignore", invalid="ignore"):
        theta, _, _ = loop.simulate(np.full(len(made.time), made.goal), progress=progress)
        outside = ~(np.abs(theta / made.goal - 1.0) <= SETTLED)
    last = len(theta) - np.argmax(outside[::-1], axis=0)
    return np.where(outside.any(axis=0), np.where(outside[-1], np.inf, last * PERIOD), 0.0)


def _told(loop: LoopMargins) -> dict[str, Any]:
    """Return the part of `LoopMargins.to_json` that the page shows."""
    kept = loop.to_json()
    return {name: value for name, value in kept.items() if name not in ("gain_crossings", "phase_crossings", "poles")}


def _rounded(values: Array) -> list[float]:
    """Return the values with five digits, as shown and sent."""
    scale = 10.0 ** (4.0 - np.floor(np.log10(np.maximum(np.abs(values), 1e-9))))
    rounded: list[float] = (np.rint(values * scale) / scale).tolist()
    return rounded


GAINS = ("RATE_KP", "RATE_KI", "RATE_KD", "ATT_KP")
"""Parameters of the stock pitch law that a preview can change."""

SURE = 200
"""Members that fly in a preview."""

QUICK = 60
"""Members that fly for the step alone, while a slider moves."""


@dataclass(frozen=True, eq=False)
class PitchLaw:
    """The pitch law of a drone: `controller` has its matrices, `parameters` the names of the parameters that tune it.

    `gains` are those of the stock law; they are None for a user's controller, called `name`.
    """

    name: str
    controller: SampledController
    gains: Gains | None
    parameters: frozenset[str]

    @classmethod
    def flown(
        cls, values: Mapping[str, float], diagram: str | bytes | None = None, paths: Mapping[str, str] | None = None
    ) -> Self:
        """Return the law of a drone with the parameters `values`, by name.

        `diagram` is the JSON of the attitude controller that flies instead of the stock law; `paths` maps names of its
        parameters to places in it: name -> "attitude_control.k_q". Raises ParameterError for gains out of bounds,
        DiagramError for a controller that has no linear model.
        """
        if diagram is not None:
            found = from_json(diagram)
            start = f"{ATTITUDE.name}."
            inside = {name: path[len(start) :] for name, path in (paths or {}).items() if path.startswith(start)}
            set_to = {path: values[name] for name, path in inside.items() if name in values}
            return cls(found.name, SampledController.of(found, set_to), None, frozenset(inside))
        gains = Gains.from_provenance({"parameters": dict(values)})
        if gains is None:
            raise ParameterError("gains are out of their bounds", "the drone's parameters", "set them within bounds")
        return cls("", SampledController.of_cascade(*gains.rate, gains.attitude), gains, frozenset(GAINS))

    @property
    def digest(self) -> str:
        """SHA-256 of the law's matrices: equal for two laws if and only if their bits are equal."""
        parts = (self.controller.a, self.controller.b, self.controller.c, self.controller.d)
        return hashlib.sha256(b"".join(repr(part.shape).encode() + part.tobytes() for part in parts)).hexdigest()

    def preview(self, family: PitchFamily, goal: float) -> TuningPreview:
        """Return the preview on `family`, with a step of theta by `goal` [rad]."""
        return tuning_preview(family, self.gains or self.controller, goal=goal, members=SURE)

    def step(self, family: PitchFamily, goal: float) -> dict[str, Any]:
        """Return the band of a step of theta by `goal` [rad] alone, of fewer members, without margins and verdict."""
        theta = bounded(simulated_steps(self.controller, family, goal, members=QUICK)[1]["theta"])
        sides = zip(SIDES, step_bands({"theta": theta}, LEVEL), strict=True)
        band = {side: _rounded(_cut(rows)["theta"]) for side, rows in sides}
        time = np.arange(len(theta), dtype=np.float64) * PERIOD
        return {"goal": goal, "level": LEVEL, "time": _rounded(time), "bands": {"theta": band}}

    def verdict(self, family: PitchFamily) -> Robustness:
        """Return the verdict on the stability of the family under the law, as in the preview."""
        return robustness(self.controller, family)
