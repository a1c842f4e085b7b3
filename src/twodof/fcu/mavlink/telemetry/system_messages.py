"""How the vehicle stands, as messages: health, battery, in the air or not, home, clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import isfinite

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.telemetry.flight_messages import MASK_32, Encoder, flying
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.link.control_period import TICK_MS, TICK_US
from twodof.link.mavlink.packing import Packed, Packer

QUADROTOR, PX4, VERSION = 2, 12, 3
"""HEARTBEAT: MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_PX4 and MAVLink's version."""

# MAV_SYS_STATUS_SENSOR
GYRO, ACCELEROMETER, RANGE, RATE_CONTROL, ATTITUDE_CONTROL, POSITION_CONTROL = 1, 2, 256, 1024, 2048, 16384
MOTORS, AHRS, BATTERY, PREARM = 32768, 2097152, 33554432, 268435456
PRESENT = (
    GYRO | ACCELEROMETER | RANGE | RATE_CONTROL | ATTITUDE_CONTROL | POSITION_CONTROL | MOTORS | AHRS | BATTERY | PREARM
)
FENCE = 1048576
"""There is none; said to be sound, as MAVProxy takes one that is neither there nor sound for breached."""
UNHEALTHY: tuple[tuple[int, int], ...] = (
    (BIT["imu_lost"], GYRO | ACCELEROMETER),
    (BIT["range_lost"], RANGE),
    (BIT["estimate_lost"], AHRS),
    (BIT["own_failed"] | BIT["command_stuck"] | BIT["command_lost"], RATE_CONTROL | ATTITUDE_CONTROL),
    (BIT["battery_low"] | BIT["battery_critical"], BATTERY),
)
"""Causes of the failsafe, and what SYS_STATUS calls unhealthy while they hold."""

ON_THE_GROUND = BIT["not_idle"] | BIT["tilted"]
"""Causes that keep from arming, and in flight are as they should be."""

LIPO, ALL_FUNCTIONS, CHARGE_OK, CHARGE_LOW, CHARGE_CRITICAL = 1, 1, 1, 2, 3
UNKNOWN_16, UNKNOWN_SIGNED_16 = 0xFFFF, 0x7FFF
LIFTED, GROUNDED = 2, 1
"""MAV_LANDED_STATE."""


def health(causes: int) -> int:
    """onboard_control_sensors_health for a mask of causes."""
    sound = PRESENT | FENCE
    for bits, sensors in UNHEALTHY:
        if causes & bits:
            sound &= ~sensors
    return sound & ~PREARM if causes else sound


def hindering(step: ControlStep) -> int:
    """The causes that would keep from arming, or in flight are not as they should be."""
    return step.causes & ~ON_THE_GROUND if step.armed else step.causes


def millivolts(voltage: float) -> int:
    """A voltage [V] in whole mV, 65535 where it is unknown."""
    return round(min(max(voltage, 0.0), 65.534) * 1000.0) if isfinite(voltage) else UNKNOWN_16


def percent(charge: float) -> int:
    """A charge from 0 to 1 in whole percent, -1 where it is unknown."""
    return round(min(max(charge, 0.0), 1.0) * 100.0) if isfinite(charge) else -1


def heartbeat(commander: Commander) -> Callable[[], Packed]:
    """HEARTBEAT."""
    pack = Packer("HEARTBEAT")

    def encode() -> Packed:
        c = commander
        return pack(c.custom_mode, QUADROTOR, PX4, c.base_mode, c.system_status, VERSION)

    return encode


def sys_status(load: Callable[[], float]) -> Encoder:
    """SYS_STATUS; `load` says which part of a control period a step takes, 0 to 1. No current is measured."""
    pack = Packer("SYS_STATUS")

    def encode(s: ControlStep) -> Packed:
        volts, charge = millivolts(s.sample.voltage), percent(s.sample.charge)
        used = round(min(max(load(), 0.0), 1.0) * 1000.0)
        return pack(PRESENT, PRESENT, health(hindering(s)), used, volts, -1, 0, 0, 0, 0, 0, 0, charge, 0, 0, 0)

    return encode


def battery_status() -> Encoder:
    """BATTERY_STATUS: the voltage of the whole pack in the place of the first cell's, as MAVLink has it then."""
    pack = Packer("BATTERY_STATUS")
    cells = (UNKNOWN_16,) * 9
    critical, low = BIT["battery_critical"], BIT["battery_low"]

    def encode(s: ControlStep) -> Packed:
        state = CHARGE_CRITICAL if s.causes & critical else CHARGE_LOW if s.causes & low else CHARGE_OK
        return pack(
            *(-1, -1, UNKNOWN_SIGNED_16, millivolts(s.sample.voltage)),
            *cells,
            *(-1, 0, ALL_FUNCTIONS, LIPO, percent(s.sample.charge), 0, state),
            *(0, 0, 0, 0, 0, 0),
        )

    return encode


def extended_sys_state() -> Encoder:
    """EXTENDED_SYS_STATE: in the air while the motors give thrust."""
    pack = Packer("EXTENDED_SYS_STATE")
    lifted, grounded = pack(0, LIFTED), pack(0, GROUNDED)
    return lambda s: lifted if flying(s) else grounded


def home_position() -> Callable[[], Packed]:
    """HOME_POSITION: the middle of the rail. A rig indoors has no place on the globe: latitude and longitude are 0."""
    pack = Packer("HOME_POSITION")
    home = pack(0, 0, 0, *(0.0,) * 3, *(1.0, 0.0, 0.0, 0.0), *(0.0,) * 3, 0)
    return lambda: home


def system_time(controller: FlightController) -> Callable[[], Packed]:
    """SYSTEM_TIME: the wall clock of the machine, and time since the start."""
    pack = Packer("SYSTEM_TIME")
    return lambda: pack(time.time_ns() // 1000, controller.tick * TICK_MS & MASK_32)


def estimator_status() -> Encoder:
    """ESTIMATOR_STATUS: attitude, position and velocity along the rail are estimated, as long as they are believed."""
    pack = Packer("ESTIMATOR_STATUS")
    lost, unranged = BIT["estimate_lost"] | BIT["imu_lost"], BIT["range_lost"]
    unknown = (0.0,) * 8

    def encode(s: ControlStep) -> Packed:
        flags = 0 if s.causes & lost else 1 if s.causes & unranged else 1 | 2 | 8
        return pack(s.tick * TICK_US, *unknown, flags)

    return encode
