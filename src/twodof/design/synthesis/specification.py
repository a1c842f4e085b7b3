"""Specification: what is asked of the pitch loop, as a TOML file that a person writes."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

from twodof.design.synthesis.specification_table import check_figures, read_tables, table_of
from twodof.errors import ParameterError

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
        check_figures(vars(self), _BOUNDS, "step_deg")

    @classmethod
    def of(cls, data: object, where: str = "specification") -> Self:
        """From the parsed file. Raises ParameterError for another table, an unknown name or a figure out of range."""
        given = table_of(data, "pitch", [field.name for field in fields(cls)], where)
        try:
            return cls(**given)
        except ParameterError as error:
            raise ParameterError(error.what, where, error.remedy) from error

    def to_json(self) -> dict[str, Any]:
        """What is asked, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}


def read_specification(path: str | Path) -> Specification:
    """The specification in a TOML file. Raises ParameterError for one that cannot be read or is not one."""
    return Specification.of(read_tables(path, "pitch", "bandwidth = 6.0"), str(path))
