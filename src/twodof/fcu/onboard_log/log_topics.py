"""Topics of the on-board log: every number of a step in one row, and the topics of PX4.

PlotJuggler, Flight Review and pyulog show a flight by PX4's names. Topics and fields are those of PX4 v1.16 (msg/), as
far as this vehicle has them. Roll, yaw, y and z are 0: the rail is the local x axis. Values unknown in PX4 are NaN.
"""

from collections.abc import Callable
from dataclasses import fields
from operator import attrgetter
from struct import Struct
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flightlog.steps import ASKED, STEP_TOPIC, is_published
from twodof.signals import MODES, TICK_US

__all__ = ["FORMAT", "ROW", "STEP_TOPIC", "pack", "row_names"]

_CODES = {float: ("d", "double", "<f8"), bool: ("?", "bool", "u1"), int: ("i", "int32_t", "<i4")}
_PARTS = ("tick", "sample", "asked")


def _columns() -> list[tuple[str, type]]:
    """Return name and type of each number of a step, in order; requested inputs are called `asked_...`."""
    sample, asked, step = get_type_hints(SensorSample), get_type_hints(ControlInput), get_type_hints(ControlStep)
    return [
        *((name, sample[name]) for name in SensorSample._fields),
        *((ASKED + name, asked[name]) for name in ControlInput._fields),
        *((field.name, step[field.name]) for field in fields(ControlStep) if field.name not in _PARTS),
    ]


COLUMNS = _columns()
FORMAT = "uint64_t timestamp;uint32_t tick;" + "".join(f"{_CODES[kind][1]} {name};" for name, kind in COLUMNS)
"""ULog's format of a row: every number in the precision in which it was computed."""
ROW = np.dtype([("timestamp", "<u8"), ("tick", "<u4"), *((name, _CODES[kind][2]) for name, kind in COLUMNS)])
"""numpy's layout of a row, without padding."""

_PACK = Struct("<QI" + "".join(_CODES[kind][0] for _, kind in COLUMNS))
_TICK_BITS = 0xFFFFFFFF  # it runs over after 198 days, the timestamp does not
_MADE = attrgetter(*(field.name for field in fields(ControlStep) if field.name not in _PARTS))


def pack(step: ControlStep) -> bytes:
    """Pack a step as a row. Raises struct.error for a number that does not fit."""
    return _PACK.pack(TICK_US * step.tick, step.tick & _TICK_BITS, *step.sample, *step.asked, *_MADE(step))


def row_names() -> tuple[str, ...]:
    """Return the names of the columns after `timestamp` and `tick`."""
    return tuple(name for name, _ in COLUMNS)


Rows = NDArray[np.void]
Value = str | float | tuple[str | float, ...] | Callable[[Rows], Any]
"""Value of a field: a column of the rows, a number, several of them side by side, or a function of the rows.

A minus sign before a column's name negates it.
"""

BATTERY_TICKS, STATUS_TICKS = 125, 125
MOTOR_PAIRS = ("fore", "aft", "fore", "aft")
"""The rotor pair of PX4's motors 1 to 4 of a quadrotor in X: front right, back left, front left, back right."""
NAV_STATES = {"off": 0, "open-loop": 14, "rate": 14, "attitude": 14, "velocity": 14, "position": 14}
"""PX4's nav_state for each of `signals.MODES`: manual for off, offboard for all others."""
_DISARMED, _ARMED = 1, 2


def _always(rows: Rows) -> NDArray[np.bool_]:
    return np.ones(len(rows), dtype=np.bool_)


def _changed(rows: Rows) -> NDArray[np.bool_]:
    """Choose the first row, each change of mode, arming or action, and two rows a second."""
    found = rows["tick"] % STATUS_TICKS == 0
    for name in ("armed", "asked_mode", "action"):
        found[1:] |= rows[name][1:] != rows[name][:-1]
    found[:1] = True
    return np.asarray(found)


