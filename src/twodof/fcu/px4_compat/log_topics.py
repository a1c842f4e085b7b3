"""What of a step goes into the on-board log under PX4's names, so that PlotJuggler, Flight Review and pyulog show it.

Topics and fields are those of PX4 v1.16 (msg/), as far as this vehicle has them. Roll, yaw, y and z are 0: the rail is
the local x axis. What PX4 leaves open is NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flightlog.steps import is_published
from twodof.signals import MODES

Rows = NDArray[np.void]
Columns = dict[str, Any]

BATTERY_TICKS, STATUS_TICKS = 125, 125
MOTOR_PAIRS = ("fore", "aft", "fore", "aft")
"""The rotor pair of PX4's motors 1 to 4 of a quadrotor in X: front right, back left, front left, back right."""
NAV_STATES = {"off": 0, "open-loop": 14, "rate": 14, "attitude": 14, "velocity": 14, "position": 14}
"""PX4's nav_state for each of `signals.MODES`: manual, and offboard for what flies a set-point."""
_DISARMED, _ARMED = 1, 2
_RANGE = (0.0, 1.3)


@dataclass(frozen=True)
class LoggedTopic:
    """A topic of PX4: `text` says what it holds and when, `description` its fields behind the time stamp, as in ULog.

    `when` chooses the steps in which it is written, `columns` gives its fields for those.
    """

    name: str
    text: str
    description: str
    when: Callable[[Rows], NDArray[np.bool_]]
    columns: Callable[[Rows], Columns]

    @property
    def format(self) -> str:
        """How ULog describes its records."""
        return f"uint64_t timestamp;{self.description}"


def _always(rows: Rows) -> NDArray[np.bool_]:
    return np.ones(len(rows), dtype=np.bool_)


def _every(ticks: int) -> Callable[[Rows], NDArray[np.bool_]]:
    return lambda rows: rows["tick"] % ticks == 0


def _changed(rows: Rows) -> NDArray[np.bool_]:
    """Each change of mode, arming or action; twice a second; and the first of `rows`, whose past is unknown."""
    found = rows["tick"] % STATUS_TICKS == 0
    for name in ("armed", "asked_mode", "action"):
        found[1:] |= rows[name][1:] != rows[name][:-1]
    found[:1] = True
    return np.asarray(found)


