"""Specification: requirements on the loops, as a TOML file that a person writes, and the check of a controller."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np

from twodof.design.margins import LoopMargins, margins
from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import PitchLoop
from twodof.design.promise import STEPS, Promise
from twodof.design.sampled_controller import SampledController
from twodof.errors import LogError, ParameterError, finite, is_number, listed, nearest, shown
from twodof.flightlog.provenance import read_bytes, text_of

MAX_BYTES = 1 << 20
_HALF_POWER = math.sqrt(0.5)


class RequiredFigure(NamedTuple):
    """A figure that a specification may require, with a value from `low` to `high`.

    `of_step` names the figure of a promise to which the requirement applies, "" if it applies to a loop. `factor`
    converts SI units to the unit of the file. The value is an upper limit if `at_most`, otherwise a lower limit.
    """

    low: float
    high: float
    at_most: bool = False
    of_step: str = ""
    factor: float = 1.0


def _required(low: float, high: float, **figure: Any) -> Any:
    """Return an optional field of a specification, with its `RequiredFigure`."""
    return field(default=None, metadata={"figure": RequiredFigure(low, high, **figure)})


_STEP_BOUNDS = {"step_deg": (0.1, 45.0), "step": (0.01, 1.0)}
_PITCH_ONLY = ("bandwidth", "peak_moment", "step_deg")
_RAIL_ONLY = ("velocity_bandwidth", "position_bandwidth", "peak_theta_deg", "rail_use", "step", "loop")
TABLES: Mapping[str, tuple[str, ...]] = MappingProxyType({"pitch": _RAIL_ONLY, "rail": _PITCH_ONLY})
"""Tables of a file, each with the names that it must not have."""


@dataclass(frozen=True)
class Specification:
    """Requirements on a controller: each figure that is not None. The tables `[pitch]` and `[rail]` use these names.

    `[pitch]`: at least `bandwidth` [rad/s], where theta follows theta_0 by -3 dB. `gain_margin_db`, `phase_margin_deg`,
    `delay_margin` [s] (at least) and `peak_sensitivity`, the largest |S| (at most), are of the loop broken at M. Three
    more are at most, for 95 % of the flights of a step by `step_deg`: `rise_time` [s], `overshoot` (a share) and
    `peak_moment`, the largest |M| about its trim.

    `[rail]`: at least `velocity_bandwidth` and `position_bandwidth` [rad/s] of each closed loop; margins and
    `peak_sensitivity` are those of both loops. Of a `step` [m/s or m] of `loop` ("velocity" or "position") it has
    `rise_time`, `overshoot`, `peak_theta_deg` and `rail_use` [m].

    `loop` "attitude" is the table `[pitch]`. Raise ParameterError for a figure out of range, and for a figure that the
    other table has.
    """

    bandwidth: float | None = _required(0.1, 100.0)
    velocity_bandwidth: float | None = _required(0.01, 100.0)
    position_bandwidth: float | None = _required(0.01, 100.0)
    gain_margin_db: float | None = _required(0.0, 40.0)
    phase_margin_deg: float | None = _required(0.0, 120.0)
    delay_margin: float | None = _required(0.0, 10.0)
    peak_sensitivity: float | None = _required(1.0, 100.0, at_most=True)
    rise_time: float | None = _required(0.005, 20.0, at_most=True, of_step="rise_time")
    overshoot: float | None = _required(0.0, 5.0, at_most=True, of_step="overshoot")
    peak_moment: float | None = _required(1e-3, 1.0, at_most=True, of_step="peak_M")
    peak_theta_deg: float | None = _required(0.1, 60.0, at_most=True, of_step="peak_theta", factor=180.0 / math.pi)
    rail_use: float | None = _required(0.01, 2.0, at_most=True, of_step="rail_use")
    step_deg: float = 10.0
    step: float = 0.15
    loop: str = "attitude"

    def __post_init__(self) -> None:
        if self.loop not in tuple(STEPS):
            what = f"loop = {shown(self.loop)} is not a loop"
            raise ParameterError(what, "specification", f"give {' or '.join(STEPS)}")
        for name, (low, high) in {**{name: FIGURES[name][:2] for name in self.required}, **_STEP_BOUNDS}.items():
            value = getattr(self, name)
            if not is_number(value, low, high):
                what = f"{name} = {shown(value)} is out of range"
                raise ParameterError(what, "specification", f"give a number from {low:g} to {high:g}")
        if foreign := [name for name in TABLES[self.table] if name in self.required]:
            what = f"{foreign[0]} does not apply to the {self.loop} loop"
            raise ParameterError(what, "specification", "leave it out")

    @property
    def table(self) -> str:
        """Return the name of the file's table for this loop."""
        return "pitch" if self.loop == "attitude" else "rail"

    @property
    def goal(self) -> float:
        """Return the size of the step [rad, m/s or m]."""
        return math.radians(self.step_deg) if self.loop == "attitude" else self.step

    @property
    def required(self) -> dict[str, float]:
        """Return the required figures by name."""
        return {name: value for name in FIGURES if (value := getattr(self, name)) is not None}

    @property
    def of_loops(self) -> Self | None:
        """Return the requirements on the loops; None if there are none."""
        return self._only(step=False)

    @property
    def of_step(self) -> Self | None:
        """Return the requirements on the flights of a step; None if there are none."""
        return self._only(step=True)

    def _only(self, step: bool) -> Self | None:
        nothing: dict[str, Any] = {name: None for name, figure in FIGURES.items() if bool(figure.of_step) != step}
        found = replace(self, **nothing)
        return found if found.required else None

    @classmethod
    def of(cls, data: object, where: str = "specification", table: str = "pitch") -> Self:
        """Return the specification in a `table` of a parsed file.

        Raise ParameterError for a file without the table, an unknown name or a figure out of range.
        """
        found = data.get(table) if isinstance(data, Mapping) else None
        if not isinstance(data, Mapping) or not isinstance(found, Mapping) or set(data) - set(TABLES):
            has = listed(data) if isinstance(data, Mapping) else shown(data)
            raise ParameterError(f"the file has {has}", where, f"give the table [{table}]; others are {listed(TABLES)}")
        names = [field.name for field in fields(cls) if field.name not in TABLES[table]]
        for name in found:
            if name not in names:
                what = f"{shown(name)} is not a name in [{table}]"
                raise ParameterError(what, where, f"choose one of {nearest(name, names)}")
        given = {"loop": "velocity" if table == "rail" else "attitude", **found}
        if table == "rail" and given["loop"] == "attitude":
            raise ParameterError("loop = 'attitude' does not belong in [rail]", where, "give velocity or position")
        try:
            return cls(**given)
        except ParameterError as error:
            raise ParameterError(error.what, where, error.remedy) from error