class LoggedTopic(NamedTuple):
    """A topic of PX4: `text` says what it holds and when; `fields` is ULog's format after the time stamp.

    `values` has the values of the fields by name; others are 0. `when` chooses the steps in which the topic is written,
    `stamp` is the time of the measurement [us], by default that of the step.
    """

    name: str
    text: str
    fields: str
    values: dict[str, Value]
    when: Callable[[Rows], NDArray[np.bool_]] = _always
    stamp: Value = "timestamp"

    @property
    def format(self) -> str:
        """Return ULog's format of the topic's records."""
        return f"uint64_t timestamp;{self.fields};"


def _quaternion(name: str) -> Value:
    """Return quaternions (n, 4), w first, of a pitch."""

    def turned(rows: Rows) -> NDArray[np.float64]:
        zero = np.zeros(len(rows))
        return np.stack([np.cos(rows[name] / 2.0), zero, np.sin(rows[name] / 2.0), zero], axis=-1)

    return turned


def _measured_us(rows: Rows) -> NDArray[np.int64]:
    """Return the time at which the range was measured [us]."""
    age_us = np.nan_to_num(rows["dist_age"] * 1e6, nan=0.0, posinf=0.0, neginf=0.0)
    return np.maximum(rows["timestamp"].astype(np.int64) - np.clip(age_us, 0.0, 1e6).astype(np.int64), 0)


def _battery_warning(rows: Rows) -> NDArray[np.int64]:
    low, critical = (rows["causes"] & BIT[name] != 0 for name in ("battery_low", "battery_critical"))
    return np.where(critical, 2, np.where(low, 1, 0))


def _nav_state(rows: Rows) -> NDArray[np.uint8]:
    states = np.array([NAV_STATES[name] for name in MODES], dtype=np.uint8)
    return np.asarray(states[np.clip(rows["asked_mode"], 0, len(MODES) - 1)])


