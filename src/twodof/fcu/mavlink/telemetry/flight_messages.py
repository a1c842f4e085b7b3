"""What flies, as messages: attitude, position, set-points and motors, from one step of the flight code.

Axes are forward-right-down. North is along the rail: heading is 0 and x points north. What the rig cannot do (roll,
yaw, sideways, up) is 0. The rest of the fields is as https://mavlink.io/en/messages/common.html says.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, isfinite, nan, sin

from twodof.fcu.control.flight_code import ControlStep
from twodof.link.control_period import TICK_MS, TICK_US
from twodof.link.mavlink.packing import Packed, Packer
from twodof.signals import OPEN_LOOP, POSITION, RATE, VELOCITY

MASK_32 = 0xFFFFFFFF
LOCAL_NED, BODY_FRD, ESTIMATOR_AUTOPILOT = 1, 12, 8
PWM_OFF, PWM_LOW, PWM_SPAN = 900, 1000, 1000
# Of POSITION_TARGET_TYPEMASK: only x, vx and afx of the rig are ever flown.
_X, _VX, _AX, _ALWAYS = 1, 8, 64, 2 | 4 | 16 | 32 | 128 | 256 | 1024 | 2048
_NO_ATTITUDE, _NO_PITCH_RATE = 128, 2

Encoder = Callable[[ControlStep], Packed]


def quaternion(pitch: float) -> tuple[float, float, float, float]:
    """Attitude (w, x, y, z) of a pitch [rad] alone; NaN where that is none."""
    if not isfinite(pitch):
        return nan, nan, nan, nan
    return cos(pitch / 2.0), 0.0, sin(pitch / 2.0), 0.0


def attitude() -> Encoder:
    """ATTITUDE."""
    pack = Packer("ATTITUDE")
    return lambda s: pack(s.tick * TICK_MS & MASK_32, 0.0, s.theta, 0.0, 0.0, s.q, 0.0)


def attitude_quaternion() -> Encoder:
    """ATTITUDE_QUATERNION."""
    pack = Packer("ATTITUDE_QUATERNION")

    def encode(s: ControlStep) -> Packed:
        return pack(s.tick * TICK_MS & MASK_32, *quaternion(s.theta), 0.0, s.q, 0.0, 0.0, 0.0, 0.0, 0.0)

    return encode


def local_position() -> Encoder:
    """LOCAL_POSITION_NED."""
    pack = Packer("LOCAL_POSITION_NED")
    return lambda s: pack(s.tick * TICK_MS & MASK_32, s.x, 0.0, 0.0, s.v, 0.0, 0.0)


def odometry() -> Encoder:
    """ODOMETRY: pose in local NED, velocities in the body's axes, covariances unknown."""
    pack = Packer("ODOMETRY")
    unknown = (nan, *(0.0,) * 20)

    def encode(s: ControlStep) -> Packed:
        tilt = s.theta if isfinite(s.theta) else nan
        forward, down = (s.v * cos(tilt), s.v * sin(tilt)) if tilt == tilt else (nan, nan)
        return pack(
            s.tick * TICK_US,
            *(s.x, 0.0, 0.0),
            *quaternion(s.theta),
            *(forward, 0.0, down),
            *(0.0, s.q, 0.0),
            *unknown,
            *unknown,
            LOCAL_NED,
            BODY_FRD,
            0,
            ESTIMATOR_AUTOPILOT,
            0,
        )

    return encode


def attitude_target() -> Encoder:
    """ATTITUDE_TARGET: the set-points in use, thrust from 0 to 1 (upwards positive, as in PX4)."""
    pack = Packer("ATTITUDE_TARGET")

    def encode(s: ControlStep) -> Packed:
        mode = s.asked.mode
        mask = _NO_ATTITUDE | _NO_PITCH_RATE if mode <= OPEN_LOOP else _NO_ATTITUDE if mode == RATE else 0
        return pack(s.tick * TICK_MS & MASK_32, *quaternion(s.theta0), 0.0, s.q0, 0.0, abs(s.T), mask)

    return encode


def position_target() -> Encoder:
    """POSITION_TARGET_LOCAL_NED: x0, v0 in use and the feed-forward; the mask says which of them is flown."""
    pack = Packer("POSITION_TARGET_LOCAL_NED")
    zeros = (0.0, 0.0)

    def encode(s: ControlStep) -> Packed:
        mode = s.asked.mode
        mask = _ALWAYS | (0 if mode == POSITION else _X | _AX) | (0 if mode in (VELOCITY, POSITION) else _VX)
        stamp = s.tick * TICK_MS & MASK_32
        return pack(stamp, s.x0, *zeros, s.v0, *zeros, s.asked.ax0, *zeros, 0.0, 0.0, mask, LOCAL_NED)

    return encode


def servo_output() -> Encoder:
    """SERVO_OUTPUT_RAW: pulse widths of PX4's quadrotor x, motors 1 and 3 in front; 900 us while disarmed."""
    pack = Packer("SERVO_OUTPUT_RAW")
    rest = (0,) * 4
    more = (0,) * 8

    def width(command: float, armed: bool) -> int:
        if not armed or not isfinite(command):
            return PWM_OFF
        return PWM_LOW + round(PWM_SPAN * min(max(command, 0.0), 1.0))

    def encode(s: ControlStep) -> Packed:
        fore, aft = width(s.fore, s.armed), width(s.aft, s.armed)
        return pack(s.tick * TICK_US & MASK_32, fore, aft, fore, aft, *rest, 0, *more)

    return encode


def actuator_controls() -> Encoder:
    """ACTUATOR_CONTROL_TARGET: what the mixer was given: M as pitch, T as thrust."""
    pack = Packer("ACTUATOR_CONTROL_TARGET")
    return lambda s: pack(s.tick * TICK_US, 0.0, s.M, 0.0, s.T, 0.0, 0.0, 0.0, 0.0, 0)


def vfr_hud() -> Encoder:
    """VFR_HUD: speed along the rail and thrust in percent."""
    pack = Packer("VFR_HUD")

    def encode(s: ControlStep) -> Packed:
        throttle = round(100.0 * min(abs(s.T), 1.0)) if isfinite(s.T) else 0
        return pack(nan, abs(s.v), 0.0, 0.0, 0, throttle)

    return encode


def flying(step: ControlStep) -> bool:
    """Whether the motors give thrust."""
    return step.armed and (step.fore > 0.0 or step.aft > 0.0)


ENCODERS: dict[int, Callable[[], Encoder]] = {
    30: attitude,
    31: attitude_quaternion,
    32: local_position,
    36: servo_output,
    74: vfr_hud,
    83: attitude_target,
    85: position_target,
    140: actuator_controls,
    331: odometry,
}
"""Message id -> what makes its encoder."""
