"""Sticks: what MANUAL_CONTROL asks for in each mode."""

from twodof.fcu.command.setpoints import SetPoint, SetpointValues
from twodof.link.mavlink import modes
from twodof.signals import ATTITUDE, OPEN_LOOP, POSITION, RATE, VELOCITY

RATE_AT_FULL = 1.75
"""Pitch rate at full stick [rad/s] (100 deg/s)."""

PITCH_AT_FULL = 0.35
"""Pitch at full stick [rad] (20 deg)."""

VELOCITY_AT_FULL = 0.3
"""Velocity at full stick [m/s]."""


def manual_setpoint(custom_mode: int, pitch: float, thrust: float, held: SetpointValues, x: float) -> SetPoint:
    """The set-point of the stick `pitch` (-1 to 1, forward is nose down and towards +x) and of `thrust` (0 to 1).

    In position mode a centred stick holds the position: that of `held` if it is one, else `x` [m].
    """
    if custom_mode == modes.RATE:
        return SetPoint(RATE, q0=-RATE_AT_FULL * pitch, thrust=thrust)
    if custom_mode == modes.ATTITUDE:
        return SetPoint(ATTITUDE, theta0=-PITCH_AT_FULL * pitch, thrust=thrust)
    if custom_mode != modes.POSITION:
        return SetPoint(OPEN_LOOP, M_open=-pitch, thrust=thrust)
    if pitch != 0.0:
        return SetPoint(VELOCITY, v0=VELOCITY_AT_FULL * pitch, ax0=0.0)
    return SetPoint(POSITION, x0=held.x0 if held.loop == POSITION else x, ax0=0.0)
