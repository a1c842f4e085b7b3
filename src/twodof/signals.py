"""TOPICS: one row a signal, with its name, unit, rate, source on board, MAVLink fields, ROS topic and .mat channel.

The channels of logs, the columns of full-rate samples and what the ground reads from a message derive from the rows.

Names, units and axes are those of the drone's own logs: SI and radians, axes forward-right-down, theta > 0
nose-up, x along the rail with 0 at its middle. MAVLink messages are those of the `common` dialect wherever
one carries the signal without loss, and messages of our own (`TWODOF_...`) elsewhere; ROS topics are MAVROS's
where MAVROS has one.
"""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from twodof.errors import LogError

MODES = ("off", "open-loop", "rate", "attitude", "velocity", "position")
"""What the flight controller closes; the topic `state.mode` carries the index into this tuple."""

OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION = range(len(MODES))
"""The modes by number; from `VELOCITY` on the cart moves along the rail."""


@dataclass(frozen=True)
class Topic:
    """One signal: what it is called in each place it appears.

    `fields` is empty for a scalar; `rate_hz` is the nominal rate, 0 for one that is sent on events. `onboard` is False
    for what the flight controller can never read: the simulation's ground truth.

    `source` has a name for each number of a sample: that of the value in a control step (`theta`, `acc_x`, `mode`).
    `places` says for each where it stands in the MAVLink message; none: it travels in TWODOF_BATCH alone. `later` is
    how much later [s] the drone's logs stamp it than the moment M of the same step. `when` says in which steps it is
    new: "" in each, "imu_new" or "dist_new" where the sensor gave a sample, "published" where the estimator publishes.
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
    when: Literal["", "imu_new", "dist_new", "published"] = ""
    onboard: bool = True

    @property
    def width(self) -> int:
        """Numbers in one sample."""
        return max(1, len(self.fields))

    @property
    def columns(self) -> tuple[str, ...]:
        """Column names in a table, such as `imu.gyro_y`; one for each number in a sample."""
        return tuple(f"{self.name}_{field}" for field in self.fields) or (self.name,)


_XYZ = ("x", "y", "z")
_IMU = ("HIGHRES_IMU", "/mavros/imu/data_raw")
_ATTITUDE = ("ATTITUDE", "/mavros/imu/data")
_POSITION = ("LOCAL_POSITION_NED", "/mavros/local_position/odom")
_ATTITUDE_TARGET = ("ATTITUDE_TARGET", "/mavros/setpoint_raw/target_attitude")
_POSITION_TARGET = ("POSITION_TARGET_LOCAL_NED", "/mavros/setpoint_raw/target_local")
_ACTUATORS = ("ACTUATOR_CONTROL_TARGET", "/mavros/target_actuator_control")
# DISTANCE_SENSOR counts whole centimetres, more than twice the sensor's 4 mm noise.
_TOF = ("TWODOF_TOF", "/mavros/distance_sensor/tof")
_OPENLOOP = ("M", "T", "openloop", "enableM", "enableT")
_TRUTH = ("TWODOF_TRUTH", "/twodof/truth")

Q_AGE = 0.35e-3
"""How old q is when the drone computes M [s], by the stamps in its logs."""

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""What a drone says in words is one of these, by syslog's number."""

