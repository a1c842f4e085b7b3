"""Set-points: what one message asks for, and the values in use."""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

from twodof.signals import MODES

OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION = range(len(MODES))
"""The loops by number, the index into `signals.MODES`."""

NUMBERS = ("x0", "v0", "ax0", "theta0", "q0", "thrust", "M_open")
"""The set-points that are numbers, as `Asked` has them."""


class SetPoint(NamedTuple):
    """What one message asks for: the loop (an index into `signals.MODES`; None: thrust alone) and its numbers.

    A number that is None keeps its last value. Units as in `flight.core.INPUTS`.
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
        """Whether its numbers are finite and its loop is one."""
        loop = self.loop is None or OPEN_LOOP <= self.loop <= POSITION
        return loop and all(value is None or isfinite(value) for value in self[1:])

    def over(self, before: SetPoint) -> SetPoint:
        """This one, with what it leaves open taken from the one before."""
        return SetPoint(*(old if new is None else new for new, old in zip(self, before, strict=True)))


IDLE = SetPoint(None, *(0.0,) * len(NUMBERS))
"""Nothing is asked for."""


def flown(values: SetPoint) -> int:
    """The loop that flies: rate and attitude without thrust are off, as PX4's mixer gives no moment without thrust."""
    loop = values.loop
    if loop is None or (loop in (RATE, ATTITUDE) and not (values.thrust or 0.0) > 0.0):
        return OFF
    return loop


def idle(values: SetPoint) -> bool:
    """Whether nothing is asked of the motors, as the failsafe's `not_idle` sees it."""
    loop = flown(values)
    return loop == OFF or (loop == OPEN_LOOP and not values.thrust and not values.M_open)
