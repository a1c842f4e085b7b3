"""Promise: what a step of a set-point will do in flight, bands and figures at 95 %, and the verdict on a flight."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import TILT_WALK, PitchLoop
from twodof.design.sampled_controller import SampledController
from twodof.errors import ParameterError, finite, is_number, shown
from twodof.flightlog.events import steps_by
from twodof.flightlog.log import FlightLog
from twodof.models.lti import rise_times
from twodof.signals import PERIOD

Array = NDArray[np.float64]

TRIM = 125
"""Samples before a step over which a channel's rest is averaged: .5 s."""


def step_statistics(response: Array, goal: float) -> dict[str, Array]:
    """Return the figures, (n,) each, of responses (steps, n) from 0 to `goal` that begin at the first row.

    They are the rise from 10 to 90 % [s] (infinite if a response does not come to 90 %), the overshoot as a share of
    the step, and the mean error of the last fifth as a share.
    """
    z = response / goal
    tail = max(1, len(z) // 5)
    return {
        "rise_time": rise_times(np.asarray(np.arange(len(z)) * PERIOD, dtype=np.float64), z),
        "overshoot": np.maximum(0.0, z.max(axis=0) - 1.0),
        "settled_error": 1.0 - z[-tail:].mean(axis=0),
    }


def interval(values: Array, level: float) -> tuple[float, float, float]:
    """Return (low, middle, high): a share `level` of `values` (n,) is from low to high, with as many below as above.

    If many values equal the least one, such as an overshoot of 0, low is that value, and all others outside are above.
    """
    out = 1.0 - level
    least = float(values.min())
    bounded = float(np.mean(values == least)) > 0.5 * out
    tails = (0.0 if bounded else 0.5 * out, 0.5, level if bounded else 1.0 - 0.5 * out)
    low, middle, high = (float(v) for v in np.quantile(values, tails, method="nearest"))
    return low, middle, high


def bounded(response: Array) -> Array:
    """Return a response with its values within 1e6, so that one that diverges has a band too."""
    return np.clip(np.nan_to_num(response, nan=1e6), -1e6, 1e6)


def step_bands(flown: Mapping[str, Array], level: float) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Return the bands (low, middle, high), each by channel (steps,), of the responses `flown`, by channel (steps, n).

    Half of the responses give the width of the band at each time, the other half the factor on it that holds them. A
    factor from the same half would be too small for any other response: split conformal, Lei et al., JASA 113-523
    (2018).
    """
    low, middle, high = {}, {}, {}
    for channel, y in flown.items():
        half = y.shape[1] // 2
        centre, spread = y[:, :half].mean(axis=1), y[:, :half].std(axis=1)
        # While all members agree, the band is as wide as the numbers are rounded.
        spread = np.maximum(spread, 1e-4 * float(np.abs(y).max()) + 1e-12)
        most = np.sort((np.abs(y[:, half:] - centre[:, None]) / spread[:, None]).max(axis=0))
        factor = float(most[min(len(most), math.ceil(level * (len(most) + 1))) - 1])
        low[channel], middle[channel], high[channel] = centre - factor * spread, centre, centre + factor * spread
    return low, middle, high


LEVEL = 0.95
MEMBERS = 1000

CHANCE = 0.05
"""Probability: a number of broken steps that is at least so likely counts as chance."""

_LEAD = 500  # steps before the step, in which the gust becomes what it is in flight
_EARLIER = (0.0, -1.0, 1.0, -1.0)  # the steps before those of `attitude-steps`, in units of the step
_LEAST_MEMBERS, _MOST_MEMBERS = 40, 20_000
_MOST_SAMPLES = 100_000

_TIMES = {"rise_time": (1.0, "s"), "overshoot": (100.0, "%"), "settled_error": (100.0, "%")}


SIDES = ("low", "middle", "high")
"""Parts of a promised band."""


@dataclass(frozen=True)
class PromisedStep:
    """A step that can be promised: the `setpoint` of a loop, and the channel that `follows` it.

    `goal` [rad, m/s or m] and `duration` [s] are defaults; `factor` and `unit` convert the goal for display. `channels`
    have bands; from those in `zeroed` the mean of the half second before the step is subtracted. `peaks` maps a figure
    to the channel whose largest magnitude it is. `figures` has the factor and unit for display of every figure.
    `failure` ends the sentence about the share of members for which nothing can be promised.
    """

    setpoint: str
    follows: str
    goal: float
    duration: float
    factor: float
    unit: str
    channels: tuple[str, ...]
    zeroed: tuple[str, ...]
    peaks: Mapping[str, str]
    figures: Mapping[str, tuple[float, str]]
    failure: str


GOAL = math.radians(10.0)
DURATION = 1.6

_ATTITUDE = PromisedStep(
    setpoint="theta0",
    follows="theta",
    goal=GOAL,
    duration=DURATION,
    factor=180.0 / math.pi,
    unit="deg",
    channels=("theta", "q", "M"),
    zeroed=("M",),
    peaks={"peak_q": "q", "peak_M": "M"},
    figures={**_TIMES, "peak_q": (1.0, "rad/s"), "peak_M": (1.0, "-")},
    failure="of the members are unstable",
)
_VELOCITY = PromisedStep(
    setpoint="v0",
    follows="v",
    goal=0.15,
    duration=2.0,
    factor=1.0,
    unit="m/s",
    channels=("theta", "v", "x"),
    zeroed=("x",),
    peaks={"peak_theta": "theta", "rail_use": "x"},
    figures={**_TIMES, "peak_theta": (180.0 / math.pi, "deg"), "rail_use": (1.0, "m")},
    failure="of the members meet an end stop or are lost",
)
STEPS: Mapping[str, PromisedStep] = MappingProxyType(
    {
        "attitude": _ATTITUDE,
        "velocity": _VELOCITY,
        "position": replace(_VELOCITY, setpoint="x0", follows="x", duration=4.5, unit="m"),
    }
)
"""Steps that can be promised, by loop. `rail_use` is the largest distance from the place before the step."""

CHANNELS = STEPS["attitude"].channels
"""Channels of a step of the pitch: theta [rad], measured q [rad/s], and M about its mean before the step."""

_THETA_LATER = 0.25 * PERIOD
"""A log stamps the theta of a step a third of a millisecond after the step's M: a sample held there is one step old."""


@dataclass(frozen=True)
class Measured:
    """One flown step: its `figures`, and the share of its time that each channel was `outside` of its band.

    `promised` holds the promised intervals (low, high) of the figures.
    """

    outside: Mapping[str, float]
    figures: Mapping[str, float]
    promised: Mapping[str, tuple[float, float]]

    def kept(self, name: str) -> bool:
        """Return True if the channel or figure `name` was as promised."""
        if name in self.outside:
            return self.outside[name] == 0.0
        low, high = self.promised[name]
        return low <= self.figures[name] <= high


@dataclass(frozen=True)
class Verdict:
    """Verdict on a promise of the step `promised` at `level` by a flight with one or more `steps`."""

    level: float
    steps: tuple[Measured, ...]
    promised: PromisedStep

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the channels, then of the figures."""
        return (*self.steps[0].outside, *self.steps[0].figures)

    def count(self, name: str) -> int:
        """Return the number of steps in which `name` was as promised."""
        return sum(step.kept(name) for step in self.steps)

    def kept(self, name: str) -> bool:
        """Return True if no more steps broke the promise of `name` than chance explains."""
        n, broken = len(self.steps), len(self.steps) - self.count(name)
        rare = 1.0 - self.level
        tail = sum(math.comb(n, k) * rare**k * self.level ** (n - k) for k in range(broken, n + 1))
        return broken == 0 or tail > max(CHANCE, rare) + 1e-9

    @property
    def stands(self) -> bool:
        """Return True if the whole promise was kept."""
        return all(self.kept(name) for name in self.names)

    def table(self) -> str:
        """Return the measured and the promised figures as text for a terminal."""
        n = len(self.steps)
        lines = [f"{n} step{'s' * (n > 1)}, promised at {100.0 * self.level:g} %"]
        for name in self.names:
            word = "kept" if self.kept(name) else "BROKEN"
            lines.append(f"  {word:7}{name.replace('_', ' '):14}{self._line(name)}")
        return "\n".join(lines)

    def _line(self, name: str) -> str:
        inside = f"{self.count(name)} of {len(self.steps)} steps"
        first = self.steps[0]
        if name in first.outside:
            worst = max(step.outside[name] for step in self.steps)
            return f"{inside} in the band" + (
                f"; the worst left it for {100.0 * worst:.2g} % of its time" if worst else ""
            )
        factor, unit = self.promised.figures[name]
        low, high = (factor * end for end in first.promised[name])
        figures = ", ".join(f"{factor * step.figures[name]:.3g}" for step in self.steps)
        return f"{inside} within {low:.3g} to {high:.3g} {unit}: {figures}".replace(" -:", ":")

    def to_json(self) -> dict[str, Any]:
        """Return plain data; a figure that is infinite is null."""
        return {
            "level": self.level,
            "stands": self.stands,
            "channels": {
                name: {"kept": self.kept(name), "outside": [step.outside[name] for step in self.steps]}
                for name in self.steps[0].outside
            },
            "figures": {
                name: {
                    "kept": self.kept(name),
                    "promised": finite(self.steps[0].promised[name]),
                    "measured": finite([step.figures[name] for step in self.steps]),
                }
                for name in self.steps[0].figures
            },
        }


@dataclass(frozen=True, eq=False)
class Promise:
    """Promise of a step of a `loop` of `STEPS` by `goal` [rad, m/s or m], at `level`.

    `low`, `middle` (the mean) and `high` are the bands of the channels, each (steps,) at 250 Hz from the step on. Of
    each channel by itself a share `level` of flights stays inside for the whole time. `figures` has intervals (low,
    middle, high), and each figure by itself lies inside with the same share. `failed` is the share of members that are
    unstable or whose response is not finite: if it is not 0, nothing else counts. `family` is its `to_json`.
    """

    controller: str
    family: Mapping[str, Any]
    loop: str
    goal: float
    level: float
    members: int
    seed: int
    failed: float
    low: Mapping[str, Array] = field(repr=False)
    high: Mapping[str, Array] = field(repr=False)
    middle: Mapping[str, Array] = field(repr=False)
    figures: Mapping[str, tuple[float, float, float]]

    @classmethod
    def of_flights(
        cls,
        controller: str,
        family: Mapping[str, Any],
        loop: str,
        goal: float,
        level: float,
        seed: int,
        failed: float,
        flown: Mapping[str, Array],
    ) -> Self:
        """Return the promise made from simulated flights: `flown` has each channel, shape (steps, members)."""
        flown = {name: bounded(flown[name]) for name in STEPS[loop].channels}
        low, middle, high = step_bands(flown, level)
        figures = {name: interval(values, level) for name, values in step_figures(flown, loop, goal).items()}
        count = next(iter(flown.values())).shape[1]
        return cls(controller, family, loop, goal, level, count, seed, failed, low, high, middle, figures)

    @property
    def step(self) -> PromisedStep:
        """Return the step of `STEPS` that is promised."""
        return STEPS[self.loop]

    @property
    def time(self) -> Array:
        """Return the times of the bands, from the step on [s]."""
        return np.asarray(np.arange(len(self.middle[self.step.follows])) * PERIOD, dtype=np.float64)

    @property
    def robust(self) -> bool:
        """Return True if no member failed."""
        return self.failed == 0.0

    def table(self) -> str:
        """Return the figures as text for a terminal."""
        step = f"a step of {self.step.setpoint} by {self.step.factor * self.goal:g} {self.step.unit}"
        lines = [f"promise of {self.controller}: {step}, {100.0 * self.level:g} % of flights"]
        if not self.robust:
            lines.append(f"nothing is promised: {100.0 * self.failed:.1f} % {self.step.failure}")
            return "\n".join(lines)
        lines.append(f"{'':14}{'from':>9}{'middle':>9}{'to':>9}  unit")
        for name, row in self.figures.items():
            factor, unit = self.step.figures[name]
            cells = "".join(f"{factor * value:9.3g}" for value in row)
            lines.append(f"{name.replace('_', ' '):14}{cells}  {unit}")
        return "\n".join(lines)

    def verdict(self, time: ArrayLike, signals: Mapping[str, ArrayLike]) -> Verdict:
        """Compare one flown step with the promise.

        `time` [s] counts from the step, with at least .2 s before it; `signals` has channels of a step from 0 to
        `goal`, each of the shape of `time`. Channels that are missing are not compared. Raise ParameterError for other
        signals, shapes, numbers that are not finite, and a record that does not cover the step.
        """
        t, end = np.asarray(time, dtype=float), self.time[-1]
        given = {name: np.asarray(values, dtype=float) for name, values in signals.items()}
        if t.ndim != 1 or not t.size or not (np.diff(t) > 0.0).all() or not (t[0] <= -0.2 and t[-1] >= end - PERIOD):
            what = f"the times, of shape {t.shape}, do not cover the step"
            raise _error(what, f"give rising times from -0.5 to {end:.2f} s")
        fits = all(y.shape == t.shape and np.isfinite(y).all() for y in given.values())
        if not given or not set(given) <= set(self.step.channels) or not fits:
            remedy = f"give {', '.join(self.step.channels)}, a finite number for each time"
            raise _error(f"the signals {', '.join(map(str, given)) or 'none'} do not fit the promise", remedy)
        flown = {name: np.interp(self.time, t, y) for name, y in given.items()}
        for name in set(self.step.zeroed) & set(given):
            flown[name] -= float(given[name][(t < 0.0) & (t >= -TRIM * PERIOD)].mean())
        return Verdict(self.level, (self._measured(flown),), self.step)

    def verdict_of(self, log: FlightLog) -> Verdict:
        """Compare all steps that `steps_of` finds in `log` with the promise. Raise the errors of `steps_of`."""
        return Verdict(self.level, tuple(self.verdict(*one).steps[0] for one in self.steps_of(log)), self.step)

    def steps_of(self, log: FlightLog) -> list[tuple[Array, dict[str, Array]]]:
        """Return all steps by `goal`, up or down, that `log` holds: (time from the step, the channels).

        Each record is shifted and, if need be, inverted to a step up from 0. It begins half a second before the step.
        Raise ParameterError if the log lacks a step of that size, LogError if it lacks channels.
        """
        step, end, found = self.step, self.time[-1], []
        grid = np.asarray(np.arange(-TRIM, len(self.time)) * PERIOD, dtype=np.float64)
        later = {"theta": _THETA_LATER} if step.follows == "theta" else {}
        for one in steps_by(log, self.loop, self.goal, end):
            sign = math.copysign(1.0, one.after - one.before)
            flown = {c: sign * log.resample(c, grid + one.time + later.get(c, 0.0)) for c in step.channels}
            if step.follows not in step.zeroed:
                flown[step.follows] -= sign * one.before
            for channel in step.zeroed:
                flown[channel] -= float(flown[channel][:TRIM].mean())
            found.append((grid, flown))
        if not found:
            size = f"{step.factor * self.goal:g} {step.unit}"
            what = f"the log has no step of {step.setpoint} by {size} that lasts {end:.2f} s"
            raise ParameterError(what, log.source, f"fly one in {self.loop} mode, or promise the step that was flown")
        return found

    def _measured(self, flown: Mapping[str, Array]) -> Measured:
        outside = {name: float(np.mean((y < self.low[name]) | (y > self.high[name]))) for name, y in flown.items()}
        columns = {name: y[:, None] for name, y in flown.items()}
        found = {name: float(value[0]) for name, value in step_figures(columns, self.loop, self.goal).items()}
        promised = {name: (low, high) for name, (low, _, high) in self.figures.items() if name in found}
        return Measured(outside, found, promised)

    def to_json(self) -> dict[str, Any]:
        """Return plain data, which `from_json` reads back; an infinite figure is null."""
        sides = {side: getattr(self, side) for side in SIDES}
        kept = ("controller", "loop", "goal", "level", "members", "seed", "failed")
        return {
            "promise": 1,
            **{name: getattr(self, name) for name in kept},
            "family": dict(self.family),
            "period": PERIOD,
            "bands": {
                name: {side: [float(f"{v:.6g}") for v in rows[name]] for side, rows in sides.items()}
                for name in self.step.channels
            },
            "figures": {name: dict(zip(sides, finite(row), strict=True)) for name, row in self.figures.items()},
        }

    @classmethod
    def from_json(cls, data: object, where: str = "promise") -> Self:
        """Return the promise that `to_json` wrote, here or in an earlier version. Raise ParameterError for other data.

        Earlier, a promise of the rail had the key `rail_promise`, and the failed share was `unstable` or `lost`.
        """
        try:
            if not isinstance(data, Mapping) or 1 not in (data.get("promise"), data.get("rail_promise")):
                raise TypeError(shown(data))
            loop = str(data.get("loop", "attitude"))
            step, family, goal = STEPS[loop], data["family"], float(data["goal"])
            bands = {
                side: {name: np.array(data["bands"][name][side], dtype=float) for name in step.channels}
                for side in ("low", "high", "middle")
            }
            shapes = {one.shape for side in bands.values() for one in side.values()}
            if len(shapes) != 1 or len(shape := shapes.pop()) != 1 or not 1 < shape[0] < _MOST_SAMPLES:
                raise ValueError("the bands differ in length")
            if not (math.isfinite(goal) and goal > 0.0 and isinstance(family, Mapping)):
                raise ValueError("the step is not above 0, or the family is empty")
            return cls(
                str(data["controller"]),
                family,
                loop,
                goal,
                float(data["level"]),
                int(data["members"]),
                int(data["seed"]),
                float(next(data[name] for name in ("failed", "unstable", "lost") if name in data)),
                bands["low"],
                bands["high"],
                bands["middle"],
                {name: _row(data["figures"][name]) for name in step.figures},
            )
        except (KeyError, TypeError, ValueError, OverflowError, StopIteration) as reason:
            raise ParameterError(
                f"this is not a promise ({reason!s:.80})", where, "give the file that `twodof design` wrote"
            ) from reason


def step_figures(flown: Mapping[str, Array], loop: str, goal: float) -> dict[str, Array]:
    """Return the figures, (n,) each, of n steps with the channels `flown` (steps, n), as far as these are there."""
    step = STEPS[loop]
    found = step_statistics(flown[step.follows], goal) if step.follows in flown else {}
    peaks = {name: np.abs(flown[one]).max(axis=0) for name, one in step.peaks.items() if one in flown}
    return {**found, **peaks}


_OPEN = SampledController(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), np.zeros((1, 3)))


@lru_cache(maxsize=4)
def _plants(family: PitchFamily, members: int, seed: int) -> tuple[PitchLoop, PitchLoop]:
    """Return the loops of the drawn members and of the estimate, kept for the next controller.

    Half the time of a short promise would go into their matrices, which no gain changes.
    """
    _, times = family.gusts(members, seed)
    return PitchLoop(family.draw(members, seed), _OPEN, times), PitchLoop(family.nominal(), _OPEN)


def promise(
    controller: SampledController,
    family: PitchFamily,
    *,
    goal: float = GOAL,
    duration: float = DURATION,
    level: float = LEVEL,
    members: int = MEMBERS,
    seed: int = 1,
    name: str = "controller",
    progress: Callable[[float], None] = lambda share: None,
) -> Promise:
    """Fly `members` of the family under `controller`, with its gust and noise, and promise a step of the pitch.

    The step of theta is by `goal` [rad] and watched for `duration` [s]. The bands are as wide at each time as the
    responses spread there, times one factor for the whole time. Three of four members have made a step 2 s before.
    `progress` is called with the share done. Raise ParameterError for numbers out of range.
    """
    check_numbers(duration, level, members, (_LEAST_MEMBERS, _MOST_MEMBERS))
    loop, flown = simulated_steps(controller, family, goal, duration, members, seed, progress)
    unstable = float(np.mean(loop.radii() >= 1.0))
    return Promise.of_flights(name, family.to_json(), "attitude", goal, level, seed, unstable, flown)


def simulated_steps(
    controller: SampledController,
    family: PitchFamily,
    goal: float = GOAL,
    duration: float = DURATION,
    members: int = MEMBERS,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[PitchLoop, dict[str, Array]]:
    """Return the loop of the members that a promise flies, and their steps: theta, q and M, each (steps, members).

    Raise ParameterError for a goal out of range.
    """
    if not is_number(goal, 1e-3, 0.8):
        raise _error(f"a step of {shown(goal)} rad is out of range", "give 0.001 to 0.8 rad")
    loop, nominal = (one.under(controller) for one in _plants(family, members, seed))
    steps = round(duration / PERIOD) + 1
    setpoint = np.concatenate([np.zeros(_LEAD), np.full(steps, goal)])
    with np.errstate(over="ignore", invalid="ignore"):
        theta, q, moment = loop.simulate(
            setpoint, seed, family.gusts(members, seed)[0], family.q_noise, family.q_band, TILT_WALK, progress
        )
        before = nominal.after_step(goal, len(setpoint))
        moment, earlier = (m - m[_LEAD - TRIM : _LEAD].mean(axis=0) for m in (moment, before[2]))
        # What an earlier step leaves, 2 s later: none, one the other way, or one the same way.
        left = np.resize(_EARLIER, members)
        theta, q, moment = theta + left * (before[0] - goal), q + left * before[1], moment + left * earlier
    return loop, {"theta": theta[_LEAD:], "q": q[_LEAD:], "M": moment[_LEAD:]}


def check_numbers(duration: float, level: float, members: int, among: tuple[int, int]) -> None:
    """Raise ParameterError for a duration [s], a level or a number of members (`among` its bounds) out of range."""
    if not is_number(duration, 0.1, 20.0):
        raise _error(f"a duration of {shown(duration)} s is out of range", "give 0.1 to 20 s")
    if not is_number(level, 0.5, 0.999):
        raise _error(f"a level of {shown(level)} is out of range", "give 0.5 to 0.999")
    if not is_number(members, *among, whole=True):
        raise _error(f"{shown(members)} members are out of range", f"give {among[0]} to {among[1]}")


def _row(given: Mapping[str, float | None] | Sequence[float | None]) -> tuple[float, float, float]:
    """Return (low, middle, high) of a figure in a promise file."""
    ends = [given[side] for side in SIDES] if isinstance(given, Mapping) else list(given)
    low, middle, high = (math.inf if value is None else float(value) for value in ends)
    return low, middle, high


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "promise", remedy)
