"""Rates at which a client is sent messages unless it asks for others: PX4's, and those of our own messages.

The flight controller streams at them, and the companion thins out to them for each client. Source of PX4's: v1.16,
src/modules/mavlink/mavlink_main.cpp, MAVLINK_MODE_ONBOARD and MAVLINK_MODE_NORMAL, where it has one.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Rates(NamedTuple):
    """Of one message, [1/s]: on a fast link and on a slow one, such as a telemetry radio.

    0: with each news; None: on request only. `on_change`: beside the rate it comes at each change.
    """

    number: int
    name: str
    onboard: float | None
    ground: float | None
    on_change: bool = False


RATES = (
    Rates(30, "ATTITUDE", 100.0, 15.0),
    Rates(31, "ATTITUDE_QUATERNION", 50.0, 10.0),
    Rates(105, "HIGHRES_IMU", 50.0, 2.0),
    Rates(32, "LOCAL_POSITION_NED", 30.0, 1.0),
    Rates(331, "ODOMETRY", 30.0, 0.5),
    Rates(132, "DISTANCE_SENSOR", 10.0, 0.5),
    Rates(36, "SERVO_OUTPUT_RAW", 10.0, 1.0),
    Rates(83, "ATTITUDE_TARGET", 10.0, 2.0),
    Rates(85, "POSITION_TARGET_LOCAL_NED", 10.0, 1.5),
    Rates(140, "ACTUATOR_CONTROL_TARGET", 10.0, 1.0),
    Rates(74, "VFR_HUD", 10.0, 4.0),
    Rates(1, "SYS_STATUS", 5.0, 1.0),
    Rates(245, "EXTENDED_SYS_STATE", 5.0, 1.0),
    Rates(2, "SYSTEM_TIME", 1.0, 0.5),
    Rates(230, "ESTIMATOR_STATUS", 1.0, 0.5),
    Rates(54206, "TWODOF_RIG", 1.0, 1.0, on_change=True),
    Rates(54209, "TWODOF_LEASE", 1.0, 1.0, on_change=True),
    Rates(54210, "TWODOF_SAFETY", 1.0, 1.0, on_change=True),
    Rates(54211, "TWODOF_TIMING", 1.0, 1.0, on_change=True),
    Rates(147, "BATTERY_STATUS", 0.5, 0.5),
    Rates(242, "HOME_POSITION", 0.5, 0.5),
    Rates(436, "CURRENT_MODE", 0.5, 0.5, on_change=True),
    Rates(437, "AVAILABLE_MODES_MONITOR", 0.3, 0.3, on_change=True),
    Rates(54204, "TWODOF_TOF", 0.0, None),
    Rates(54200, "TWODOF_OPENLOOP", 0.0, 0.0, on_change=True),
)

ONBOARD: Mapping[int, float] = MappingProxyType({row.number: row.onboard for row in RATES if row.onboard is not None})
"""Message id -> rate [1/s] on a fast link; 0: with each news."""
GROUND: Mapping[int, float] = MappingProxyType({row.number: row.ground for row in RATES if row.ground is not None})
"""The same for a slow link."""
PROFILES: Mapping[str, Mapping[int, float]] = MappingProxyType({"onboard": ONBOARD, "ground": GROUND})