FIGURES: Mapping[str, RequiredFigure] = MappingProxyType(
    {one.name: one.metadata["figure"] for one in fields(Specification) if one.metadata}
)


def read_specification(path: str | Path, table: str = "pitch") -> Specification:
    """Return the specification in a `table` of a TOML file. Raise ParameterError for a file without or with faults."""
    line = "bandwidth = 6.0" if table == "pitch" else "overshoot = 0.2"
    try:
        data = tomllib.loads(text_of(read_bytes(path, MAX_BYTES)))
    except LogError as reason:
        raise ParameterError(reason.what, str(path), f"name a TOML file with a table [{table}]") from reason
    except (ValueError, RecursionError) as reason:
        raise ParameterError(
            f"the file is not TOML: {reason!s:.80}", str(path), f"write [{table}], and below it lines such as {line}"
        ) from reason
    return Specification.of(data, str(path), table)


@dataclass(frozen=True)
class Requirement:
    """One required figure: the controller has `got`, which must be at least `asked`, or at most if `at_most`."""

    name: str
    asked: float
    got: float
    at_most: bool

    @property
    def met(self) -> bool:
        """Return True if the figure is met; NaN is not."""
        return self.got <= self.asked if self.at_most else self.got >= self.asked

    @property
    def text(self) -> str:
        """Return the requirement as a line."""
        way = "at most" if self.at_most else "at least"
        return (
            f"{'ok    ' if self.met else 'MISSED'} {self.name.replace('_', ' ')}: {self.got:.4g}, {way} {self.asked:g}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {**finite(vars(self)), "met": self.met}


def check(
    specification: Specification, controller: SampledController, family: PitchFamily, promised: Promise | None = None
) -> tuple[Requirement, ...]:
    """Compare `controller` with each requirement of `specification` on the pitch, in its order.

    Bandwidth and margins are those of the family's estimate. A figure of the step is checked by the far end of the
    `promised` interval. Raise ParameterError if a step is asked for and `promised` is missing or of another step.
    """
    loop = PitchLoop(family.nominal(), controller)
    found = {"motors": margins(loop.loop_transfer())} if specification.of_loops is not None else {}
    return requirements(specification, found, {"bandwidth": bandwidth(loop)}, promised)


def requirements(
    specification: Specification,
    loops: Mapping[str, LoopMargins],
    bandwidths: Mapping[str, float],
    promised: Promise | None,
) -> tuple[Requirement, ...]:
    """Compare each requirement with the worst margins of `loops`, the `bandwidths` [rad/s] by name, and the promise.

    A figure of an unstable loop, and of a step with failed members, is NaN. Raise ParameterError if a step is asked for
    and `promised` is missing or of another step.
    """
    required = specification.required
    step = [name for name in required if FIGURES[name].of_step]
    other = promised is None or promised.loop != specification.loop or abs(promised.goal - specification.goal) > 1e-6
    if step and other:
        row = STEPS[specification.loop]
        size = f"{row.factor * specification.goal:g} {row.unit}"
        what = f"{', '.join(step)} are asked of a {specification.loop} step by {size}, which is not promised"
        raise ParameterError(what, "check", "promise that step")
    stable = all(one.stable for one in loops.values())
    rows = []
    for name, value in required.items():
        figure, got = FIGURES[name], math.nan
        if figure.of_step and promised is not None and promised.robust:
            got = figure.factor * promised.figures[figure.of_step][2]
        elif not figure.of_step and stable:
            margin = "ms" if name == "peak_sensitivity" else name
            worst = max if figure.at_most else min
            got = bandwidths[name] if name in bandwidths else worst(getattr(one, margin) for one in loops.values())
        rows.append(Requirement(name, value, float(got), figure.at_most))
    return tuple(rows)


def bandwidth(loop: PitchLoop) -> float:
    """Return the first frequency [rad/s] at which theta of the first member follows theta_0 by less than -3 dB."""
    omega = np.geomspace(0.01, 600.0, 3000)
    size = np.abs(loop.theta_response(omega)[0])
    below = np.flatnonzero(size < _HALF_POWER)
    return float(omega[below[0]]) if below.size else math.inf