TOPICS: tuple[Topic, ...] = (
    Topic(
        *("imu.acc", "acc", _XYZ, "m/s^2", 250.0, *_IMU, "specific force, body axes"),
        *(("acc_x", "acc_y", "acc_z"), ("xacc", "yacc", "zacc"), -1.1e-3, "imu_new"),
    ),
    Topic(
        *("imu.gyro", "gyr", _XYZ, "rad/s", 250.0, *_IMU, "angular rate, body axes"),
        *(("gyro_x", "gyro_y", "gyro_z"), ("xgyro", "ygyro", "zgyro"), -1.1e-3, "imu_new"),
    ),
    Topic(
        *("tof.distance", "dist", (), "m", 18.35, *_TOF, "time-of-flight range; x = dist - 0.50"),
        *(("dist",), ("distance",), -1.0e-3, "dist_new"),
    ),
    Topic(
        *("estimate.theta", "theta", (), "rad", 250.0, *_ATTITUDE, "estimated pitch"),
        *(("theta",), ("pitch",), 0.33e-3),
    ),
    Topic(
        *("estimate.q", "q", (), "rad/s", 250.0, *_ATTITUDE, "estimated pitch rate"),
        *(("q",), ("pitchspeed",), -Q_AGE),
    ),
    Topic(
        *("estimate.x", "x", (), "m", 100.0, *_POSITION, "estimated position along the rail"),
        *(("x",), ("x",), 1.3e-3, "published"),
    ),
    Topic(
        *("estimate.v", "v", (), "m/s", 100.0, *_POSITION, "estimated velocity along the rail"),
        *(("v",), ("vx",), 1.3e-3, "published"),
    ),
    Topic(
        *("setpoint.theta", "theta0", (), "rad", 250.0, *_ATTITUDE_TARGET, "pitch set-point in use"),
        *(("theta0",), ("pitch(q)",), 5e-6),
    ),
    Topic(
        *("setpoint.q", "q0", (), "rad/s", 250.0, *_ATTITUDE_TARGET, "pitch-rate set-point in use"),
        *(("q0",), ("body_pitch_rate",), 3e-6),
    ),
    Topic(
        *("setpoint.x", "x0", (), "m", 250.0, *_POSITION_TARGET, "position set-point in use"),
        *(("x0",), ("x",), 9e-6),
    ),
    Topic(
        *("setpoint.v", "v0", (), "m/s", 250.0, *_POSITION_TARGET, "velocity set-point in use"),
        *(("v0",), ("vx",), 7e-6),
    ),
    Topic(
        *("setpoint.thrust", "thrust0", (), "-", 250.0, *_ATTITUDE_TARGET, "thrust asked for, negative up"),
        *(("-|T|",), ("-thrust",), 13e-6),
    ),
    Topic(
        *("command.M", "M", (), "-", 250.0, *_ACTUATORS, "normalised pitch moment, within [-1, 1]"),
        *(("M",), ("controls[1]",)),
    ),
    Topic(
        *("command.T", "T", (), "-", 250.0, *_ACTUATORS, "normalised thrust applied"),
        *(("T",), ("controls[3]",), 11e-6),
    ),
    Topic(
        *(
            "openloop",
            "lmnf",
            _OPENLOOP,
            "-",
            0.0,
            "TWODOF_OPENLOOP",
            "/twodof/openloop",
            "open-loop excitation message",
        ),
        *(_OPENLOOP, _OPENLOOP, -1.5e-3),
    ),
    Topic(
        *("state.mode", "mode", (), "-", 250.0, "HEARTBEAT", "/mavros/state", "index into MODES"),
        *(("mode",), (), 15e-6),
    ),
    Topic(
        *("battery.voltage", "voltage", (), "V", 2.0, "BATTERY_STATUS", "/mavros/battery", "terminal voltage"),
        *(("voltage",), ("volts(voltages)",)),
    ),
    Topic(
        *("battery.charge", "charge", (), "-", 2.0, "BATTERY_STATUS", "/mavros/battery", "0 empty, 1 full"),
        *(("charge",), ("share(battery_remaining)",)),
    ),
    Topic(
        *("truth.theta", "theta_true", (), "rad", 250.0, *_TRUTH, "pitch of the virtual rig"),
        *((), ("theta",)),
        onboard=False,
    ),
    Topic(
        *("truth.q", "q_true", (), "rad/s", 250.0, *_TRUTH, "pitch rate of the virtual rig"),
        *((), ("q",)),
        onboard=False,
    ),
    Topic(
        *("truth.x", "x_true", (), "m", 250.0, *_TRUTH, "position of the virtual rig"),
        *((), ("x",)),
        onboard=False,
    ),
    Topic(
        *("truth.v", "v_true", (), "m/s", 250.0, *_TRUTH, "velocity of the virtual rig"),
        *((), ("v",)),
        onboard=False,
    ),
)

BY_NAME = MappingProxyType({row.name: row for row in TOPICS})
BY_MAT = MappingProxyType({row.mat: row for row in TOPICS})


def topic(name: str) -> Topic:
    """The row of a signal, by its name (`imu.gyro`) or its .mat channel (`gyr`).

    Raises LogError for an unknown name.
    """
    row = BY_NAME.get(name) or BY_MAT.get(name)
    if row is None:
        raise LogError("no such signal", name, f"there are {', '.join(BY_NAME)}")
    return row


def unit_of(mat: str) -> str:
    """Unit of a .mat channel, or "" for one that TOPICS does not know."""
    row = BY_MAT.get(mat)
    return row.unit if row else ""
