"""Dry (Coulomb) friction on a speed, with true sticking, as a smooth function of the parameters.

A step integrates everything but the friction, which then acts as an impulse that knows when in the step the motion
stops. So the machine sticks exactly. What is simulated does not jump when a parameter moves the moment of a stop across
a step: an estimation needs derivatives.
"""

from __future__ import annotations

from typing import Any

from twodof.blocks.expressions.expr import maximum, minimum, where


def sticks(speed: Any, drive: Any, more: Any, less: Any) -> Any:
    """Whether friction holds it at rest: `drive` is the acceleration of everything else.

    Friction opposes a positive speed with `more`, a negative one with `less` (both >= 0, as accelerations).
    """
    return (speed == 0.0) & (drive <= more) & (-drive <= less)


def after_friction(speed: Any, drive: Any, more: Any, less: Any, dt: Any) -> Any:
    """The speed after a step of `dt` with friction, from `speed`, that after the step without it."""
    before = speed - drive * dt
    # A motion that stops after a part of the step goes on the other way, if the drive exceeds the friction there.
    slowed, lifted = speed - more * dt, speed + less * dt
    left_up = dt - before / (more - drive)
    left_down = dt + before / (less + drive)
    from_up = where(slowed < 0.0, minimum(0.0, (drive + less) * left_up), slowed)
    from_down = where(lifted > 0.0, maximum(0.0, (drive - more) * left_down), lifted)
    return where(sticks(speed, drive, more, less), speed, where(before > 0.0, from_up, from_down))
