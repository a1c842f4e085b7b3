"""TOPICS: one row a signal, with its name, fields, unit, rate, MAVLink message, ROS topic and .mat channel.

Names, units and axes are those of the drone's own logs: SI and radians, axes forward-right-down, theta > 0
nose-up, x along the rail with 0 at its middle. MAVLink messages are those of the `common` dialect wherever
one carries the signal without loss, and messages of our own (`TWODOF_...`) elsewhere; ROS topics are MAVROS's
where MAVROS has one.
"""

from dataclasses import dataclass
from types import MappingProxyType

from twodof.errors import LogError

MODES = ("off", "open-loop", "rate", "attitude", "velocity", "position")
"""What the flight controller closes; the topic `state.mode` carries the index into this tuple."""


@dataclass(frozen=True)
class Topic:
    """One signal: what it is called in each place it appears.

    `fields` is empty for a scalar; `rate_hz` is the nominal rate, 0 for one that is sent on events. `onboard`
    is False for what the flight controller can never read: the simulation's ground truth.
    """

    name: str
    mat: str
    fields: tuple[str, ...]
    unit: str
    rate_hz: float
    mavlink: str
    ros: str
    text: str
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
_TRUTH = ("TWODOF_TRUTH", "/twodof/truth")

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""What a drone says in words is one of these, by syslog's number."""

TOPICS: tuple[Topic, ...] = (
    Topic("imu.acc", "acc", _XYZ, "m/s^2", 250.0, *_IMU, "specific force, body axes"),
    Topic("imu.gyro", "gyr", _XYZ, "rad/s", 250.0, *_IMU, "angular rate, body axes"),
    Topic("tof.distance", "dist", (), "m", 18.35, *_TOF, "time-of-flight range; x = dist - 0.50"),
    Topic("estimate.theta", "theta", (), "rad", 250.0, *_ATTITUDE, "estimated pitch"),
    Topic("estimate.q", "q", (), "rad/s", 250.0, *_ATTITUDE, "estimated pitch rate"),
    Topic("estimate.x", "x", (), "m", 100.0, *_POSITION, "estimated position along the rail"),
    Topic("estimate.v", "v", (), "m/s", 100.0, *_POSITION, "estimated velocity along the rail"),
    Topic("setpoint.theta", "theta0", (), "rad", 250.0, *_ATTITUDE_TARGET, "pitch set-point in use"),
    Topic("setpoint.q", "q0", (), "rad/s", 250.0, *_ATTITUDE_TARGET, "pitch-rate set-point in use"),
    Topic("setpoint.x", "x0", (), "m", 250.0, *_POSITION_TARGET, "position set-point in use"),
    Topic("setpoint.v", "v0", (), "m/s", 250.0, *_POSITION_TARGET, "velocity set-point in use"),
    Topic("setpoint.thrust", "thrust0", (), "-", 250.0, *_ATTITUDE_TARGET, "thrust asked for, negative up"),
    Topic("command.M", "M", (), "-", 250.0, *_ACTUATORS, "normalised pitch moment, within [-1, 1]"),
    Topic("command.T", "T", (), "-", 250.0, *_ACTUATORS, "normalised thrust applied"),
    Topic(
        "openloop",
        "lmnf",
        ("M", "T", "openloop", "enableM", "enableT"),
        "-",
        0.0,
        "TWODOF_OPENLOOP",
        "/twodof/openloop",
        "open-loop excitation message",
    ),
    Topic("state.mode", "mode", (), "-", 250.0, "HEARTBEAT", "/mavros/state", "index into MODES"),
    Topic("battery.voltage", "voltage", (), "V", 2.0, "BATTERY_STATUS", "/mavros/battery", "terminal voltage"),
    Topic("battery.charge", "charge", (), "-", 2.0, "BATTERY_STATUS", "/mavros/battery", "0 empty, 1 full"),
    Topic("truth.theta", "theta_true", (), "rad", 250.0, *_TRUTH, "pitch of the virtual rig", onboard=False),
    Topic("truth.q", "q_true", (), "rad/s", 250.0, *_TRUTH, "pitch rate of the virtual rig", onboard=False),
    Topic("truth.x", "x_true", (), "m", 250.0, *_TRUTH, "position of the virtual rig", onboard=False),
    Topic("truth.v", "v_true", (), "m/s", 250.0, *_TRUTH, "velocity of the virtual rig", onboard=False),
)

BY_NAME = MappingProxyType({row.name: row for row in TOPICS})
BY_MAT = MappingProxyType({row.mat: row for row in TOPICS})


def topic(name: str) -> Topic:
    """The row of a signal, by its name (`imu.gyro`) or its .mat channel (`gyr`).

    Raises LogError if there is no such signal.
    """
    row = BY_NAME.get(name) or BY_MAT.get(name)
    if row is None:
        raise LogError("no such signal", name, f"there are {', '.join(BY_NAME)}")
    return row


def unit_of(mat: str) -> str:
    """Unit of a .mat channel, or "" for one that TOPICS does not know."""
    row = BY_MAT.get(mat)
    return row.unit if row else ""
