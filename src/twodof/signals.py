"""Table of all signals, `TOPICS`, and the constants that all rooms share: modes, control period, gravity, rail.

A row of the table names the signal everywhere: on board, in MAVLink, in ROS and in a .mat file. The channels of logs,
the columns of full-rate samples and the decoding of messages on the ground derive from the rows.

Names, units and axes are those of the drone's own logs: SI and radians, axes forward-right-down, theta > 0
nose-up, x along the rail with 0 at its middle. MAVLink messages are those of the `common` dialect wherever
one carries the signal without loss, and messages of our own (`TWODOF_...`) elsewhere; ROS topics are MAVROS's
where MAVROS has one.
"""

from dataclasses import dataclass
from types import MappingProxyType

from twodof.errors import LogError

MODES = ("off", "open-loop", "rate", "attitude", "velocity", "position")
"""Modes, from no closed loop to the outermost one; the topic `state.mode` carries the index into this tuple."""

OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION = range(len(MODES))
"""The modes as numbers; from `VELOCITY` on the cart moves along the rail."""

PERIOD = 0.004
"""Control period [s]: the flight code and every user's controller run at 250 Hz."""
TICK_US = round(PERIOD * 1e6)
"""Control period [us]: the unit of `time_usec` stamps and of the intervals of command 511."""
TICK_MS = TICK_US // 1000
"""Control period [ms]: the unit of `time_boot_ms` stamps."""
TICK_NS = TICK_US * 1000
"""Control period [ns], for the clocks of this machine."""
TICK_S = TICK_US / 1e6
"""Control period [s] as computed from whole microseconds."""

GRAVITY = 9.81
"""Standard gravity as the course rounds it [m/s2]."""

RAIL_CENTRE = 0.50
"""Reading of the range sensor with the cart at the middle of the rail [m]: x = dist - 0.50."""

HOVER = 0.4
"""Thrust command in hover, at which the drone's trim and friction are stated."""


_ROS = MappingProxyType(
    {
        "HIGHRES_IMU": "/mavros/imu/data_raw",
        "TWODOF_TOF": "/mavros/distance_sensor/tof",
        "ATTITUDE": "/mavros/imu/data",
        "LOCAL_POSITION_NED": "/mavros/local_position/odom",
        "ATTITUDE_TARGET": "/mavros/setpoint_raw/target_attitude",
        "POSITION_TARGET_LOCAL_NED": "/mavros/setpoint_raw/target_local",
        "ACTUATOR_CONTROL_TARGET": "/mavros/target_actuator_control",
        "TWODOF_OPENLOOP": "/twodof/openloop",
        "HEARTBEAT": "/mavros/state",
        "BATTERY_STATUS": "/mavros/battery",
        "TWODOF_TRUTH": "/twodof/truth",
    }
)
"""ROS topic of the signals in each MAVLink message."""


@dataclass(frozen=True)
class Topic:
    """Signal with its names on board, in MAVLink, in ROS and in logs.

    `source` holds, for each number of a sample, its name in a control step (`theta`, `acc_x`, `mode`); `places` holds
    its field in the MAVLink message. A signal without `places` is sent in TWODOF_BATCH only. `later` is the delay of
    the signal's stamp in the drone's logs [s], after the stamp of the moment M of the same step. `when` names the flag
    that marks the steps with a new value: "" for every step, "imu_new" or "dist_new" for a sensor's sample, "published"
    for an estimate.

    `fields` is empty for a scalar; `rate_hz` is the nominal rate, 0 for a signal that is sent on events. `onboard` is
    False for the simulation's ground truth, which the flight controller cannot read.
    """

    name: str
    mat: str
    unit: str
    text: str
    mavlink: str
    source: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    later: float = 0.0
    when: str = ""
    fields: tuple[str, ...] = ()
    rate_hz: float = 250.0
    onboard: bool = True

    @property
    def ros(self) -> str:
        """Return the ROS topic, one of its own for a signal without a message."""
        return _ROS.get(self.mavlink, f"/twodof/{self.mat}")

    @property
    def own_rate(self) -> bool:
        """Return True for a sensor that samples at its own rate, with `when` as the flag of its samples."""
        return self.when not in ("", "imu_new", "published")

    @property
    def width(self) -> int:
        """Return the number of values in a sample."""
        return max(1, len(self.fields))

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the column names in a table, such as `imu.gyro_y`; one for each number in a sample."""
        return tuple(f"{self.name}_{field}" for field in self.fields) or (self.name,)


_XYZ = ("x", "y", "z")
_OPENLOOP = ("M", "T", "openloop", "enableM", "enableT")

Q_AGE = 0.35e-3
"""Age of q when the drone computes M [s], by the stamps in its logs."""

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""Severities of a drone's status texts, by syslog's number."""

