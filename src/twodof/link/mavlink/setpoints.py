"""SetPoint, and its conversion to and from MAVLink messages, with masks as PX4 reads them.

A field that a message ignores is None in the set-point. Of an attitude only the pitch counts; north is the rail's x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from twodof.link.mavlink.messages import message
from twodof.signals import ATTITUDE, OPEN_LOOP, POSITION, RATE, TICK_MS, VELOCITY

NAN = math.nan

ROLL_RATE, PITCH_RATE, YAW_RATE, THRUST_BODY, NO_THRUST, NO_ATTITUDE = 1, 2, 4, 32, 64, 128
"""Bits of SET_ATTITUDE_TARGET.type_mask: what is ignored, and that `thrust_body` is given."""

ALL_RATES = ROLL_RATE | PITCH_RATE | YAW_RATE
NO_X, NO_VX, NO_AX, FORCE = 1, 8, 64, 512
"""Bits of SET_POSITION_TARGET_LOCAL_NED.type_mask that matter on a rail."""

_POSITION, _VELOCITY, _ACCELERATION, _YAW = 7, 56, 448, 3072
LOCAL_NED, BODY_NED = 1, 8
"""MAV_FRAME; on the rail the body's north is the rail's."""


class SetPoint(NamedTuple):
    """Set-point of one message: the loop (an index into `signals.MODES`; None: thrust alone) and its numbers.

    Units are those of `flight.declarations.INPUTS`. A number that is None keeps its last value.
    """

    loop: int | None
    x0: float | None = None
    v0: float | None = None
    ax0: float | None = None
    theta0: float | None = None
    q0: float | None = None
    thrust: float | None = None
    M_open: float | None = None

    @property
    def sound(self) -> bool:
        """True if its numbers are finite and its loop is one of the flight code's."""
        loop = self.loop is None or OPEN_LOOP <= self.loop <= POSITION
        return loop and all(value is None or math.isfinite(value) for value in self[1:])

    @property
    def moves_cart(self) -> bool:
        """True if its loop moves the cart along the rail."""
        return self.loop is not None and self.loop >= VELOCITY

    def after(self, before: SetPoint) -> SetPoint:
        """Return this set-point with each number that is None taken from the set-point `before`."""
        return SetPoint._make(old if new is None else new for new, old in zip(self, before, strict=True))


NOTHING = SetPoint(None)
"""Set-point that asks for nothing and leaves all as it is."""


def quaternion(theta: float) -> list[float]:
    """Return the quaternion (w, x, y, z) of a pitch [rad]; level is exactly (1, 0, 0, 0)."""
    return [math.cos(0.5 * theta), 0.0, math.sin(0.5 * theta), 0.0]


def pitch(q: Sequence[float]) -> float:
    """Return the pitch [rad], within +-pi/2, of a quaternion (w, x, y, z) of any length; NaN without a rotation."""
    w, x, y, z = q
    square = w * w + x * x + y * y + z * z
    if not 1e-6 < square < 1e6:
        return NAN
    return math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x) / square)))


def read_attitude(received: Any) -> SetPoint | None:
    """Return the set-point in a SET_ATTITUDE_TARGET; None if this drone cannot fly it: rates without a pitch rate.

    As in PX4, an attitude takes precedence over rates, and the z of `thrust_body` over `thrust`.
    """
    mask = received.type_mask
    thrust = None
    if mask & THRUST_BODY:
        thrust = -received.thrust_body[2]
    elif not mask & NO_THRUST:
        thrust = received.thrust
    if not mask & NO_ATTITUDE:
        return SetPoint(ATTITUDE, theta0=pitch(received.q), thrust=thrust)
    if not mask & (ROLL_RATE | PITCH_RATE):
        return SetPoint(RATE, q0=received.body_pitch_rate, thrust=thrust)
    if mask & PITCH_RATE and not mask & NO_THRUST | mask & THRUST_BODY:
        return SetPoint(None, thrust=thrust)
    return None


def read_position(received: Any) -> SetPoint | None:
    """Return the set-point in a SET_POSITION_TARGET_LOCAL_NED; None if this drone cannot fly it.

    As in PX4, a position takes precedence over a velocity, and a NaN counts as ignored. The frame is LOCAL_NED, or
    BODY_NED for a velocity. An acceleration is a feed-forward of either. Forces, and an acceleration alone, give None.
    """
    mask, frame = received.type_mask, received.coordinate_frame
    given = not mask & NO_AX and not math.isnan(received.afx)
    if frame not in (LOCAL_NED, BODY_NED) or (mask & FORCE and given):
        return None
    acceleration = received.afx if given else 0.0
    x = NAN if mask & NO_X or frame == BODY_NED else received.x
    if not math.isnan(x):
        return SetPoint(POSITION, x0=x, ax0=acceleration)
    v = NAN if mask & NO_VX else received.vx
    if not math.isnan(v):
        return SetPoint(VELOCITY, v0=v, ax0=acceleration)
    return None


_MASK_32 = 0xFFFFFFFF  # ticks and milliseconds begin anew where a uint32 does


def setpoint_message(setpoint: SetPoint, tick: int, **target: int) -> Any:
    """Return the message that carries a set-point with a loop, for `tick` and the addressee `target`."""
    loop, x0, v0, ax0, theta0, q0, thrust, M_open = setpoint
    T = thrust or 0.0
    if loop == OPEN_LOOP:
        flags = {"openloop": 1, "enableM": 1, "enableT": int(thrust is not None)}
        return message("TWODOF_OPENLOOP", tick=tick & _MASK_32, M=M_open or 0.0, T=T, **flags, **target)
    where = {"time_boot_ms": tick * TICK_MS & _MASK_32, **target}
    if loop in (ATTITUDE, RATE):
        mask = ALL_RATES if loop == ATTITUDE else NO_ATTITUDE
        turned = {"q": quaternion(theta0 or 0.0), "body_pitch_rate": q0 or 0.0}
        return message("SET_ATTITUDE_TARGET", type_mask=mask, **turned, thrust=T, **where)
    mask = (_VELOCITY if loop == POSITION else _POSITION) | (_ACCELERATION if ax0 is None else 0) | _YAW
    moved = {"x": x0 or 0.0, "vx": v0 or 0.0, "afx": ax0 or 0.0, "coordinate_frame": LOCAL_NED}
    return message("SET_POSITION_TARGET_LOCAL_NED", type_mask=mask, **moved, **where)
