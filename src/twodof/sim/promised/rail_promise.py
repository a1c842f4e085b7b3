"""RailPromise: bands and figures of a step of the velocity or of the position, by flights of an identified family."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.design.uncertain.step_bands import step_bands
from twodof.design.uncertain.step_statistics import interval, step_statistics
from twodof.design.uncertain.verdict import Measured, Verdict
from twodof.errors import ParameterError, shown
from twodof.flight.gains import DEFAULT, Gains
from twodof.flightlog.events import steps_by
from twodof.flightlog.log import FlightLog
from twodof.signals import PERIOD
from twodof.sim.promised.lanes_flight import BEFORE, fly_lanes
from twodof.sim.promised.rail_family import RailFamily

Array = NDArray[np.float64]

LEVEL = 0.95
MEMBERS = 400
CHANNELS = ("theta", "v", "x")
"""What has a band, as a log has it: theta [rad], v [m/s], and x [m] from where it was at the step."""

STEPS: Mapping[str, tuple[str, str, float, float]] = MappingProxyType(
    {"velocity": ("v0", "v", 0.15, 2.0), "position": ("x0", "x", 0.15, 4.5)}
)
"""By loop: the set-point, the channel that follows it, the step [m/s, m] and how long it is watched [s]."""

FIGURES: Mapping[str, tuple[float, str]] = MappingProxyType(
    {
        "rise_time": (1.0, "s"),
        "overshoot": (100.0, "%"),
        "settled_error": (100.0, "%"),
        "peak_theta": (180.0 / math.pi, "deg"),
        "rail_use": (1.0, "m"),
    }
)
"""What has an interval, with factor and unit as shown. `rail_use` is how far the drone comes from where it was."""

_NAMES = {"peak_q": "peak_theta", "peak_M": "rail_use"}
_LEAST_MEMBERS, _MOST_MEMBERS = 40, 2000


@dataclass(frozen=True, eq=False)
class RailPromise:
    """A step of `loop`'s set-point ("velocity" or "position") by `goal` [m/s or m], promised at `level`.

    `low`, `middle` and `high` are the bands of `CHANNELS`, (steps,) at 250 Hz from the step on; `figures` are intervals
    of `FIGURES`. `lost` is the share of members that met an end stop or did not come near the set-point at all: then
    nothing else counts.
    """

    controller: str
    family: RailFamily
    loop: str
    goal: float
    level: float
    members: int
    seed: int
    lost: float
    low: Mapping[str, Array]
    high: Mapping[str, Array]
    middle: Mapping[str, Array]
    figures: Mapping[str, tuple[float, float, float]]

    @property
    def time(self) -> Array:
        """From the step on [s]."""
        return np.asarray(np.arange(len(self.middle["x"])) * PERIOD, dtype=np.float64)

    def table(self) -> str:
        """The figures as text for a terminal."""
        unit = "m/s" if self.loop == "velocity" else "m"
        lines = [f"promise of {self.controller}: a {self.loop} step of {self.goal:g} {unit}, {100.0 * self.level:g} %"]
        if self.lost:
            lines.append(f"nothing is promised: {100.0 * self.lost:.1f} % of the members meet an end stop or are lost")
            return "\n".join(lines)
        lines.append(f"{'':14}{'from':>9}{'middle':>9}{'to':>9}  unit")
        for name, row in self.figures.items():
            factor, unit = FIGURES[name]
            cells = "".join(f"{factor * value:9.3g}" for value in row)
            lines.append(f"{name.replace('_', ' '):14}{cells}  {unit}")
        return "\n".join(lines)

    def verdict_of(self, log: FlightLog) -> Verdict:
        """All steps that `steps_of` finds in `log`, beside what was promised. Raises as it does."""
        return Verdict(self.level, tuple(self.measured(flown) for _, flown in self.steps_of(log)))

    def steps_of(self, log: FlightLog) -> list[tuple[Array, dict[str, Array]]]:
        """All steps of the loop's set-point by `goal`, up or down, that `log` holds: (time from the step, `CHANNELS`).

        Each is turned and moved as if it went up from 0, and begins `BEFORE` samples before the step. Raises
        ParameterError where there is none of that size, LogError where channels are missing.
        """
        name = STEPS[self.loop][0]
        end, found = self.time[-1], []
        grid = np.asarray(np.arange(-BEFORE, len(self.time)) * PERIOD, dtype=np.float64)
        for step in steps_by(log, name, self.goal, end):
            sign = math.copysign(1.0, step.after - step.before)
            flown = {channel: sign * log.resample(channel, grid + step.time) for channel in CHANNELS}
            flown["v"] -= sign * step.before if self.loop == "velocity" else 0.0
            flown["x"] -= float(flown["x"][:BEFORE].mean())
            found.append((grid, flown))
        if not found:
            raise ParameterError(
                f"it holds no step of {name} by {self.goal:g} that lasts {end:.2f} s",
                log.source,
                f"fly one in {self.loop} mode, or promise the step that was flown",
            )
        return found

    def measured(self, flown: Mapping[str, Array]) -> Measured:
        """One step up: `flown` has each of `CHANNELS`, from `BEFORE` samples before the step to the promise's end."""
        zeroed = _zeroed({name: flown[name][:, None] for name in CHANNELS})
        outside = {
            name: float(np.mean((y[:, 0] < self.low[name]) | (y[:, 0] > self.high[name]))) for name, y in zeroed.items()
        }
        figures = {name: float(value[0]) for name, value in _figures(zeroed, self.loop, self.goal).items()}
        return Measured(outside, figures, {name: (row[0], row[2]) for name, row in self.figures.items()})

    def to_json(self) -> dict[str, Any]:
        """Plain data, which `from_json` reads back; an infinite figure is null."""
        sides = {"low": self.low, "middle": self.middle, "high": self.high}
        return {
            "rail_promise": 1,
            **{
                name: getattr(self, name) for name in ("controller", "loop", "goal", "level", "members", "seed", "lost")
            },
            "family": self.family.to_json(),
            "period": PERIOD,
            "bands": {
                name: {side: [float(f"{v:.6g}") for v in rows[name]] for side, rows in sides.items()}
                for name in CHANNELS
            },
            "figures": {
                name: [value if math.isfinite(value) else None for value in row] for name, row in self.figures.items()
            },
        }

    @classmethod
    def from_json(cls, data: object, where: str = "promise") -> Self:
        """What `to_json` gave. Raises ParameterError for anything else."""
        try:
            if not isinstance(data, Mapping) or data.get("rail_promise") != 1 or data["loop"] not in STEPS:
                raise TypeError(shown(data))
            bands = {
                side: {name: np.array(data["bands"][name][side], dtype=float) for name in CHANNELS}
                for side in ("low", "high", "middle")
            }
            sizes = {one.shape for side in bands.values() for one in side.values()}
            if len(sizes) != 1 or len(next(iter(sizes))) != 1 or not 1 < next(iter(sizes))[0] < 100_000:
                raise ValueError("the bands differ in length")
            rows = {name: tuple(math.inf if v is None else float(v) for v in data["figures"][name]) for name in FIGURES}
            if any(len(row) != 3 for row in rows.values()) or not float(data["goal"]) > 0.0:
                raise ValueError("a figure has not three numbers, or the step is none")
            return cls(
                str(data["controller"]),
                RailFamily.from_json(data["family"], where),
                str(data["loop"]),
                float(data["goal"]),
                float(data["level"]),
                int(data["members"]),
                int(data["seed"]),
                float(data["lost"]),
                bands["low"],
                bands["high"],
                bands["middle"],
                {name: (row[0], row[1], row[2]) for name, row in rows.items()},
            )
        except (KeyError, TypeError, ValueError, OverflowError) as reason:
            raise ParameterError(
                f"it is not a promise of the rail ({reason!s:.80})", where, "give the file that `twodof design` wrote"
            ) from reason


