"""Promise: what a design will do in flight, bands and figures at 95 %, from model, covariance and disturbance."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.pitch_loop import PitchLoop
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.design.uncertain.step_bands import step_bands
from twodof.design.uncertain.step_statistics import FIGURES, TRIM, interval, step_statistics
from twodof.design.uncertain.verdict import Measured, Verdict
from twodof.errors import ParameterError, shown
from twodof.flightlog.events import steps_by
from twodof.flightlog.log import FlightLog
from twodof.signals import PERIOD

Array = NDArray[np.float64]

LEVEL = 0.95
GOAL = math.radians(10.0)
DURATION = 1.6
MEMBERS = 1000

CHANNELS = ("theta", "q", "M")
"""What has a band: theta [rad], the measured q [rad/s], and M about its mean of the half second before the step."""

_LEAD = 500  # steps before the step, in which the gust becomes what it is in flight
_THETA_LATER = 0.25 * PERIOD
"""A log stamps the theta of a step a third of a millisecond after the step's M: a sample held there is one step old."""

_LEAST_MEMBERS, _MOST_MEMBERS = 40, 20_000


@dataclass(frozen=True, eq=False)
class Promise:
    """The step of theta by `goal` [rad], promised at `level`.

    `low`, `high` and `middle` are the bands of `CHANNELS`, each (steps,) at 250 Hz from the step on. A share `level` of
    flights stays inside for the whole time. `figures` are intervals of `FIGURES` with as large a share, each by itself.
    `unstable` is the share of members that the controller does not keep stable: then nothing else counts.
    """

    controller: str
    family: PitchFamily
    goal: float
    level: float
    members: int
    seed: int
    unstable: float
    low: Mapping[str, Array]
    high: Mapping[str, Array]
    middle: Mapping[str, Array]
    figures: Mapping[str, tuple[float, float, float]]

    @property
    def time(self) -> Array:
        """From the step on [s]."""
        return np.asarray(np.arange(len(self.middle["theta"])) * PERIOD, dtype=np.float64)

    @property
    def robust(self) -> bool:
        """Whether every member that was drawn is stable."""
        return self.unstable == 0.0

    def table(self) -> str:
        """The figures as text for a terminal."""
        asked = f"a step of {math.degrees(self.goal):g} deg, {100.0 * self.level:g} % of flights"
        lines = [f"promise of {self.controller}: {asked}"]
        if not self.robust:
            lines.append(f"nothing is promised: unstable on {100.0 * self.unstable:.1f} % of the members")
            return "\n".join(lines)
        lines.append(f"{'':14}{'from':>9}{'middle':>9}{'to':>9}  unit")
        for name, (low, middle, high) in self.figures.items():
            factor, unit = UNITS[name]
            cells = "".join(f"{factor * value:9.3g}" for value in (low, middle, high))
            lines.append(f"{name.replace('_', ' '):14}{cells}  {unit}")
        return "\n".join(lines)

    def verdict(self, time: ArrayLike, signals: Mapping[str, ArrayLike]) -> Verdict:
        """One flown step beside what was promised.

        `time` [s] is from the step on, with at least .2 s before it; `signals` has theta [rad], q [rad/s] and M, of a
        step from 0 to `goal`, each of the shape of `time`. What is missing of the channels is left out. Raises
        ParameterError for other signals, shapes, numbers that are not finite, and a record that does not hold the step.
        """
        t = np.asarray(time, dtype=float)
        if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0.0).all():
            raise _error(f"a time of shape {t.shape}", "give times that rise, in seconds from the step on")
        if not set(signals) <= set(CHANNELS) or not signals:
            raise _error(f"signals {', '.join(map(str, signals)) or 'none'}", f"give {', '.join(CHANNELS)}")
        if t[0] > -0.2 or t[-1] < self.time[-1] - PERIOD:
            raise _error(
                f"the record goes from {t[0]:.2f} to {t[-1]:.2f} s about the step",
                f"give -0.5 to {self.time[-1]:.2f} s",
            )
        flown: dict[str, Array] = {}
        for name, values in signals.items():
            y = np.asarray(values, dtype=float)
            if y.shape != t.shape or not np.isfinite(y).all():
                raise _error(f"{name} of shape {y.shape}", "give finite numbers, one for each time")
            flown[name] = np.interp(self.time, t, y)
            if name == "M":
                before = (t < 0.0) & (t >= -TRIM * PERIOD)
                flown[name] -= float(y[before].mean())
        return Verdict(self.level, (self._measured(flown),))

    def verdict_of(self, log: FlightLog) -> Verdict:
        """All steps that `steps_of` finds in `log`, beside what was promised. Raises as it does."""
        return Verdict(self.level, tuple(self.verdict(*one).steps[0] for one in self.steps_of(log)))

    def steps_of(self, log: FlightLog) -> list[tuple[Array, dict[str, Array]]]:
        """All steps of theta by `goal`, up or down, that `log` holds: (time from the step, the `CHANNELS`).

        Each is turned and moved as if it went up from 0; M is about its mean of the half second before. Raises
        ParameterError where there is none of that size, LogError where channels are missing.
        """
        end, found = self.time[-1], []
        grid = np.asarray(np.arange(-TRIM, len(self.time)) * PERIOD, dtype=np.float64)
        for step in steps_by(log, "theta0", self.goal, end):
            sign, at = math.copysign(1.0, step.after - step.before), grid + step.time
            got = {
                name: sign * log.resample(name, at + (_THETA_LATER if name == "theta" else 0.0)) for name in CHANNELS
            }
            got["theta"] -= sign * step.before
            got["M"] -= float(got["M"][:TRIM].mean())
            found.append((grid, got))
        if not found:
            raise ParameterError(
                f"it holds no step of theta by {math.degrees(self.goal):g} deg that lasts {end:.2f} s",
                log.source,
                "fly attitude-steps, or promise the step that was flown",
            )
        return found

    def _measured(self, flown: Mapping[str, Array]) -> Measured:
        outside = {}
        for name, y in flown.items():
            outside[name] = float(np.mean((y < self.low[name]) | (y > self.high[name])))
        found: dict[str, float] = {}
        if "theta" in flown:
            zero = np.zeros((len(self.time), 1))
            theta, q, moment = (flown[name][:, None] if name in flown else zero for name in CHANNELS)
            every = step_statistics(theta, q, moment, self.goal)
            left = {"peak_q": "q", "peak_M": "M"}
            found = {n: float(v[0]) for n, v in every.items() if left.get(n, "theta") in flown}
        promised = {name: (low, high) for name, (low, _, high) in self.figures.items() if name in found}
        return Measured(outside, found, promised)

    def to_json(self) -> dict[str, Any]:
        """Plain data, which `from_json` reads back; an infinite figure is null."""
        return {
            "promise": 1,
            "controller": self.controller,
            "family": self.family.to_json(),
            "goal": self.goal,
            "level": self.level,
            "members": self.members,
            "seed": self.seed,
            "unstable": self.unstable,
            "period": PERIOD,
            "bands": {
                name: {"low": _rounded(self.low[name]), "middle": _rounded(self.middle[name]), "high": _rounded(high)}
                for name, high in self.high.items()
            },
            "figures": {
                name: dict(zip(("low", "middle", "high"), map(_plain, row), strict=True))
                for name, row in self.figures.items()
            },
        }

    @classmethod
    def from_json(cls, data: object, where: str = "promise") -> Self:
        """What `to_json` gave. Raises ParameterError for anything else."""
        try:
            if not isinstance(data, Mapping) or data.get("promise") != 1:
                raise TypeError(shown(data))
            bands = {
                side: {name: np.array(data["bands"][name][side], dtype=float) for name in CHANNELS}
                for side in ("low", "high", "middle")
            }
            sizes = {one.shape for side in bands.values() for one in side.values()}
            if len(sizes) != 1 or len(next(iter(sizes))) != 1 or next(iter(sizes)) == (0,):
                raise ValueError("the bands differ in length")
            rows = {name: data["figures"][name] for name in FIGURES}
            figures = {n: (_number(r["low"]), _number(r["middle"]), _number(r["high"])) for n, r in rows.items()}
            goal = float(data["goal"])
            if not (math.isfinite(goal) and goal > 0.0):
                raise ValueError(f"goal {goal}")
            return cls(
                str(data["controller"]),
                PitchFamily.from_json(data["family"], where),
                goal,
                float(data["level"]),
                int(data["members"]),
                int(data["seed"]),
                float(data["unstable"]),
                bands["low"],
                bands["high"],
                bands["middle"],
                figures,
            )
        except (KeyError, TypeError, ValueError, OverflowError) as reason:
            raise ParameterError(
                f"it is not a promise ({reason!s:.80})", where, "give the file that `twodof design` wrote"
            ) from reason


