"""TuningPreview: the effect of gains on an identified family before they are sent; PitchLaw: the law that flies."""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.schema.json_form import from_json
from twodof.design.margins import LoopMargins, margins
from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import PITCH_LOOPS, PitchLoop, pitch_loops
from twodof.design.promise import CHANNELS, GOAL, LEVEL, Promise, promise
from twodof.design.robustness import Robustness, robustness
from twodof.design.sampled_controller import SampledController
from twodof.design.step_statistics import interval
from twodof.errors import ParameterError
from twodof.flight.gains import Gains
from twodof.flight.templates import ATTITUDE
from twodof.signals import PERIOD

Array = NDArray[np.float64]

SETTLED = 0.05
"""Of the step: a response that stays this near its set-point has settled."""

SHOWN: Mapping[str, float] = {"theta": math.pi, "q": 50.0, "M": 5.0}
"""Where a band is cut off [rad, rad/s, -]: beyond it an unstable loop draws nothing that a person could read."""

_FIGURES = ("rise_time", "overshoot", "settling_time", "peak_q", "peak_M")


@dataclass(frozen=True, eq=False)
class TuningPreview:
    """Preview of `gains` on a family: `loops`, bands of a step of theta by `goal` [rad], its figures, and the verdict.

    `gains` are None of a controller that is not the stock cascade. `loops` has the margins of each of `PITCH_LOOPS`, of
    the estimate; of another controller those at the motors alone. `low`, `middle` and `high` are bands of
    `CHANNELS`, (steps,) at the times `time` [s] from the step on: a share `level` of flights stays inside all the time.
    `figures` are (low, middle, high) with as large a share: rise_time [s], overshoot (a share), settling_time [s],
    peak_q [rad/s], peak_M. The settling time is that without gusts and noise; a time that is never reached is infinite.
    """

    gains: Gains | None
    goal: float
    level: float
    members: int
    loops: Mapping[str, LoopMargins]
    time: Array
    low: Mapping[str, Array]
    middle: Mapping[str, Array]
    high: Mapping[str, Array]
    figures: Mapping[str, tuple[float, float, float]]
    verdict: Robustness

    def to_json(self) -> dict[str, Any]:
        """Plain data with lists for arrays; what is infinite is null."""
        return {
            "gains": None if self.gains is None else self.gains.to_json(),
            "goal": self.goal,
            "level": self.level,
            "members": self.members,
            "loops": {name: _plain(_told(loop)) for name, loop in self.loops.items()},
            "time": _rounded(self.time),
            "bands": {
                name: {side: _rounded(getattr(self, side)[name]) for side in ("low", "middle", "high")}
                for name in CHANNELS
            },
            "figures": {
                name: _plain(dict(zip(("low", "middle", "high"), row, strict=True)))
                for name, row in self.figures.items()
            },
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
    """Close the pitch loops under a `law` over `family`, and return what they will do.

    The law is the gains of the stock cascade, or any controller of the pitch: its margins are those at the motors.

    `family` is that of a model's file: `PitchFamily.from_identified(json)`. The same `seed` draws the same members and
    gusts, so two calls with other gains differ by the gains alone. `progress` is called with the share done, some ten
    times a second; an exception that it raises ends the work. Raise ParameterError for numbers out of range.
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
    return {name: np.clip(side[name], -SHOWN[name], SHOWN[name]) for name in CHANNELS}


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
    """Of `LoopMargins.to_json` what a page shows; the curves' details are left out."""
    kept = loop.to_json()
    return {name: value for name, value in kept.items() if name not in ("gain_crossings", "phase_crossings", "poles")}


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


GAINS = ("RATE_KP", "RATE_KI", "RATE_KD", "ATT_KP")
"""The parameters of the stock law of the pitch that a preview knows."""

SURE = 200
"""Members that fly in a preview."""


@dataclass(frozen=True, eq=False)
class PitchLaw:
    """`controller` is the law as matrices; `gains` those of the stock law, None of a user's controller `name`.

    `parameters` are the names of what tunes it.
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

        `diagram` is the JSON of its own controller of the template attitude_control, whose parameters `paths` says
        where they are: name -> "attitude_control.k_q". Raises ParameterError for gains that cannot be, DiagramError for
        a controller that has no linear model.
        """
        if diagram is not None:
            found = from_json(diagram if isinstance(diagram, str) else diagram.decode())
            start = f"{ATTITUDE.name}."
            inside = {name: path[len(start) :] for name, path in (paths or {}).items() if path.startswith(start)}
            set_to = {path: values[name] for name, path in inside.items() if name in values}
            return cls(found.name, SampledController.of(found, set_to), None, frozenset(inside))
        gains = Gains.flown({"parameters": dict(values)})
        if gains is None:
            raise ParameterError("its gains are out of their bounds", "the drone's parameters", "set them back")
        return cls("", SampledController.of_cascade(*gains.rate, gains.attitude), gains, frozenset(GAINS))

    @property
    def digest(self) -> str:
        """The same for the same law to the bit, and for no other."""
        parts = (self.controller.a, self.controller.b, self.controller.c, self.controller.d)
        return hashlib.sha256(b"".join(repr(part.shape).encode() + part.tobytes() for part in parts)).hexdigest()

    def preview(self, family: PitchFamily, goal: float) -> TuningPreview:
        """Return the preview on `family`, with a step of theta by `goal` [rad]."""
        return tuning_preview(family, self.gains or self.controller, goal=goal, members=SURE)

    def verdict(self, family: PitchFamily) -> Robustness:
        """Return whether it keeps the family stable, as the preview has it."""
        return robustness(self.controller, family)
