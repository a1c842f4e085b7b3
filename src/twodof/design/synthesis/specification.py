"""Specification: what is asked of the pitch loop, as a TOML file that a person writes."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

from twodof.errors import LogError, ParameterError, listed, nearest, shown
from twodof.flightlog.provenance import read_bytes

MAX_BYTES = 1 << 20

_BOUNDS: Mapping[str, tuple[float, float]] = {
    "bandwidth": (0.1, 100.0),
    "gain_margin_db": (0.0, 40.0),
    "phase_margin_deg": (0.0, 120.0),
    "delay_margin": (0.0, 1.0),
    "peak_sensitivity": (1.0, 100.0),
    "rise_time": (0.005, 20.0),
    "overshoot": (0.0, 5.0),
    "peak_moment": (1e-3, 1.0),
    "step_deg": (0.1, 45.0),
}


@dataclass(frozen=True)
class Specification:
    """Each figure that is not None is asked for; the table `[pitch]` of a file has the same names.

    At least: `bandwidth` [rad/s], where theta follows theta_0 by -3 dB; of the loop broken at M, `gain_margin_db`,
    `phase_margin_deg` and `delay_margin` [s]. At most: `peak_sensitivity`, the largest |S| of that loop. Three more
    hold for 95 % of the flights of a step by `step_deg`: `rise_time` [s], `overshoot` (a share) and `peak_moment`.
    `peak_moment` is the largest |M| about its trim. Raises ParameterError for a figure out of range.
    """

    bandwidth: float | None = None
    gain_margin_db: float | None = None
    phase_margin_deg: float | None = None
    delay_margin: float | None = None
    peak_sensitivity: float | None = None
    rise_time: float | None = None
    overshoot: float | None = None
    peak_moment: float | None = None
    step_deg: float = 10.0

    def __post_init__(self) -> None:
        for name, (low, high) in _BOUNDS.items():
            value = getattr(self, name)
            if value is None and name != "step_deg":
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
            if not (number and low <= value <= high):
                raise ParameterError(f"{name} = {shown(value)}", "specification", f"give {low:g} to {high:g}")

    @classmethod
    def of(cls, data: object, where: str = "specification") -> Self:
        """From the parsed file. Raises ParameterError for another table, an unknown name or a figure out of range."""
        # The table [rail] of the same file is read by `sim.promised.rail_specification`.
        if not isinstance(data, Mapping) or not isinstance(data.get("pitch"), Mapping) or set(data) - {"pitch", "rail"}:
            found = listed(data) if isinstance(data, Mapping) else shown(data)
            raise ParameterError(f"it has {found}", where, "give a table [pitch]")
        known = [field.name for field in fields(cls)]
        for name in data["pitch"]:
            if name not in known:
                raise ParameterError(f"nothing is called {shown(name)}", where, f"there are: {nearest(name, known)}")
        try:
            return cls(**data["pitch"])
        except ParameterError as error:
            raise ParameterError(error.what, where, error.remedy) from error

    def to_json(self) -> dict[str, Any]:
        """What is asked, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}


def read_specification(path: str | Path) -> Specification:
    """The specification in a TOML file. Raises ParameterError for one that cannot be read or is not one."""
    try:
        return Specification.of(tomllib.loads(read_bytes(path, MAX_BYTES).decode("utf-8")), str(path))
    except LogError as reason:
        raise ParameterError(reason.what, str(path), "name a TOML file with a table [pitch]") from reason
    except (ValueError, RecursionError) as reason:
        raise ParameterError(
            f"it is not TOML: {reason!s:.80}", str(path), "write [pitch], and below it lines as: bandwidth = 6.0"
        ) from reason