TOPICS: tuple[Topic, ...] = (
    Topic("imu.acc", "acc", "m/s^2", "specific force, body axes", "HIGHRES_IMU",
          ("acc_x", "acc_y", "acc_z"), ("xacc", "yacc", "zacc"), -1.1e-3, "imu_new", fields=_XYZ),
    Topic("imu.gyro", "gyr", "rad/s", "angular rate, body axes", "HIGHRES_IMU",
          ("gyro_x", "gyro_y", "gyro_z"), ("xgyro", "ygyro", "zgyro"), -1.1e-3, "imu_new", fields=_XYZ),
    # DISTANCE_SENSOR counts whole centimetres, more than twice the sensor's 4 mm noise.
    Topic("tof.distance", "dist", "m", "time-of-flight range; x = dist - 0.50", "TWODOF_TOF",
          ("dist",), ("distance",), -1.0e-3, "dist_new", rate_hz=18.35),
    Topic("estimate.theta", "theta", "rad", "estimated pitch", "ATTITUDE", ("theta",), ("pitch",), 0.33e-3),
    Topic("estimate.q", "q", "rad/s", "estimated pitch rate", "ATTITUDE", ("q",), ("pitchspeed",), -Q_AGE),
    Topic("estimate.x", "x", "m", "estimated position along the rail", "LOCAL_POSITION_NED",
          ("x",), ("x",), 1.3e-3, "published", rate_hz=100.0),
    Topic("estimate.v", "v", "m/s", "estimated velocity along the rail", "LOCAL_POSITION_NED",
          ("v",), ("vx",), 1.3e-3, "published", rate_hz=100.0),
    Topic("setpoint.theta", "theta0", "rad", "pitch set-point in use", "ATTITUDE_TARGET",
          ("theta0",), ("pitch(q)",), 5e-6),
    Topic("setpoint.q", "q0", "rad/s", "pitch-rate set-point in use", "ATTITUDE_TARGET",
          ("q0",), ("body_pitch_rate",), 3e-6),
    Topic("setpoint.x", "x0", "m", "position set-point in use", "POSITION_TARGET_LOCAL_NED", ("x0",), ("x",), 9e-6),
    Topic("setpoint.v", "v0", "m/s", "velocity set-point in use", "POSITION_TARGET_LOCAL_NED", ("v0",), ("vx",), 7e-6),
    Topic("setpoint.thrust", "thrust0", "-", "thrust asked for, negative up", "ATTITUDE_TARGET",
          ("-|T|",), ("-thrust",), 13e-6),
    Topic("command.M", "M", "-", "normalised pitch moment, within [-1, 1]", "ACTUATOR_CONTROL_TARGET",
          ("M",), ("controls[1]",)),
    Topic("command.T", "T", "-", "normalised thrust applied", "ACTUATOR_CONTROL_TARGET",
          ("T",), ("controls[3]",), 11e-6),
    Topic("openloop", "lmnf", "-", "open-loop excitation message", "TWODOF_OPENLOOP",
          _OPENLOOP, _OPENLOOP, -1.5e-3, fields=_OPENLOOP, rate_hz=0.0),
    Topic("state.mode", "mode", "-", "index into MODES", "HEARTBEAT", ("mode",), later=15e-6),
    Topic("battery.voltage", "voltage", "V", "terminal voltage", "BATTERY_STATUS",
          ("voltage",), ("volts(voltages)",), rate_hz=2.0),
    Topic("battery.charge", "charge", "-", "0 empty, 1 full", "BATTERY_STATUS",
          ("charge",), ("share(battery_remaining)",), rate_hz=2.0),
    Topic("truth.theta", "theta_true", "rad", "pitch of the virtual rig", "TWODOF_TRUTH",
          places=("theta",), onboard=False),
    Topic("truth.q", "q_true", "rad/s", "pitch rate of the virtual rig", "TWODOF_TRUTH", places=("q",), onboard=False),
    Topic("truth.x", "x_true", "m", "position of the virtual rig", "TWODOF_TRUTH", places=("x",), onboard=False),
    Topic("truth.v", "v_true", "m/s", "velocity of the virtual rig", "TWODOF_TRUTH", places=("v",), onboard=False),
)  # fmt: skip

BY_NAME = MappingProxyType({row.name: row for row in TOPICS})
BY_MAT = MappingProxyType({row.mat: row for row in TOPICS})


def topic(name: str) -> Topic:
    """Return the row of a signal, by its name (`imu.gyro`) or its .mat channel (`gyr`).

    Raises LogError for an unknown name.
    """
    row = BY_NAME.get(name) or BY_MAT.get(name)
    if row is None:
        raise LogError("no such signal", name, f"use one of {', '.join(BY_NAME)}")
    return row


def unit_of(mat: str) -> str:
    """Return the unit of a .mat channel, "" for an unknown one."""
    row = BY_MAT.get(mat)
    return row.unit if row else ""