UNITS: Mapping[str, tuple[float, str]] = {
    "rise_time": (1.0, "s"),
    "overshoot": (100.0, "%"),
    "settled_error": (100.0, "%"),
    "peak_q": (1.0, "rad/s"),
    "peak_M": (1.0, "-"),
}
"""Factor and unit in which a figure is shown."""


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
    said: Callable[[float], None] = lambda share: None,
) -> Promise:
    """Fly `members` of the family under `controller`, with its gust and noise, and promise what a share `level` does.

    The step of theta is by `goal` [rad] and watched for `duration` [s]. The bands are as wide at each time as the
    responses spread there, times one factor for the whole time. `said` is called with the share done. Raises
    ParameterError for numbers out of range.
    """
    _check(goal, duration, level, members)
    drawn = family.draw(members, seed)
    loop = PitchLoop(drawn, controller, family.gust_time)
    unstable = float(np.mean(loop.radii() >= 1.0))
    steps = round(duration / PERIOD) + 1
    setpoint = np.concatenate([np.zeros(_LEAD), np.full(steps, goal)])
    with np.errstate(over="ignore", invalid="ignore"):
        theta, q, moment = loop.simulate(setpoint, seed, family.gust, family.q_noise, said)
        moment = moment - moment[_LEAD - TRIM : _LEAD].mean(axis=0)
        flown = {"theta": theta[_LEAD:], "q": q[_LEAD:], "M": moment[_LEAD:]}
        flown = {name: np.clip(np.nan_to_num(y, nan=1e6), -1e6, 1e6) for name, y in flown.items()}
        figures = step_statistics(flown["theta"], flown["q"], flown["M"], goal)
    low, middle, high = step_bands(flown, level)
    rows = {figure: interval(values, level) for figure, values in figures.items()}
    return Promise(name, family, goal, level, members, seed, unstable, low, high, middle, rows)


def _check(goal: float, duration: float, level: float, members: int) -> None:
    if not 1e-3 <= goal <= 0.8:
        raise _error(f"a step of {goal!r} rad", "give 0.001 to 0.8 rad")
    if not 0.1 <= duration <= 20.0:
        raise _error(f"a duration of {duration!r} s", "give 0.1 to 20 s")
    if not 0.5 <= level <= 0.999:
        raise _error(f"a level of {level!r}", "give 0.5 to 0.999")
    if isinstance(members, bool) or not isinstance(members, int) or not _LEAST_MEMBERS <= members <= _MOST_MEMBERS:
        raise _error(f"{shown(members)} members", f"give {_LEAST_MEMBERS} to {_MOST_MEMBERS}")


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.inf if value is None else float(value)


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "promise", remedy)