def rail_promise(
    family: RailFamily,
    loop: str = "velocity",
    *,
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    goal: float | None = None,
    duration: float | None = None,
    level: float = LEVEL,
    members: int = MEMBERS,
    seed: int = 1,
    said: Callable[[float], None] = lambda share: None,
) -> RailPromise:
    """Fly `members` of the family on the virtual rig, with all noise and limits, and promise what a share `level` does.

    `goal` [m/s or m] and `duration` [s] are those of `STEPS` where None. `said` is called with the share done. Raises
    ParameterError for numbers out of range, and as `RailFamily.rigs` and `fly_lanes`.
    """
    if loop not in STEPS:
        raise _error(f"a loop {shown(loop)}", f"give {' or '.join(STEPS)}")
    setpoint, _, usual, lasting = STEPS[loop]
    goal, duration = usual if goal is None else goal, lasting if duration is None else duration
    if not 0.01 <= goal <= 1.0:
        raise _error(f"a step of {goal!r}", "give .01 to 1 m/s or m")
    if not 0.5 <= duration <= 20.0 or not 0.5 <= level <= 0.999:
        raise _error(f"{duration!r} s at a level of {level!r}", "give .5 to 20 s, and .5 to .999")
    if isinstance(members, bool) or not isinstance(members, int) or not _LEAST_MEMBERS <= members <= _MOST_MEMBERS:
        raise _error(f"{shown(members)} members", f"give {_LEAST_MEMBERS} to {_MOST_MEMBERS}")
    rigs, diagrams = family.rigs(members, seed), tuple(controllers)
    flown = fly_lanes(
        rigs,
        setpoint,
        goal,
        duration,
        gains=gains,
        controllers=diagrams,
        read=(*CHANNELS, "true_x"),
        seed=1000 * seed,
        said=said,
    )
    lost = _lost(flown.channels, rigs, loop, goal)
    zeroed = _zeroed({name: np.nan_to_num(flown.channels[name], nan=1e6) for name in CHANNELS})
    low, middle, high = step_bands(zeroed, level)
    figures = {name: interval(values, level) for name, values in _figures(zeroed, loop, goal).items()}
    name = ", ".join(one.name for one in diagrams) or "the stock cascade"
    return RailPromise(name, family, loop, goal, level, members, seed, lost, low, high, middle, figures)


def _zeroed(flown: Mapping[str, Array]) -> dict[str, Array]:
    """From the step on, x from its mean before it."""
    x = flown["x"] - flown["x"][:BEFORE].mean(axis=0)
    return {"theta": flown["theta"][BEFORE:], "v": flown["v"][BEFORE:], "x": x[BEFORE:]}


def _figures(zeroed: Mapping[str, Array], loop: str, goal: float) -> dict[str, Array]:
    every = step_statistics(zeroed[STEPS[loop][1]], zeroed["theta"], zeroed["x"], goal)
    return {_NAMES.get(name, name): values for name, values in every.items()}


def _lost(flown: Mapping[str, Array], rigs: list[dict[str, float]], loop: str, goal: float) -> float:
    """The share that met a stop of the rail, or is not within half of the step at the end."""
    stops = np.array([rig["rail_stop"] for rig in rigs])
    met = np.abs(flown["true_x"]).max(axis=0) > stops - 1e-3
    end = flown[STEPS[loop][1]][-BEFORE:].mean(axis=0)
    return float(np.mean(met | ~(np.abs(end - goal) < 0.5 * goal)))


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "rail_promise", remedy)