def _xyz(x: Any, y: Any, z: Any) -> NDArray[np.float64]:
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def _pitched(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (n, 4), w first, of a pitch."""
    zero = np.zeros(len(theta))
    return np.stack([np.cos(theta / 2.0), zero, np.sin(theta / 2.0), zero], axis=-1)


def _sensor_combined(rows: Rows) -> Columns:
    return {
        "gyro_rad": _xyz(rows["gyro_x"], rows["gyro_y"], rows["gyro_z"]),
        "gyro_integral_dt": 4000,
        "accelerometer_timestamp_relative": 0,
        "accelerometer_m_s2": _xyz(rows["acc_x"], rows["acc_y"], rows["acc_z"]),
        "accelerometer_integral_dt": 4000,
    }


def _local_position(rows: Rows) -> Columns:
    return {
        "timestamp_sample": rows["timestamp"],
        "xy_valid": 1,
        "v_xy_valid": 1,
        "x": rows["x"],
        "vx": rows["v"],
        "heading": 0.0,
        "dist_bottom": np.nan,
    }


def _motors(rows: Rows) -> Columns:
    control = np.full((len(rows), 12), np.nan)
    for motor, pair in enumerate(MOTOR_PAIRS):
        control[:, motor] = rows[pair]
    return {"timestamp_sample": rows["timestamp"], "control": control}


def _distance(rows: Rows) -> Columns:
    age_us = np.nan_to_num(rows["dist_age"] * 1e6, nan=0.0, posinf=0.0, neginf=0.0)
    measured = rows["timestamp"].astype(np.int64) - np.clip(age_us, 0.0, 1e6).astype(np.int64)
    return {
        "timestamp": np.maximum(measured, 0),
        "min_distance": _RANGE[0],
        "max_distance": _RANGE[1],
        "current_distance": rows["dist"],
        "signal_quality": -1,
        "orientation": 0,
    }


def _battery(rows: Rows) -> Columns:
    low, critical = (rows["causes"] & BIT[name] != 0 for name in ("battery_low", "battery_critical"))
    return {
        "connected": 1,
        "voltage_v": rows["voltage"],
        "current_a": -1.0,
        "remaining": rows["charge"],
        "cell_count": 3,
        "warning": np.where(critical, 2, np.where(low, 1, 0)),
    }


def _status(rows: Rows) -> Columns:
    states = np.array([NAV_STATES[name] for name in MODES], dtype=np.uint8)
    mode = np.clip(rows["asked_mode"], 0, len(MODES) - 1)
    return {
        "arming_state": np.where(rows["armed"] != 0, _ARMED, _DISARMED),
        "nav_state": states[mode],
        "nav_state_user_intention": states[mode],
        "vehicle_type": 1,
        "failsafe": rows["action"] != 0,
    }


PX4_TOPICS: tuple[LoggedTopic, ...] = (
    LoggedTopic(
        "sensor_combined",
        "accelerometer and gyro, each sample of the IMU",
        "float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t accelerometer_timestamp_relative;"
        "float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;",
        lambda rows: rows["imu_new"] != 0,
        _sensor_combined,
    ),
    LoggedTopic(
        "vehicle_angular_velocity",
        "estimated pitch rate, each step",
        "uint64_t timestamp_sample;float[3] xyz;",
        _always,
        lambda rows: {"timestamp_sample": rows["timestamp"], "xyz": _xyz(0.0, rows["q"], 0.0)},
    ),
    LoggedTopic(
        "vehicle_attitude",
        "estimated pitch as a quaternion, each step",
        "uint64_t timestamp_sample;float[4] q;float[4] delta_q_reset;uint8_t quat_reset_counter;",
        _always,
        lambda rows: {"timestamp_sample": rows["timestamp"], "q": _pitched(rows["theta"])},
    ),
    LoggedTopic(
        "vehicle_local_position",
        "estimated place and speed on the rail, 100 Hz",
        "uint64_t timestamp_sample;bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;float x;float y;float z;"
        "float vx;float vy;float vz;float ax;float ay;float az;float heading;float dist_bottom;",
        lambda rows: is_published(rows["tick"].astype(np.int64) - 1),
        _local_position,
    ),
    LoggedTopic(
        "vehicle_attitude_setpoint",
        "pitch set-point in use and thrust, each step",
        "float yaw_sp_move_rate;float[4] q_d;float[3] thrust_body;",
        _always,
        lambda rows: {"q_d": _pitched(rows["theta0"]), "thrust_body": _xyz(0.0, 0.0, -rows["T"])},
    ),
    LoggedTopic(
        "vehicle_rates_setpoint",
        "pitch-rate set-point in use, each step",
        "float roll;float pitch;float yaw;float[3] thrust_body;",
        _always,
        lambda rows: {"pitch": rows["q0"], "thrust_body": _xyz(0.0, 0.0, -rows["T"])},
    ),
    LoggedTopic(
        "vehicle_local_position_setpoint",
        "position and velocity set-point in use, each step",
        "float x;float y;float z;float vx;float vy;float vz;float yaw;float yawspeed;",
        _always,
        lambda rows: {"x": rows["x0"], "vx": rows["v0"]},
    ),
    LoggedTopic(
        "vehicle_torque_setpoint",
        "moment M as it flies, each step",
        "uint64_t timestamp_sample;float[3] xyz;",
        _always,
        lambda rows: {"timestamp_sample": rows["timestamp"], "xyz": _xyz(0.0, rows["M"], 0.0)},
    ),
    LoggedTopic(
        "vehicle_thrust_setpoint",
        "thrust T as it flies, each step",
        "uint64_t timestamp_sample;float[3] xyz;",
        _always,
        lambda rows: {"timestamp_sample": rows["timestamp"], "xyz": _xyz(0.0, 0.0, -rows["T"])},
    ),
    LoggedTopic(
        "actuator_motors",
        "the four motors' commands, each step; motors 1 and 3 are the fore pair, 2 and 4 the aft pair",
        "uint64_t timestamp_sample;uint16_t reversible_flags;float[12] control;",
        _always,
        _motors,
    ),
    LoggedTopic(
        "distance_sensor",
        "range, each sample, stamped when it was measured",
        "uint32_t device_id;float min_distance;float max_distance;float current_distance;float variance;"
        "int8_t signal_quality;uint8_t type;uint8_t orientation;",
        lambda rows: rows["dist_new"] != 0,
        _distance,
    ),
    LoggedTopic(
        "battery_status",
        "voltage and charge, 2 Hz",
        "bool connected;float voltage_v;float current_a;float remaining;uint8_t cell_count;uint8_t warning;",
        _every(BATTERY_TICKS),
        _battery,
    ),
    LoggedTopic(
        "vehicle_status",
        "armed or not, PX4's mode, whether the failsafe acts: each change, and 2 Hz",
        "uint64_t armed_time;uint8_t arming_state;uint8_t nav_state;uint8_t nav_state_user_intention;"
        "uint8_t vehicle_type;bool failsafe;",
        _changed,
        _status,
    ),
    LoggedTopic(
        "actuator_armed",
        "armed, and whether arming is possible: each change, and 2 Hz",
        "bool armed;bool prearmed;bool ready_to_arm;bool lockdown;",
        _changed,
        lambda rows: {"armed": rows["armed"], "ready_to_arm": rows["causes"] == 0},
    ),
)


def records(topic: LoggedTopic, layout: np.dtype[np.void], rows: Rows) -> Rows:
    """The records of `topic`, laid out as `layout`, that the steps `rows` (n,) give; fields not named are 0."""
    chosen = rows[topic.when(rows)]
    made = np.zeros(len(chosen), dtype=layout)
    if len(chosen):
        with np.errstate(over="ignore", invalid="ignore"):  # the pitch of infinity is NaN, beyond float32 is infinite
            columns: Mapping[str, Any] = {"timestamp": chosen["timestamp"], **topic.columns(chosen)}
            for name, values in columns.items():
                made[name] = values
    return made
