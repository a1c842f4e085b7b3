"""What a client gets that has asked for nothing: PX4's rates of its onboard and of its ground link.

Rates of v1.16 (src/modules/mavlink/mavlink_main.cpp, MAVLINK_MODE_ONBOARD and MAVLINK_MODE_NORMAL) where it has one, of
the messages that the flight controller streams; what is not here comes as the flight controller sends it.
"""

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from twodof.errors import LinkError, listed, shown
from twodof.link import dialect

EVERY = 0  # interval of a message that is passed on whenever it comes
OFF = -1
# What all get who know our own messages, and comes at each change too.
_OWN = {"TWODOF_TOF": 0.0, "TWODOF_RIG": 0.0, "TWODOF_LEASE": 0.0, "TWODOF_SAFETY": 0.0, "TWODOF_TIMING": 0.0}
# Message -> rate [Hz]; 0: as it comes.
_RATES = {
    "onboard": {
        "SYS_STATUS": 5.0,
        "EXTENDED_SYS_STATE": 5.0,
        "ATTITUDE": 100.0,
        "ATTITUDE_QUATERNION": 50.0,
        "HIGHRES_IMU": 50.0,
        "LOCAL_POSITION_NED": 30.0,
        "ODOMETRY": 30.0,
        "ATTITUDE_TARGET": 10.0,
        "POSITION_TARGET_LOCAL_NED": 10.0,
        "SERVO_OUTPUT_RAW": 10.0,
        "DISTANCE_SENSOR": 10.0,
        "VFR_HUD": 10.0,
        "ACTUATOR_CONTROL_TARGET": 10.0,
        "ESTIMATOR_STATUS": 1.0,
        "SYSTEM_TIME": 1.0,
        "BATTERY_STATUS": 0.5,
        "HOME_POSITION": 0.5,
    },
    "ground": {
        "SYS_STATUS": 1.0,
        "EXTENDED_SYS_STATE": 1.0,
        "ATTITUDE": 15.0,
        "ATTITUDE_QUATERNION": 10.0,
        "LOCAL_POSITION_NED": 1.0,
        "ATTITUDE_TARGET": 2.0,
        "POSITION_TARGET_LOCAL_NED": 1.5,
        "SERVO_OUTPUT_RAW": 1.0,
        "DISTANCE_SENSOR": 0.5,
        "VFR_HUD": 4.0,
        "HIGHRES_IMU": 2.0,
        "ODOMETRY": 0.5,
        "ACTUATOR_CONTROL_TARGET": 1.0,
        "ESTIMATOR_STATUS": 0.5,
        "SYSTEM_TIME": 0.5,
        "BATTERY_STATUS": 0.5,
        "HOME_POSITION": 0.5,
    },
    "none": {},
}
PROFILES = tuple(_RATES)
# REQUEST_DATA_STREAM's groups (MAV_DATA_STREAM); group 0 is all of a client's.
GROUPS = MappingProxyType(
    {
        1: ("HIGHRES_IMU",),
        2: ("SYS_STATUS", "EXTENDED_SYS_STATE", "BATTERY_STATUS"),
        3: ("SERVO_OUTPUT_RAW",),
        6: ("LOCAL_POSITION_NED", "ODOMETRY"),
        10: ("ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET"),
        11: ("VFR_HUD", "POSITION_TARGET_LOCAL_NED"),
        12: ("DISTANCE_SENSOR",),
    }
)


def profile(name: str) -> Mapping[int, int]:
    """Message id -> interval [us] (EVERY, or 1 and more) of the rates called `name`. Raises LinkError if none are."""
    if name not in _RATES:
        raise LinkError(f"no rates {shown(name)}", "companion", f"there are {listed(PROFILES)}")
    rows = {**_OWN, **_RATES[name]}
    return {dialect.message_id(message): interval(rate) for message, rate in rows.items()}


@cache
def profiles() -> Mapping[str, Mapping[int, int]]:
    """All of them by name."""
    return {name: profile(name) for name in PROFILES}


def interval(rate: float) -> int:
    """The interval [us] of a rate [Hz]; EVERY for 0."""
    return round(1e6 / rate) if rate > 0.0 else EVERY


def group(number: int) -> tuple[int, ...] | None:
    """Message ids of a group of REQUEST_DATA_STREAM, None for all."""
    return None if number == 0 else tuple(dialect.message_id(name) for name in GROUPS.get(number, ()))
