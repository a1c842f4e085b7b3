"""What a scenario feeds into an input: a constant, a step, a ramp, a sine, points; a value for each tick."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite, pi
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.elementary.functions import sin
from twodof.blocks.expressions import numbers
from twodof.compile.diagram_test.signal_table import MAX_AT
from twodof.compile.diagram_test.tick_times import first_tick
from twodof.errors import DiagramError, shown

Between = Literal["hold", "interpolate"]
MAX_HZ = 1e9
BETWEEN: tuple[Between, ...] = ("hold", "interpolate")


class InputSignal(ABC):
    """A function of time. The same values on every machine: no platform's libm computes them."""

    @abstractmethod
    def values(self, steps: int, dt: float, whole: bool = False) -> NDArray[np.float64]:
        """Its values at the ticks 0 .. steps - 1 of `dt` [s], of shape (steps,).

        `whole`: for an input that is an integer or a bool, where points are held and never interpolated.
        """


def _finite(what: str, *given: float) -> None:
    for number in given:
        if isinstance(number, str) or not isfinite(number):
            raise DiagramError(f"{shown(number)} is not a finite number", what, "give a number")


@dataclass(frozen=True)
class ConstantInput(InputSignal):
    """The same value always; NaN and infinity too, to see what a diagram makes of them."""

    value: float

    def values(self, steps: int, dt: float, whole: bool = False) -> NDArray[np.float64]:
        return np.full(steps, float(self.value))


@dataclass(frozen=True)
class StepInput(InputSignal):
    """`before`, and from the first tick at or after `at` [s] on `to`."""

    to: float
    at: float = 0.0
    before: float = 0.0

    def __post_init__(self) -> None:
        _finite("step", self.to, self.at, self.before)

    def values(self, steps: int, dt: float, whole: bool = False) -> NDArray[np.float64]:
        return np.where(np.arange(steps) >= first_tick(self.at, dt), float(self.to), float(self.before))


@dataclass(frozen=True)
class RampInput(InputSignal):
    """`before` until `start` [s], then it changes by `slope` [1/s] until `stop` [s] and stays."""

    slope: float
    start: float = 0.0
    stop: float = inf
    before: float = 0.0

    def __post_init__(self) -> None:
        _finite("ramp", self.slope, self.start, self.before)
        if not self.stop >= self.start:
            raise DiagramError(f"it stops at {self.stop} s and starts at {self.start} s", "ramp", "let it start before")

    def values(self, steps: int, dt: float, whole: bool = False) -> NDArray[np.float64]:
        time = np.minimum(np.arange(steps) * dt, self.stop)
        with np.errstate(over="ignore"):
            found: NDArray[np.float64] = self.before + self.slope * np.maximum(time - self.start, 0.0)
        return np.floor(found) if whole else found


@dataclass(frozen=True)
class SineInput(InputSignal):
    """offset + amplitude sin(2 pi hz t + phase), `phase` in rad."""

    amplitude: float
    hz: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        _finite("sine", self.amplitude, self.hz, self.phase, self.offset)
        if abs(self.hz) > MAX_HZ:
            raise DiagramError(f"hz = {self.hz:g}", "sine", f"give at most {MAX_HZ:g} Hz")

    def values(self, steps: int, dt: float, whole: bool = False) -> NDArray[np.float64]:
        turns = np.arange(steps) * dt * self.hz
        angles = 2.0 * pi * (turns - np.floor(turns)) + self.phase
        with numbers.precision("float64"):
            waves = np.array([float(sin(a)) for a in angles.tolist()])
        with np.errstate(over="ignore"):
            found = self.offset + self.amplitude * waves
        return np.floor(found) if whole else found


@dataclass(frozen=True)
class PointsInput(InputSignal):
    """Values at times: `points` are pairs (time [s], value), in the order of time; the first holds from the start.

    Between two points the value is that of the first ("hold") or on the line through both ("interpolate").
    """

    points: Sequence[tuple[float, float]]
    between: Between

    def __post_init__(self) -> None:
        if not self.points or any(len(p) != 2 for p in self.points):
            raise DiagramError("it has no pairs of time and value", "points", "write [[0.0, 1.0], [0.5, 2.0]]")
        times = [p[0] for p in self.points]
        _finite("points", *times)
        if any(b <= a for a, b in pairwise(times)) or max(map(abs, times)) > MAX_AT:
            raise DiagramError(f"the times do not increase to at most {MAX_AT:g} s", "points", "sort them, each once")
        check_between(self.between, "points")

    def values(self, steps: int, dt: float, whole: bool = False) -> NDArray[np.float64]:
        rows = np.array(self.points, dtype=float)
        return between_rows(rows[:, 0] / dt, rows[:, 1], steps, "hold" if whole else self.between)


def check_between(between: Any, where: str) -> Between:
    """`between` if it is "hold" or "interpolate"; else DiagramError."""
    if between not in BETWEEN:
        raise DiagramError(f"between = {shown(between)}", where, f"say what holds between rows: {' or '.join(BETWEEN)}")
    found: Between = between
    return found


def between_rows(
    ticks: NDArray[np.float64], values: NDArray[np.float64], steps: int, between: Between
) -> NDArray[np.float64]:
    """The values at the ticks 0 .. steps - 1 of rows at `ticks` (which increase and need not be whole).

    Before the first row its value holds, after the last one that of the last.
    """
    nearest = np.rint(ticks)
    ticks = np.where(np.abs(ticks - nearest) < 1e-6, nearest, ticks)
    k = np.arange(steps, dtype=float)
    left = np.clip(np.searchsorted(ticks, k, side="right") - 1, 0, None)
    if between == "hold":
        return values[left]
    right = np.minimum(left + 1, len(ticks) - 1)
    gap = np.where(right > left, ticks[right] - ticks[left], 1.0)
    share = np.clip((k - ticks[left]) / gap, 0.0, 1.0)
    with np.errstate(invalid="ignore", over="ignore"):
        between_both = values[left] + (values[right] - values[left]) * share
    found: NDArray[np.float64] = np.where((share == 0.0) | (right == left), values[left], between_both)
    return found
