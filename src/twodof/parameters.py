"""Table of the flight code's parameters, and `ParameterSet`: bounded values that change together.

A row has the path in the flight code, the MAVLink name, default, bounds, unit and text of a parameter.
The blocks of the flight code, the gains, the vehicle's list, its metadata and the tables of the documentation derive
from the rows. A row without a wire name is set by its path in a simulation, and not in flight.

A wire name has at most 16 characters, as MAVLink's PARAM_SET carries it. Where the real drone has the parameter too,
`drone` is what QGroundControl calls it there, and a ParameterSet answers to either name. Bounds are the drone's where
it has them.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from twodof.errors import ParameterError, is_number, outside

NAME_LENGTH = 16
_VERSION = 1


@dataclass(frozen=True)
class Parameter:
    """Tunable number with `low` <= value <= `high` in `unit`; a whole number if its kind is "int32".

    `path` is its place in the flight code, "" for none. A `tuning` parameter may be changed without the command lease.
    """

    name: str
    default: float
    low: float
    high: float
    unit: str
    text: str
    drone: str = ""
    kind: Literal["float", "int32"] = "float"
    path: str = ""
    tuning: bool = False

    def __post_init__(self) -> None:
        if not 1 <= len(self.name) <= NAME_LENGTH or not self.name.isascii():
            remedy = "shorten it: MAVLink has no more room"
            raise ParameterError(f"a name has 1 to {NAME_LENGTH} ASCII characters", self.name, remedy)
        if not all(isfinite(bound) for bound in (self.low, self.default, self.high)):
            raise ParameterError("default and bounds must be finite", self.name, "give a number for each")
        if not self.low <= self.default <= self.high:
            raise ParameterError(f"default {self.default:g} is outside {self.low:g} to {self.high:g}", self.name)
        whole = all(float(number).is_integer() for number in (self.low, self.default, self.high))
        if self.kind == "int32" and not (whole and -(2**31) <= self.low <= self.high < 2**31):
            raise ParameterError("default and bounds must be whole numbers of 32 bits", self.name)

    def kept(self, value: float) -> float:
        """Return `value` in the type that a set stores: int for int32, else float."""
        return int(value) if self.kind == "int32" else float(value)


class Tunable(NamedTuple):
    """A row of `TUNABLES`. The default's type is the parameter's: float, int (a whole number) or bool (a flag)."""

    path: str
    name: str
    default: float
    low: float
    high: float
    unit: str
    text: str
    drone: str = ""
    tuning: bool = False


# By timer of the failsafe: name on the wire, default, bounds, text of its timeout.
_TIMERS: tuple[tuple[Any, ...], ...] = (
    ("setpoint", "SAFE_SP_T", 0.5, 0.02, 0.9, "silence of set-points after which it levels"),
    ("link", "SAFE_LINK_T", 3.0, 0.1, 30.0, "silence of the link after which it descends (heartbeats come at 1 Hz)"),
    ("imu", "SAFE_IMU_T", 0.02, 0.004, 0.1, "silence or repetition of the IMU after which the motors stop"),
    ("axis", "SAFE_AXIS_T", 0.1, 0.02, 1.0, "repetition of an axis of the IMU after which the motors stop"),
    ("range", "SAFE_RANGE_T", 0.24, 0.06, 2.0, "time without an accepted range after which it descends"),
    ("range_stuck", "SAFE_RANGE_STK_T", 0.5, 0.06, 5.0, "time of unchanged range after which it descends"),
    ("brake", "SAFE_BRAKE_T", 3.0, 0.1, 10.0, "longest time of braking, then the motors stop"),
    ("battery_low", "SAFE_BAT_LOW_T", 1.0, 0.004, 30.0, "time of low voltage until it counts"),
    ("battery_critical", "SAFE_BAT_CRIT_T", 0.5, 0.004, 10.0, "time of critical voltage until it descends"),
    ("late", "SAFE_LATE_T", 0.008, 0.004, 0.008, "time of late steps in a row after which the motors stop"),
    ("stuck", "SAFE_STK_T", 0.5, 0.02, 5.0, "time of unchanged commands after which they are rejected"),
)

# By block: member of the block, name on the wire, default, bounds, unit, text, the real drone's name, for tuning.
_BLOCKS: Mapping[str, tuple[tuple[Any, ...], ...]] = {
    "cascade.rate": (
        ("kp", "RATE_KP", 0.0854, 0.0, 0.12, "s/rad", "rate loop, proportional gain", "FC_PARAM_4", True),
        ("ki", "RATE_KI", 0.251, 0.0, 0.5, "1/rad", "rate loop, integral gain", "FC_PARAM_5", True),
        ("kd", "RATE_KD", 0.00054, 0.0, 0.003, "s^2/rad", "rate loop, derivative gain", "FC_PARAM_6", True),
        ("N", "RATE_N", 100.0, 1.0, 250.0, "rad/s", "rate loop, corner of the derivative's filter", "", True),
        ("limit", "M_MAX", 1.0, 0.0, 1.0, "-", "limit of the moment commanded"),
    ),
    "cascade.attitude": (
        ("kp", "ATT_KP", 11.0, 0.0, 15.0, "1/s", "attitude loop, proportional gain", "FC_PARAM_11", True),
        ("limit", "", 20.0, 0.0, inf, "rad/s", "largest rate set-point"),
    ),
    "cascade.velocity": (
        ("kp", "VEL_KP", 2.4, 0.0, 4.0, "N s/m", "velocity loop, proportional gain", "FC_PARAM_13", True),
        ("ki", "VEL_KI", 2.81, 0.0, 4.0, "N/m", "velocity loop, integral gain", "FC_PARAM_14", True),
    ),
    "cascade.position": (
        ("kp", "POS_KP", 1.5, 0.0, 2.5, "1/s", "position loop, proportional gain", "FC_PARAM_19", True),
        ("limit", "", 1.0, 0.0, inf, "m/s", "largest velocity set-point"),
    ),
    "cascade.projection": (
        ("T_bar", "THRUST_BAR", 0.4, 0.05, 1.0, "-", "thrust held while flying level"),
        ("eta_T", "THRUST_ETA", 6.3386, 1.0, 20.0, "N", "force at full thrust, of the projection to theta0"),
    ),
    "hold": (
        ("settle", "", 2.0, 0.0, 60.0, "s", "wait before the mean is taken"),
        ("window", "", 5.0, 0.1, 60.0, "s", "memory of the mean"),
    ),
    "arming": (("samples", "", 3, 0, 1000, "", "samples of reset after arming"),),
    "failsafe": (("descent", "SAFE_DESCENT", 1.0, 0.1, 10.0, "s", "time in which the thrust fades"),),
    "failsafe.sensors": (
        ("range_error", "SAFE_RANGE_ERR", 0.1, 0.02, 1.0, "m", "range further from the estimate is rejected"),
        ("range_end", "SAFE_RANGE_END", 0.39, 0.05, 0.45, "m", "range from the middle at which the motors stop"),
        ("range_old", "SAFE_RANGE_OLD", 0.2, 0.02, 1.0, "s", "older range is rejected"),
        ("watch_bits", "SAFE_WATCH_BITS", True, 0, 1, "", "a sensor that repeats the same bits is stuck"),
    ),
    "failsafe.place": (
        ("pitch_limit", "SAFE_PITCH_LIM", 0.8, 0.2, 0.87, "rad", "pitch beyond which the drone is levelled"),
        ("pitch_margin", "SAFE_PITCH_MARG", 0.1, 0.01, 0.3, "rad", "hysteresis of the pitch limit"),
        ("look_ahead", "SAFE_LOOK_AHEAD", 0.06, 0.0, 0.2, "s", "time by which the pitch is extrapolated"),
        ("pitch_end", "SAFE_PITCH_END", 0.85, 0.2, 0.87, "rad", "pitch at which the motors stop"),
        ("theta_bound", "SAFE_THETA_BOUND", 1.2, 0.9, 3.0, "rad", "larger estimates of the pitch are rejected"),
        ("q_bound", "SAFE_Q_BOUND", 30.0, 5.0, 60.0, "rad/s", "larger estimates of the pitch rate are rejected"),
        ("arm_tilt", "SAFE_ARM_TILT", 0.3, 0.02, 0.8, "rad", "largest pitch at arming"),
        ("rail_limit", "SAFE_RAIL_LIM", 0.37, 0.05, 0.4, "m", "place beyond which the cart is braked"),
        ("rail_margin", "SAFE_RAIL_MARG", 0.03, 0.005, 0.1, "m", "hysteresis of the rail's limit"),
        ("reaction", "SAFE_REACTION", 0.25, 0.0, 0.5, "s", "time until braking takes hold"),
        ("braking", "SAFE_BRAKING", 3.0, 0.5, 10.0, "m/s2", "deceleration that braking is sure to reach"),
        ("rail_end", "SAFE_RAIL_END", 0.395, 0.05, 0.45, "m", "place at which the motors stop"),
    ),
    "failsafe.force": (
        ("imu_below", "SAFE_IMU_BELOW", 0.012, -0.2, 0.2, "m", "IMU under the bearing"),
        ("imu_ahead", "SAFE_IMU_AHEAD", 0.013, -0.2, 0.2, "m", "IMU ahead of the bearing"),
        ("pull", "SAFE_PULL", 12.5, 1.0, 100.0, "m/s2", "full thrust over the mass that slides"),
        ("pull_share", "SAFE_PULL_SHARE", 0.3, 0.05, 1.0, "", "share of the pull that may be missing, or more"),
        ("drag", "SAFE_DRAG", 0.9, 0.0, 10.0, "1/s", "friction of the rail over the mass"),
        ("along_slack", "SAFE_ALONG_SLACK", 0.3, 0.1, 5.0, "m/s2", "acceleration along the rail left unexplained"),
        ("along_limit", "SAFE_ALONG_LIM", 0.15, 0.05, 2.0, "m/s", "unexplained speed along it: motors off"),
        ("hit_slack", "SAFE_HIT_SLACK", 2.0, 0.5, 20.0, "m/s2", "acceleration along it left unexplained, of an impact"),
        ("hit_limit", "SAFE_HIT_LIM", 0.08, 0.02, 2.0, "m/s", "unexplained speed along it of an impact: motors off"),
        ("up_slack", "SAFE_UP_SLACK", 0.8, 0.1, 5.0, "m/s2", "vertical acceleration left unexplained"),
        ("up_limit", "SAFE_UP_LIM", 0.3, 0.05, 2.0, "m/s", "unexplained vertical speed: motors off"),
    ),
    "failsafe.motion": (
        ("band", "SAFE_MOTION_BAND", 2.0, 0.5, 10.0, "1/s", "slower motion is not compared with the range"),
        ("slack", "SAFE_MOTION_SLK", 0.015, 0.005, 0.2, "m", "distance from the range left unexplained"),
        ("share", "SAFE_MOTION_SHR", 0.3, 0.05, 1.0, "", "share of the expected motion left unexplained"),
        ("limit", "SAFE_MOTION_LIM", 0.002, 0.0005, 0.1, "m*s", "unexplained distance, summed: it descends"),
    ),
    "failsafe.rate": (
        ("turn", "SAFE_TURN", 165.0, 10.0, 2000.0, "rad/s2", "angular acceleration of one pair at full thrust"),
        ("curve", "SAFE_CURVE", 0.3, 0.0, 1.0, "", "quadratic share of a pair's thrust curve"),
        ("answer", "SAFE_ANSWER", 0.021, 0.004, 0.2, "s", "delay and lag of the rotors"),
        ("swing", "SAFE_SWING", 9.5, 0.0, 100.0, "rad/s2", "angular acceleration back to level, of the sine"),
        ("turn_slack", "SAFE_TURN_SLACK", 10.0, 1.0, 100.0, "rad/s2", "angular acceleration left unexplained"),
        ("turn_share", "SAFE_TURN_SHARE", 0.3, 0.05, 1.0, "", "share of the expected acceleration left unexplained"),
        ("turn_limit", "SAFE_TURN_LIM", 1.5, 0.2, 10.0, "rad/s", "unexplained pitch rate: motors off"),
    ),
    "failsafe.battery": (
        ("low", "SAFE_BAT_LOW", 11.1, 0.0, 60.0, "V", "low voltage: no arming (3.7 V a cell)"),
        ("critical", "SAFE_BAT_CRIT", 10.5, 0.0, 60.0, "V", "critical voltage: it descends (3.5 V a cell)"),
        ("margin", "SAFE_BAT_MARG", 0.2, 0.01, 2.0, "V", "hysteresis of both"),
        ("high", "SAFE_BAT_HIGH", 13.5, 0.0, 65.0, "V", "higher voltage is rejected (4.5 V a cell)"),
    ),
    **{f"failsafe.{timer}": (("timeout", *row, "s", text),) for timer, *row, text in _TIMERS},
    "failsafe.level_lasts": (("time", "SAFE_LEVEL_LASTS", 0.5, 0.02, 5.0, "s", "levelling lasts at least"),),
    "failsafe.brake_lasts": (("time", "SAFE_BRAKE_LASTS", 0.5, 0.02, 5.0, "s", "braking lasts at least"),),
    "failsafe.machine": (
        ("level_limit", "SAFE_LEVEL_LIM", 10.0, 0.1, 60.0, "s", "longest time of level and brake, then it descends"),
    ),
    "failsafe.safe": (
        ("thrust_held", "SAFE_THRUST_HELD", 0.6, 0.0, 1.0, "", "most thrust that is held while levelling"),
        ("rail_hold", "SAFE_RAIL_HOLD", 0.1, 0.0, 0.36, "m", "farthest place that braking goes to"),
        ("brake_x", "SAFE_BRAKE_X", 0.8, 0.0, 5.0, "rad/m", "pitch of braking per metre beyond that place"),
        ("brake_v", "SAFE_BRAKE_V", 0.8, 0.0, 5.0, "rad*s/m", "pitch of braking per speed"),
        ("brake_tilt", "SAFE_BRAKE_TILT", 0.55, 0.05, 0.7, "rad", "largest pitch of braking"),
        ("x0_limit", "X0_MAX", 0.3, 0.0, 0.4, "m", "limit of the position set-point"),
        ("v0_limit", "SAFE_V0_LIM", 0.5, 0.0, 2.0, "m/s", "largest velocity set-point"),
        ("theta0_limit", "SAFE_THETA0_LIM", 0.6, 0.0, 0.8, "rad", "largest pitch set-point"),
        ("q0_limit", "SAFE_Q0_LIM", 20.0, 0.0, 20.0, "rad/s", "largest pitch-rate set-point"),
    ),
    "estimator.filter": (
        ("sigma_gyro", "", 0.002, 0.0, inf, "rad/s/sqrt(Hz)", "gyro noise density"),
        ("sigma_walk", "", 0.0001, 0.0, inf, "rad/s/sqrt(s)", "walk of the gyro's bias"),
        ("sigma_a", "", 0.02, 0.0, inf, "m/s2/sqrt(Hz)", "noise density of the acceleration"),
        ("sigma_range", "", 0.016, 1e-06, inf, "m", "range noise"),
        ("sigma_gravity", "", 20.0, 0.01, inf, "m/s2", "noise of the acceleration that shows the tilt, one sample"),
        ("sigma_theta_0", "", 0.02, 0.0, inf, "rad", "uncertainty of the first pitch"),
        ("sigma_bias_0", "", 0.01, 0.0, inf, "rad/s", "uncertainty of the first bias"),
        ("sigma_x_0", "", 1.0, 0.0, inf, "m", "uncertainty of x before the first range sample"),
        ("sigma_v_0", "", 0.01, 0.0, inf, "m/s", "uncertainty of the first velocity"),
    ),
    "estimator.pitch": (
        ("sigma_gyro", "", 0.004, 0.0, inf, "rad/s/sqrt(Hz)", "gyro noise density"),
        ("sigma_walk", "", 0.0007, 0.0, inf, "rad/s/sqrt(s)", "walk of the gyro's bias"),
        ("sigma_acc", "", 5.0, 0.01, inf, "m/s2", "horizontal acceleration and vibration, one sample"),
        ("sigma_theta_0", "", 0.05, 0.0, inf, "rad", "uncertainty of the first pitch"),
        ("sigma_bias_0", "", 0.01, 0.0, inf, "rad/s", "uncertainty of the first bias"),
    ),
    "estimator.position": (
        ("k_x", "", 0.16, 0.0, 1.0, "", "share of the innovation that corrects x"),
        ("k_v", "", 0.56, 0.0, 20.0, "1/s", "correction of v for an innovation of 1 m"),
        ("bias", "", 0.0, -5.0, 5.0, "m/s2", "added to the acceleration; 0 on board"),
        ("lag", "", 0.1, 0.0, 10.0, "s", "time in which the output's x follows the filter's"),
        ("sigma_a", "", 0.05, 0.0, inf, "m/s2/sqrt(Hz)", "noise density of the acceleration"),
        ("sigma_walk", "", 0.005, 0.0, inf, "m/s2/sqrt(s)", "walk of the accelerometer's bias"),
        ("sigma_tof", "", 0.004, 1e-06, inf, "m", "range noise"),
        ("sigma_v_0", "", 0.02, 0.0, inf, "m/s", "uncertainty of the first velocity"),
        ("sigma_bias_0", "", 0.05, 0.0, inf, "m/s2", "uncertainty of the first bias"),
    ),
}

TUNABLES: Mapping[str, Tunable] = MappingProxyType(
    {f"{block}.{row[0]}": Tunable(f"{block}.{row[0]}", *row[1:]) for block, rows in _BLOCKS.items() for row in rows}
)
"""The rows by their path in the flight code."""


def _on_the_wire(row: Tunable) -> Parameter:
    kind: Literal["float", "int32"] = "float" if isinstance(row.default, float) else "int32"
    numbers = float(row.default), float(row.low), float(row.high)
    return Parameter(row.name, *numbers, row.unit, row.text, row.drone, kind, row.path, row.tuning)


FLIGHT_PARAMETERS: tuple[Parameter, ...] = tuple(_on_the_wire(row) for row in TUNABLES.values() if row.name)
"""Parameters that a client can change on a drone: all rows that have a wire name."""

PARAMETERS: tuple[Parameter, ...] = tuple(row for row in FLIGHT_PARAMETERS if not row.name.startswith("SAFE_"))
"""Parameters that tune the flight: gains, thrust and limits. The other flight parameters are the failsafe's."""