PX4_TOPICS: tuple[LoggedTopic, ...] = (
    LoggedTopic(
        "sensor_combined",
        "accelerometer and gyro, each sample of the IMU",
        "float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t accelerometer_timestamp_relative;"
        "float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt",
        {
            "gyro_rad": ("gyro_x", "gyro_y", "gyro_z"),
            "gyro_integral_dt": 4000,
            "accelerometer_m_s2": ("acc_x", "acc_y", "acc_z"),
            "accelerometer_integral_dt": 4000,
        },
        lambda rows: rows["imu_new"] != 0,
    ),
    LoggedTopic(
        "vehicle_angular_velocity",
        "estimated pitch rate, each step",
        "uint64_t timestamp_sample;float[3] xyz",
        {"timestamp_sample": "timestamp", "xyz": (0.0, "q", 0.0)},
    ),
    LoggedTopic(
        "vehicle_attitude",
        "estimated pitch as a quaternion, each step",
        "uint64_t timestamp_sample;float[4] q;float[4] delta_q_reset;uint8_t quat_reset_counter",
        {"timestamp_sample": "timestamp", "q": _quaternion("theta")},
    ),
    LoggedTopic(
        "vehicle_local_position",
        "estimated place and speed on the rail, 100 Hz",
        "uint64_t timestamp_sample;bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;float x;float y;float z;"
        "float vx;float vy;float vz;float ax;float ay;float az;float heading;float dist_bottom",
        {
            "timestamp_sample": "timestamp",
            "xy_valid": 1,
            "v_xy_valid": 1,
            "x": "x",
            "vx": "v",
            **dict.fromkeys(("ax", "ay", "az", "dist_bottom"), np.nan),
        },
        lambda rows: is_published(rows["tick"].astype(np.int64) - 1),
    ),
    LoggedTopic(
        "vehicle_attitude_setpoint",
        "pitch set-point in use and thrust, each step",
        "float yaw_sp_move_rate;float[4] q_d;float[3] thrust_body",
        {"q_d": _quaternion("theta0"), "thrust_body": (0.0, 0.0, "-T")},
    ),
    LoggedTopic(
        "vehicle_rates_setpoint",
        "pitch-rate set-point in use, each step",
        "float roll;float pitch;float yaw;float[3] thrust_body",
        {"pitch": "q0", "thrust_body": (0.0, 0.0, "-T")},
    ),
    LoggedTopic(
        "vehicle_local_position_setpoint",
        "position and velocity set-point in use, each step",
        "float x;float y;float z;float vx;float vy;float vz;float yaw;float yawspeed",
        {"x": "x0", "vx": "v0"},
    ),
    LoggedTopic(
        "vehicle_torque_setpoint",
        "moment M as it flies, each step",
        "uint64_t timestamp_sample;float[3] xyz",
        {"timestamp_sample": "timestamp", "xyz": (0.0, "M", 0.0)},
    ),
    LoggedTopic(
        "vehicle_thrust_setpoint",
        "thrust T as it flies, each step",
        "uint64_t timestamp_sample;float[3] xyz",
        {"timestamp_sample": "timestamp", "xyz": (0.0, 0.0, "-T")},
    ),
    LoggedTopic(
        "actuator_motors",
        "the four motors' commands, each step; motors 1 and 3 are the fore pair, 2 and 4 the aft pair",
        "uint64_t timestamp_sample;uint16_t reversible_flags;float[12] control",
        {"timestamp_sample": "timestamp", "control": (*MOTOR_PAIRS, *(np.nan,) * 8)},
    ),
    LoggedTopic(
        "distance_sensor",
        "range, each sample, stamped when it was measured",
        "uint32_t device_id;float min_distance;float max_distance;float current_distance;float variance;"
        "int8_t signal_quality;uint8_t type;uint8_t orientation",
        {"max_distance": 1.3, "current_distance": "dist", "signal_quality": -1},
        lambda rows: rows["dist_new"] != 0,
        _measured_us,
    ),
    LoggedTopic(
        "battery_status",
        "voltage and charge, 2 Hz",
        "bool connected;float voltage_v;float current_a;float remaining;uint8_t cell_count;uint8_t warning",
        {
            "connected": 1,
            "voltage_v": "voltage",
            "current_a": -1.0,
            "remaining": "charge",
            "cell_count": 3,
            "warning": _battery_warning,
        },
        lambda rows: rows["tick"] % BATTERY_TICKS == 0,
    ),
    LoggedTopic(
        "vehicle_status",
        "armed or not; nav_state 14 (offboard) while a loop flies, whichever mode asked for it, else 0; whether the "
        "failsafe acts in flight: each change, and 2 Hz",
        "uint8_t arming_state;uint8_t nav_state;uint8_t nav_state_user_intention;uint8_t vehicle_type;bool failsafe",
        {
            "arming_state": lambda rows: np.where(rows["armed"] != 0, _ARMED, _DISARMED),
            "nav_state": _nav_state,
            "nav_state_user_intention": _nav_state,
            "vehicle_type": 1,
            "failsafe": lambda rows: (rows["action"] != 0) & (rows["armed"] != 0),
        },
        _changed,
    ),
    LoggedTopic(
        "actuator_armed",
        "armed, and whether arming is possible: each change, and 2 Hz",
        "bool armed;bool prearmed;bool ready_to_arm;bool lockdown",
        {"armed": "armed", "ready_to_arm": lambda rows: rows["causes"] == 0},
        _changed,
    ),
)


def records(topic: LoggedTopic, layout: np.dtype[np.void], rows: Rows) -> Rows:
    """Return the records of `topic`, laid out as `layout`, of the steps `rows` (n,)."""
    chosen = rows[topic.when(rows)]
    made = np.zeros(len(chosen), dtype=layout)
    if len(chosen):
        with np.errstate(over="ignore", invalid="ignore"):  # the pitch of infinity is NaN, beyond float32 is infinite
            for name, value in {"timestamp": topic.stamp, **topic.values}.items():
                made[name] = _held(value, chosen)
    return made


def _held(value: Value, rows: Rows) -> Any:
    match value:
        case str():
            return -rows[value[1:]] if value.startswith("-") else rows[value]
        case tuple():
            return np.stack([np.broadcast_to(_held(one, rows), len(rows)) for one in value], axis=-1)
        case float() | int():
            return value
    return value(rows)
