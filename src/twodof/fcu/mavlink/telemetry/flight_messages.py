"""What one step of the flight code tells as messages: attitude, position, set-points, motors, battery.

Axes are forward-right-down. North is along the rail: heading is 0 and x points north. What the rig cannot do (roll,
yaw, sideways, up) is 0. The rest of the fields is as https://mavlink.io/en/messages/common.html says.
"""

from collections.abc import Callable
from math import cos, isfinite, nan, sin
from typing import Any, NamedTuple

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.wire_tick import MASK_32
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.signals import OPEN_LOOP, POSITION, RATE, TICK_MS, TICK_US, VELOCITY

LOCAL_NED, BODY_FRD, ESTIMATOR_AUTOPILOT = 1, 12, 8
PWM_OFF, PWM_LOW, PWM_SPAN = 900, 1000, 1000
# Of POSITION_TARGET_TYPEMASK: only x, vx and afx of the rig are ever flown.
_X, _VX, _AX, _ALWAYS = 1, 8, 64, 2 | 4 | 16 | 32 | 128 | 256 | 1024 | 2048
_NO_ATTITUDE, _NO_PITCH_RATE = 128, 2

LIPO, ALL_FUNCTIONS, CHARGE_OK, CHARGE_LOW, CHARGE_CRITICAL = 1, 1, 1, 2, 3
UNKNOWN_16, UNKNOWN_SIGNED_16 = 0xFFFF, 0x7FFF
LIFTED, GROUNDED = 2, 1
"""MAV_LANDED_STATE."""


class StepMessage(NamedTuple):
    """A message, those of its fields that are not always 0, in the order of the wire, and their values at a step."""

    name: str
    fields: tuple[str, ...]
    values: Callable[[ControlStep], tuple[Any, ...]]


def boot_ms(step: ControlStep) -> int:
    """time_boot_ms of a step."""
    return step.tick * TICK_MS & MASK_32


def quaternion(pitch: float) -> tuple[float, float, float, float]:
    """Attitude (w, x, y, z) of a pitch [rad] alone; NaN where that is none."""
    if not isfinite(pitch):
        return nan, nan, nan, nan
    return cos(pitch / 2.0), 0.0, sin(pitch / 2.0), 0.0


def millivolts(voltage: float) -> int:
    """A voltage [V] in whole mV, 65535 where it is unknown."""
    return round(min(max(voltage, 0.0), 65.534) * 1000.0) if isfinite(voltage) else UNKNOWN_16


def percent(charge: float) -> int:
    """A charge from 0 to 1 in whole percent, -1 where it is unknown."""
    return round(min(max(charge, 0.0), 1.0) * 100.0) if isfinite(charge) else -1


def _odometry(s: ControlStep) -> tuple[Any, ...]:
    """The pose in local NED, velocities in the body's axes, covariances unknown."""
    unknown = (nan, *(0.0,) * 20)
    tilt = s.theta if isfinite(s.theta) else nan
    forward, down = s.v * cos(tilt), s.v * sin(tilt)
    pose = s.tick * TICK_US, s.x, *quaternion(s.theta)
    return *pose, forward, down, s.q, *unknown, *unknown, LOCAL_NED, BODY_FRD, ESTIMATOR_AUTOPILOT


def _attitude_target(s: ControlStep) -> tuple[Any, ...]:
    """The set-points in use, thrust from 0 to 1 (upwards positive, as in PX4)."""
    mode = s.asked.mode
    mask = _NO_ATTITUDE | _NO_PITCH_RATE if mode <= OPEN_LOOP else _NO_ATTITUDE if mode == RATE else 0
    return boot_ms(s), *quaternion(s.theta0), s.q0, abs(s.T), mask


def _position_target(s: ControlStep) -> tuple[Any, ...]:
    """x0, v0 in use and the feed-forward; the mask says which of them is flown."""
    mode = s.asked.mode
    mask = _ALWAYS | (0 if mode == POSITION else _X | _AX) | (0 if mode in (VELOCITY, POSITION) else _VX)
    return boot_ms(s), s.x0, s.v0, s.asked.ax0, mask, LOCAL_NED


