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


@dataclass(frozen=True)
class Topic:
    """Signal with its names on board, in MAVLink, in ROS and in logs.

    `fields` is empty for a scalar; `rate_hz` is the nominal rate, 0 for a signal that is sent on events. `onboard` is
    False for the simulation's ground truth, which the flight controller cannot read.

    `source` holds, for each number of a sample, its name in a control step (`theta`, `acc_x`, `mode`); `places` holds
    its field in the MAVLink message. A signal without `places` is sent in TWODOF_BATCH only. `later` is the delay of
    the signal's stamp in the drone's logs [s], after the stamp of the moment M of the same step. `when` names the flag
    that marks the steps with a new value: "" for every step, "imu_new" or "dist_new" for a sensor's sample, "published"
    for an estimate.
    """

    name: str
    mat: str
    fields: tuple[str, ...]
    unit: str
    rate_hz: float
    mavlink: str
    ros: str
    text: str
    source: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    later: float = 0.0
    when: str = ""
    onboard: bool = True

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
    Topic(
        name="imu.acc",
        mat="acc",
        fields=_XYZ,
        unit="m/s^2",
        rate_hz=250.0,
        mavlink="HIGHRES_IMU",
        ros="/mavros/imu/data_raw",
        text="specific force, body axes",
        source=("acc_x", "acc_y", "acc_z"),
        places=("xacc", "yacc", "zacc"),
        later=-1.1e-3,
        when="imu_new",
    ),
    Topic(
        name="imu.gyro",
        mat="gyr",
        fields=_XYZ,
        unit="rad/s",
        rate_hz=250.0,
        mavlink="HIGHRES_IMU",
        ros="/mavros/imu/data_raw",
        text="angular rate, body axes",
        source=("gyro_x", "gyro_y", "gyro_z"),
        places=("xgyro", "ygyro", "zgyro"),
        later=-1.1e-3,
        when="imu_new",
    ),
    Topic(
        name="tof.distance",
        mat="dist",
        fields=(),
        unit="m",
        rate_hz=18.35,
        # DISTANCE_SENSOR counts whole centimetres, more than twice the sensor's 4 mm noise.
        mavlink="TWODOF_TOF",
        ros="/mavros/distance_sensor/tof",
        text="time-of-flight range; x = dist - 0.50",
        source=("dist",),
        places=("distance",),
        later=-1.0e-3,
        when="dist_new",
    ),
    Topic(
        name="estimate.theta",
        mat="theta",
        fields=(),
        unit="rad",
        rate_hz=250.0,
        mavlink="ATTITUDE",
        ros="/mavros/imu/data",
        text="estimated pitch",
        source=("theta",),
        places=("pitch",),
        later=0.33e-3,
    ),
    Topic(
        name="estimate.q",
        mat="q",
        fields=(),
        unit="rad/s",
        rate_hz=250.0,
        mavlink="ATTITUDE",
        ros="/mavros/imu/data",
        text="estimated pitch rate",
        source=("q",),
        places=("pitchspeed",),
        later=-Q_AGE,
    ),
    Topic(
        name="estimate.x",
        mat="x",
        fields=(),
        unit="m",
        rate_hz=100.0,
        mavlink="LOCAL_POSITION_NED",
        ros="/mavros/local_position/odom",
        text="estimated position along the rail",
        source=("x",),
        places=("x",),
        later=1.3e-3,
        when="published",
    ),
    Topic(
        name="estimate.v",
        mat="v",
        fields=(),
        unit="m/s",
        rate_hz=100.0,
        mavlink="LOCAL_POSITION_NED",
        ros="/mavros/local_position/odom",
        text="estimated velocity along the rail",
        source=("v",),
        places=("vx",),
        later=1.3e-3,
        when="published",
    ),
    Topic(
        name="setpoint.theta",
        mat="theta0",
        fields=(),
        unit="rad",
        rate_hz=250.0,
        mavlink="ATTITUDE_TARGET",
        ros="/mavros/setpoint_raw/target_attitude",
        text="pitch set-point in use",
        source=("theta0",),
        places=("pitch(q)",),
        later=5e-6,
    ),
    Topic(
        name="setpoint.q",
        mat="q0",
        fields=(),
        unit="rad/s",
        rate_hz=250.0,
        mavlink="ATTITUDE_TARGET",
        ros="/mavros/setpoint_raw/target_attitude",
        text="pitch-rate set-point in use",
        source=("q0",),
        places=("body_pitch_rate",),
        later=3e-6,
    ),
    Topic(
        name="setpoint.x",
        mat="x0",
        fields=(),
        unit="m",
        rate_hz=250.0,
        mavlink="POSITION_TARGET_LOCAL_NED",
        ros="/mavros/setpoint_raw/target_local",
        text="position set-point in use",
        source=("x0",),
        places=("x",),
        later=9e-6,
    ),
    Topic(
        name="setpoint.v",
        mat="v0",
        fields=(),
        unit="m/s",
        rate_hz=250.0,
        mavlink="POSITION_TARGET_LOCAL_NED",
        ros="/mavros/setpoint_raw/target_local",
        text="velocity set-point in use",
        source=("v0",),
        places=("vx",),
        later=7e-6,
    ),
    Topic(
        name="setpoint.thrust",
        mat="thrust0",
        fields=(),
        unit="-",
        rate_hz=250.0,
        mavlink="ATTITUDE_TARGET",
        ros="/mavros/setpoint_raw/target_attitude",
        text="thrust asked for, negative up",
        source=("-|T|",),
        places=("-thrust",),
        later=13e-6,
    ),
    Topic(
        name="command.M",
        mat="M",
        fields=(),
        unit="-",
        rate_hz=250.0,
        mavlink="ACTUATOR_CONTROL_TARGET",
        ros="/mavros/target_actuator_control",
        text="normalised pitch moment, within [-1, 1]",
        source=("M",),
        places=("controls[1]",),
    ),
    Topic(
        name="command.T",
        mat="T",
        fields=(),
        unit="-",
        rate_hz=250.0,
        mavlink="ACTUATOR_CONTROL_TARGET",
        ros="/mavros/target_actuator_control",
        text="normalised thrust applied",
        source=("T",),
        places=("controls[3]",),
        later=11e-6,
    ),
    Topic(
        name="openloop",
        mat="lmnf",
        fields=_OPENLOOP,
        unit="-",
        rate_hz=0.0,
        mavlink="TWODOF_OPENLOOP",
        ros="/twodof/openloop",
        text="open-loop excitation message",
        source=_OPENLOOP,
        places=_OPENLOOP,
        later=-1.5e-3,
    ),
    Topic(
        name="state.mode",
        mat="mode",
        fields=(),
        unit="-",
        rate_hz=250.0,
        mavlink="HEARTBEAT",
        ros="/mavros/state",
        text="index into MODES",
        source=("mode",),
        later=15e-6,
    ),
    Topic(
        name="battery.voltage",
        mat="voltage",
        fields=(),
        unit="V",
        rate_hz=2.0,
        mavlink="BATTERY_STATUS",
        ros="/mavros/battery",
        text="terminal voltage",
        source=("voltage",),
        places=("volts(voltages)",),
    ),
    Topic(
        name="battery.charge",
        mat="charge",
        fields=(),
        unit="-",
        rate_hz=2.0,
        mavlink="BATTERY_STATUS",
        ros="/mavros/battery",
        text="0 empty, 1 full",
        source=("charge",),
        places=("share(battery_remaining)",),
    ),
    Topic(
        name="truth.theta",
        mat="theta_true",
        fields=(),
        unit="rad",
        rate_hz=250.0,
        mavlink="TWODOF_TRUTH",
        ros="/twodof/truth",
        text="pitch of the virtual rig",
        places=("theta",),
        onboard=False,
    ),
    Topic(
        name="truth.q",
        mat="q_true",
        fields=(),
        unit="rad/s",
        rate_hz=250.0,
        mavlink="TWODOF_TRUTH",
        ros="/twodof/truth",
        text="pitch rate of the virtual rig",
        places=("q",),
        onboard=False,
    ),
    Topic(
        name="truth.x",
        mat="x_true",
        fields=(),
        unit="m",
        rate_hz=250.0,
        mavlink="TWODOF_TRUTH",
        ros="/twodof/truth",
        text="position of the virtual rig",
        places=("x",),
        onboard=False,
    ),
    Topic(
        name="truth.v",
        mat="v_true",
        fields=(),
        unit="m/s",
        rate_hz=250.0,
        mavlink="TWODOF_TRUTH",
        ros="/twodof/truth",
        text="velocity of the virtual rig",
        places=("v",),
        onboard=False,
    ),
)

BY_NAME = MappingProxyType({row.name: row for row in TOPICS})
BY_MAT = MappingProxyType({row.mat: row for row in TOPICS})


def topic(name: str) -> Topic:
    """Return the row of a signal, by its name (`imu.gyro`) or its .mat channel (`gyr`).

    Raises LogError for an unknown name.
    """
    row = BY_NAME.get(name) or BY_MAT.get(name)
    if row is None:
        raise LogError("there is no such signal", name, f"use one of {', '.join(BY_NAME)}")
    return row


def unit_of(mat: str) -> str:
    """Return the unit of a .mat channel, "" for an unknown one."""
    row = BY_MAT.get(mat)
    return row.unit if row else ""
