"""Set-points as messages of `common`, and back: masks as PX4 reads them, the pitch as a quaternion.

What is ignored in a message is None in what is read from it. Of an attitude the pitch counts; north is the rail's x.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from twodof.link.mavlink.messages import message

NAN = math.nan

ROLL_RATE, PITCH_RATE, YAW_RATE, THRUST_BODY, NO_THRUST, NO_ATTITUDE = 1, 2, 4, 32, 64, 128
"""Bits of SET_ATTITUDE_TARGET.type_mask: what is ignored, and that `thrust_body` is given."""

ALL_RATES = ROLL_RATE | PITCH_RATE | YAW_RATE
NO_X, NO_VX, NO_AX, FORCE = 1, 8, 64, 512
"""Bits of SET_POSITION_TARGET_LOCAL_NED.type_mask that matter on a rail."""

_POSITION, _VELOCITY, _ACCELERATION, _YAW = 7, 56, 448, 3072
LOCAL_NED, BODY_NED = 1, 8
"""MAV_FRAME; on the rail the body's north is the rail's."""


class SetpointTarget(NamedTuple):
    """What a message asks for, None where it says nothing; `loop` is one of signals.MODES, "" for thrust alone."""

    loop: str
    value: float = 0.0
    thrust: float | None = None
    feed_forward: float | None = None


def quaternion(theta: float) -> list[float]:
    """(w, x, y, z) of a pitch [rad]; level is exactly (1, 0, 0, 0)."""
    return [math.cos(0.5 * theta), 0.0, math.sin(0.5 * theta), 0.0]


def pitch(q: Sequence[float]) -> float:
    """Pitch [rad] of a quaternion (w, x, y, z) of any length, within +-pi/2; NaN if it is none."""
    w, x, y, z = q
    square = w * w + x * x + y * y + z * z
    if not 1e-6 < square < 1e6:
        return NAN
    return math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x) / square)))


def attitude_target(theta: float, thrust: float, **where: int) -> Any:
    """SET_ATTITUDE_TARGET for a pitch [rad]; `where`: time_boot_ms, target_system, target_component."""
    return message("SET_ATTITUDE_TARGET", type_mask=ALL_RATES, q=quaternion(theta), thrust=thrust, **where)


def rate_target(q: float, thrust: float, **where: int) -> Any:
    """SET_ATTITUDE_TARGET for a pitch rate [rad/s]."""
    return _without_attitude(0, thrust=thrust, body_pitch_rate=q, **where)


def thrust_target(thrust: float, **where: int) -> Any:
    """SET_ATTITUDE_TARGET that sets the thrust alone."""
    return _without_attitude(ALL_RATES, thrust=thrust, **where)


def _without_attitude(ignored: int, **fields: Any) -> Any:
    return message("SET_ATTITUDE_TARGET", type_mask=ignored | NO_ATTITUDE, q=quaternion(0.0), **fields)


def position_target(x: float, acceleration: float = NAN, **where: int) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED for a position along the rail [m], with a feed-forward [m/s2] if it is given."""
    return _along_rail(_VELOCITY, acceleration, x=x, **where)


def velocity_target(v: float, acceleration: float = NAN, **where: int) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED for a velocity along the rail [m/s], with a feed-forward [m/s2] if it is given."""
    return _along_rail(_POSITION, acceleration, vx=v, **where)


def _along_rail(ignored: int, acceleration: float, **fields: Any) -> Any:
    if math.isnan(acceleration):
        ignored |= _ACCELERATION
    else:
        fields["afx"] = acceleration
    return message("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=LOCAL_NED, type_mask=ignored | _YAW, **fields)


def read_attitude(received: Any) -> SetpointTarget | None:
    """What a SET_ATTITUDE_TARGET asks for; None if it is not flown here: rates without the pitch's.

    As PX4: an attitude goes before rates; `thrust_body` before `thrust`, of which its z counts.
    """
    mask = received.type_mask
    thrust = None
    if mask & THRUST_BODY:
        thrust = -received.thrust_body[2]
    elif not mask & NO_THRUST:
        thrust = received.thrust
    if not mask & NO_ATTITUDE:
        return SetpointTarget("attitude", pitch(received.q), thrust)
    if not mask & (ROLL_RATE | PITCH_RATE):
        return SetpointTarget("rate", received.body_pitch_rate, thrust)
    if mask & PITCH_RATE and not mask & NO_THRUST | mask & THRUST_BODY:
        return SetpointTarget("", thrust=thrust)
    return None


def read_position(received: Any) -> SetpointTarget | None:
    """What a SET_POSITION_TARGET_LOCAL_NED asks for; None if it is not flown here.

    As PX4: a position goes before a velocity, and a NaN counts as ignored. The frame is LOCAL_NED, or BODY_NED for a
    velocity. Forces are refused. An acceleration alone is not flown here; with the others it is a feed-forward.
    """
    mask, frame = received.type_mask, received.coordinate_frame
    acceleration = None if mask & NO_AX or math.isnan(received.afx) else received.afx
    if frame not in (LOCAL_NED, BODY_NED) or (mask & FORCE and acceleration is not None):
        return None
    x = NAN if mask & NO_X or frame == BODY_NED else received.x
    if not math.isnan(x):
        return SetpointTarget("position", x, None, acceleration)
    v = NAN if mask & NO_VX else received.vx
    if not math.isnan(v):
        return SetpointTarget("velocity", v, None, acceleration)
    return None