def _servo_output(s: ControlStep) -> tuple[Any, ...]:
    """Pulse widths of PX4's quadrotor x, motors 1 and 3 in front; 900 us while disarmed."""

    def width(command: float) -> int:
        if not s.armed or not isfinite(command):
            return PWM_OFF
        return PWM_LOW + round(PWM_SPAN * min(max(command, 0.0), 1.0))

    fore, aft = width(s.fore), width(s.aft)
    return s.tick * TICK_US & MASK_32, fore, aft, fore, aft


def _vfr_hud(s: ControlStep) -> tuple[Any, ...]:
    """The speed along the rail, and thrust in percent."""
    throttle = round(100.0 * min(abs(s.T), 1.0)) if isfinite(s.T) else 0
    return nan, abs(s.v), throttle


def _battery_status(s: ControlStep) -> tuple[Any, ...]:
    """The voltage of the whole pack stands in the place of the first cell's, as MAVLink has it then."""
    critical, low = (s.causes & BIT[name] for name in ("battery_critical", "battery_low"))
    state = CHARGE_CRITICAL if critical else CHARGE_LOW if low else CHARGE_OK
    cells = millivolts(s.sample.voltage), *(UNKNOWN_16,) * 9
    return -1, -1, UNKNOWN_SIGNED_16, *cells, -1, ALL_FUNCTIONS, LIPO, percent(s.sample.charge), state


def _landed_state(s: ControlStep) -> tuple[Any, ...]:
    """In the air while the motors give thrust."""
    return (LIFTED if s.armed and (s.fore > 0.0 or s.aft > 0.0) else GROUNDED,)


def _estimator_status(s: ControlStep) -> tuple[Any, ...]:
    """Attitude, position and velocity along the rail are estimated, as long as they are believed."""
    lost = s.causes & (BIT["estimate_lost"] | BIT["imu_lost"])
    return s.tick * TICK_US, 0 if lost else 1 if s.causes & BIT["range_lost"] else 1 | 2 | 8


_Q = ("q1", "q2", "q3", "q4")
_CELLS = ("current_consumed", "energy_consumed", "temperature", "voltages", "current_battery")
_PACK = ("battery_function", "type", "battery_remaining", "charge_state")
_POSE, _TWIST = ("time_usec", "x", "q"), ("vx", "vz", "pitchspeed")
_FRAMES = ("pose_covariance", "velocity_covariance", "frame_id", "child_frame_id", "estimator_type")
_SERVOS = tuple(f"servo{number}_raw" for number in range(1, 5))

STEP_MESSAGES = (
    StepMessage(
        "ATTITUDE",
        ("time_boot_ms", "pitch", "pitchspeed"),
        lambda s: (boot_ms(s), s.theta, s.q),
    ),
    StepMessage(
        "ATTITUDE_QUATERNION",
        ("time_boot_ms", *_Q, "pitchspeed"),
        lambda s: (boot_ms(s), *quaternion(s.theta), s.q),
    ),
    StepMessage("LOCAL_POSITION_NED", ("time_boot_ms", "x", "vx"), lambda s: (boot_ms(s), s.x, s.v)),
    StepMessage("ODOMETRY", (*_POSE, *_TWIST, *_FRAMES), _odometry),
    StepMessage("ATTITUDE_TARGET", ("time_boot_ms", "q", "body_pitch_rate", "thrust", "type_mask"), _attitude_target),
    StepMessage(
        "POSITION_TARGET_LOCAL_NED",
        ("time_boot_ms", "x", "vx", "afx", "type_mask", "coordinate_frame"),
        _position_target,
    ),
    StepMessage("SERVO_OUTPUT_RAW", ("time_usec", *_SERVOS), _servo_output),
    StepMessage(  # what the mixer was given: M as pitch, T as thrust
        "ACTUATOR_CONTROL_TARGET",
        ("time_usec", "controls"),
        lambda s: (s.tick * TICK_US, 0.0, s.M, 0.0, s.T, *(0.0,) * 4),
    ),
    StepMessage("VFR_HUD", ("airspeed", "groundspeed", "throttle"), _vfr_hud),
    StepMessage("BATTERY_STATUS", (*_CELLS, *_PACK), _battery_status),
    StepMessage("EXTENDED_SYS_STATE", ("landed_state",), _landed_state),
    StepMessage("ESTIMATOR_STATUS", ("time_usec", "flags"), _estimator_status),
)
