"""RailSpecification: what is asked of the velocity and position loops, as the table [rail] of a TOML file."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

from twodof.blocks import Diagram
from twodof.design.synthesis.requirements import Requirement
from twodof.design.synthesis.specification_table import check_figures, read_tables, table_of
from twodof.errors import ParameterError, shown
from twodof.flight.gains import DEFAULT, Gains
from twodof.sim.linear.cascade_margins import cascade_margins
from twodof.sim.promised.rail_family import RailFamily
from twodof.sim.promised.rail_promise import STEPS, RailPromise

_BOUNDS: Mapping[str, tuple[float, float]] = {
    "velocity_bandwidth": (0.01, 100.0),
    "position_bandwidth": (0.01, 100.0),
    "gain_margin_db": (0.0, 40.0),
    "phase_margin_deg": (0.0, 120.0),
    "delay_margin": (0.0, 10.0),
    "peak_sensitivity": (1.0, 100.0),
    "rise_time": (0.005, 20.0),
    "overshoot": (0.0, 5.0),
    "peak_theta_deg": (0.1, 60.0),
    "rail_use": (0.01, 2.0),
    "step": (0.01, 1.0),
}
_PROMISED = {"rise_time": "rise_time", "overshoot": "overshoot", "peak_theta_deg": "peak_theta", "rail_use": "rail_use"}
_AT_MOST = ("peak_sensitivity", *_PROMISED)


@dataclass(frozen=True)
class RailSpecification:
    """Each figure that is not None is asked for; the table `[rail]` of a file has the same names.

    At least: `velocity_bandwidth` and `position_bandwidth` [rad/s], of each closed loop; of both loops
    `gain_margin_db`, `phase_margin_deg` and `delay_margin` [s]. At most: `peak_sensitivity`, the largest |S| of both.
    Four more are at most, for 95 % of the flights of a `step` [m/s or m] of `loop` ("velocity" or "position"):
    `rise_time` [s], `overshoot` (a share), `peak_theta_deg`, and `rail_use` [m]. Raises ParameterError for a figure out
    of range.
    """

    velocity_bandwidth: float | None = None
    position_bandwidth: float | None = None
    gain_margin_db: float | None = None
    phase_margin_deg: float | None = None
    delay_margin: float | None = None
    peak_sensitivity: float | None = None
    rise_time: float | None = None
    overshoot: float | None = None
    peak_theta_deg: float | None = None
    rail_use: float | None = None
    step: float = 0.15
    loop: str = "velocity"

    def __post_init__(self) -> None:
        if self.loop not in STEPS:
            raise ParameterError(f"loop = {shown(self.loop)}", "specification", f"give {' or '.join(STEPS)}")
        check_figures(vars(self), _BOUNDS, "step")

    @property
    def asked(self) -> dict[str, float]:
        """What is asked, by name."""
        return {name: float(value) for name, value in vars(self).items() if name in _BOUNDS and value is not None}

    @property
    def parts(self) -> tuple[Self | None, Self | None]:
        """What is asked of the loops, and what is asked of the flights of a step; None where that is nothing."""
        nothing: dict[str, Any] = dict.fromkeys(_PROMISED)
        no_loop: dict[str, Any] = dict.fromkeys(name for name in _BOUNDS if name not in (*_PROMISED, "step"))
        loops, step = replace(self, **nothing), replace(self, **no_loop)
        return loops if set(loops.asked) - {"step"} else None, step if set(step.asked) - {"step"} else None

    @classmethod
    def of(cls, data: object, where: str = "specification") -> Self:
        """From the parsed file. Raises ParameterError for another table, an unknown name or a figure out of range."""
        given = table_of(data, "rail", [field.name for field in fields(cls)], where)
        try:
            return cls(**given)
        except ParameterError as error:
            raise ParameterError(error.what, where, error.remedy) from error


def read_rail_specification(path: str | Path) -> RailSpecification:
    """The table [rail] of a TOML file. Raises ParameterError for one that cannot be read or is not one."""
    return RailSpecification.of(read_tables(path, "rail", "overshoot = 0.2"), str(path))


def check_rail(
    specification: RailSpecification,
    family: RailFamily,
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    promised: RailPromise | None = None,
) -> tuple[Requirement, ...]:
    """What `specification` asks of the cascade with `gains` and `controllers`, in its order.

    Bandwidths and margins are those of the estimate as it flies, sampled, with the estimator (`cascade_margins`); of
    both loops the worse one counts. What a step is asked for is the `promised` interval's far end. Raises
    ParameterError where the step is asked for and `promised` is missing or of another step.
    """
    asked = specification.asked
    step = [name for name in _PROMISED if name in asked]
    other = promised is None or promised.loop != specification.loop or abs(promised.goal - specification.step) > 1e-9
    if step and other:
        what = f"{', '.join(step)} are asked of a {specification.loop} step by {specification.step:g}"
        raise ParameterError(f"{what}, which is not promised", "check_rail", "promise that step")
    found = cascade_margins(gains, controllers, family.nominal(), tuple(STEPS)) if set(asked) - {*step, "step"} else {}
    stable = all(one.stable for one in found.values())
    rows = []
    for name, value in asked.items():
        if name == "step":
            continue
        if name in _PROMISED and promised is not None:
            got = promised.figures[_PROMISED[name]][2] if not promised.lost else math.nan
            got = math.degrees(got) if name == "peak_theta_deg" else got
        elif not stable:
            got = math.nan
        elif name.endswith("_bandwidth"):
            got = found[name.removesuffix("_bandwidth")].bandwidth
        elif name == "peak_sensitivity":
            got = max(one.ms for one in found.values())
        else:
            got = min(float(getattr(one, name)) for one in found.values())
        rows.append(Requirement(name, value, float(got), name in _AT_MOST))
    return tuple(rows)
