"""Rates at which messages are sent to a client that has not said otherwise: PX4's, and those of our own messages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

ONBOARD: Mapping[int, float] = MappingProxyType(
    {
        30: 100.0,  # ATTITUDE
        31: 50.0,  # ATTITUDE_QUATERNION
        105: 50.0,  # HIGHRES_IMU
        32: 30.0,  # LOCAL_POSITION_NED
        331: 30.0,  # ODOMETRY
        132: 10.0,  # DISTANCE_SENSOR
        36: 10.0,  # SERVO_OUTPUT_RAW
        83: 10.0,  # ATTITUDE_TARGET
        85: 10.0,  # POSITION_TARGET_LOCAL_NED
        140: 10.0,  # ACTUATOR_CONTROL_TARGET
        74: 10.0,  # VFR_HUD
        1: 5.0,  # SYS_STATUS
        245: 5.0,  # EXTENDED_SYS_STATE
        2: 1.0,  # SYSTEM_TIME
        230: 1.0,  # ESTIMATOR_STATUS
        54206: 1.0,  # TWODOF_RIG
        54209: 1.0,  # TWODOF_LEASE
        54210: 1.0,  # TWODOF_SAFETY
        54211: 1.0,  # TWODOF_TIMING
        147: 0.5,  # BATTERY_STATUS
        242: 0.5,  # HOME_POSITION
        436: 0.5,  # CURRENT_MODE
        437: 0.3,  # AVAILABLE_MODES_MONITOR
        411: 0.2,  # CURRENT_EVENT_SEQUENCE
        54204: 0.0,  # TWODOF_TOF: each sample
        54200: 0.0,  # TWODOF_OPENLOOP: each change
    }
)
"""Message id -> rate [1/s] on a fast link; 0: with each news."""

GROUND: Mapping[int, float] = MappingProxyType(
    {
        30: 15.0,
        31: 10.0,
        105: 2.0,
        32: 1.0,
        331: 0.5,
        132: 0.5,
        36: 1.0,
        83: 2.0,
        85: 1.5,
        140: 1.0,
        74: 4.0,
        1: 1.0,
        245: 1.0,
        2: 0.5,
        230: 0.5,
        54206: 1.0,
        54209: 1.0,
        54210: 1.0,
        54211: 1.0,
        147: 0.5,
        242: 0.5,
        436: 0.5,
        437: 0.3,
        411: 0.2,
        54200: 0.0,
    }
)
"""The same for a slow link, such as a telemetry radio."""

PROFILES: Mapping[str, Mapping[int, float]] = MappingProxyType({"onboard": ONBOARD, "ground": GROUND})