PRESETS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "default": MappingProxyType({}),
        "student": MappingProxyType(
            {
                "RATE_KP": 0.0651,
                "RATE_KI": 0.35,
                "RATE_KD": 0.000896,
                "ATT_KP": 6.1986,
                "VEL_KP": 2.19,
                "VEL_KI": 1.46,
                "POS_KP": 0.7,
            }
        ),
    }
)
"""Sets of values flown on the real drone, as differences from the defaults."""


def float32_decimal(value: float) -> float:
    """Return the shortest decimal number with the same float32 as `value`; NaN and infinities unchanged."""
    if not is_number(value, -3e38, 3e38):
        return value
    return float(str(np.float32(value)))


class ParameterSet(Mapping[str, float]):
    """Values of a table of parameters, always complete and valid.

    A change takes effect entirely or not at all. `revision` counts the changes, by which a reader notices them.
    """

    def __init__(self, values: Mapping[str, float] | None = None, table: tuple[Parameter, ...] = PARAMETERS) -> None:
        """Take the defaults of `table`, then change them to `values`. Raises ParameterError as `update` does."""
        self._rows = {row.name: row for row in table}
        self._alias = {row.drone: row.name for row in table if row.drone}
        counts = Counter(name for row in table for name in (row.name, row.drone) if name)
        if twice := [name for name, count in counts.items() if count > 1]:
            what = "two parameters have the same name"
            raise ParameterError(what, ", ".join(twice), "give one of them another name")
        self._values: Mapping[str, float] = {row.name: row.kept(row.default) for row in table}
        self._values = {**self._values, **self._checked(values or {})}
        self.revision = 0

    def __getitem__(self, name: str) -> float:
        """Return a value by its wire name or the real drone's name. Raises ParameterError for an unknown name."""
        return self._values[self.row(name).name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self._rows or name in self._alias

    def row(self, name: str) -> Parameter:
        """Return the row of a parameter by its wire name or the real drone's. Raises ParameterError for neither."""
        row = self._rows.get(self._alias.get(name, name))
        if row is None:
            raise ParameterError("no such parameter", str(name), f"use one of {', '.join(self._rows)}")
        return row

    def snapshot(self) -> dict[str, float]:
        """Return a copy of all values, consistent with each other, by name."""
        return dict(self._values)

    def set(self, name: str, value: float) -> None:
        """Change one value. Raises ParameterError as `update` does."""
        self.update({name: value})

    def update(self, changes: Mapping[str, float]) -> None:
        """Change several values together.

        Raises ParameterError, and then changes nothing, if a name is unknown, a parameter is named twice, or a value is
        not a finite number within its bounds. The message lists every fault.
        """
        checked = self._checked(changes)
        changed = {name: value for name, value in checked.items() if value != self._values[name]}
        if changed:
            self._commit({**self._values, **changed})

    def reset(self) -> None:
        """Set all values to their defaults."""
        self.update({row.name: row.default for row in self._rows.values()})

    def to_json(self) -> str:
        """Return the values as JSON; numbers read back to the same bits."""
        return json.dumps({"version": _VERSION, "parameters": self.snapshot()}, indent=2)

    def load_json(self, text: str) -> None:
        """Set the values in a JSON text of `to_json`, which need not name all parameters.

        Raises ParameterError for another text or an invalid value, and then changes nothing.
        """
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as reason:
            raise ParameterError(f"the text is not JSON: {reason}", "parameters", "write it with to_json") from reason
        if not isinstance(content, dict) or content.get("version") != _VERSION:
            raise ParameterError(f'it has no "version": {_VERSION}', "parameters", "write it with to_json")
        values = content.get("parameters")
        if not isinstance(values, dict):
            raise ParameterError("it has no table 'parameters'", "parameters", "write it with to_json")
        self.update(values)

    def check(self, changes: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
        """Return the valid values by wire name, as int or float, and a message for each invalid change."""
        good: dict[str, float] = {}
        faults = []
        for name, value in changes.items():
            fault = self._fault(name, value)
            if fault:
                faults.append(f"{name}: {fault}")
                continue
            row = self.row(name)
            if row.name in good:
                faults.append(f"{name}: given twice")
            good[row.name] = row.kept(value)
        return good, faults

    def _checked(self, changes: Mapping[str, float]) -> dict[str, float]:
        good, faults = self.check(changes)
        if faults:
            raise ParameterError("; ".join(faults), "parameters", "nothing was changed")
        return good

    def _fault(self, name: str, value: float) -> str:
        """Describe the fault of a value; "" without one."""
        if name not in self:
            return f"no such parameter; there are {', '.join(self._rows)}"
        row = self.row(name)
        # bool is a number to Python, and `True` for a gain is a mistake
        if isinstance(value, bool) or not isinstance(value, Real):
            return f"{value!r} is not a number"
        if isinstance(value, int) and abs(value) > 2**1000:  # beyond any float, which isfinite does not take
            value = inf if value > 0 else -inf
        if not isfinite(value) or not row.low <= value <= row.high:
            return outside(float(value), row.low, row.high, row.unit)
        if row.kind == "int32" and not float(value).is_integer():
            return f"{float(value):g} is not a whole number"
        return ""

    def _commit(self, values: Mapping[str, float]) -> None:
        # One assignment: a reader in another thread sees the old set or the new one, never a mixture.
        self._values = values
        self.revision += 1
