"""Set-points: what one message asks for, and the values in use."""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, PERIOD, POSITION, RATE

HORIZON = round(60.0 / PERIOD)
"""Most ticks that something may be asked for ahead: a minute."""

TARGET, OPENLOOP, STICKS = "target", "open loop", "sticks"
"""Where a set-point comes from: SET_ATTITUDE_TARGET and the like, TWODOF_OPENLOOP, MANUAL_CONTROL."""


class SetpointValues(NamedTuple):
    """The set-points in use, as `ControlInput` has them; `loop` is an index into `signals.MODES`."""

    loop: int = OFF
    x0: float = 0.0
    v0: float = 0.0
    ax0: float = 0.0
    theta0: float = 0.0
    q0: float = 0.0
    thrust: float = 0.0
    M_open: float = 0.0

    def with_number(self, name: str, value: float) -> SetpointValues:
        """These, with another number `name`."""
        return SetpointValues._make(value if own == name else old for own, old in zip(self._fields, self, strict=True))

    @property
    def flown(self) -> int:
        """The loop that flies: without thrust rate and attitude are off, as PX4's mixer gives no moment without it."""
        return OFF if self.loop in (RATE, ATTITUDE) and not self.thrust > 0.0 else self.loop

    @property
    def idle(self) -> bool:
        """Whether nothing is asked of the motors, as the failsafe's `not_idle` sees it."""
        loop = self.flown
        return loop == OFF or (loop == OPEN_LOOP and not self.thrust and not self.M_open)


class OpenLoopState(NamedTuple):
    """The open-loop message in use, as TWODOF_OPENLOOP has it; `tick` is when it began to act, `revision` a count."""

    tick: int = 0
    M: float = 0.0
    T: float = 0.0
    openloop: bool = False
    enableM: bool = False
    enableT: bool = False
    revision: int = 0


class SetPoint(NamedTuple):
    """What one message asks for: the loop (an index into `signals.MODES`; None: thrust alone) and its numbers.

    A number that is None keeps its last value. Units as in `flight.declarations.INPUTS`.
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

    def after(self, before: SetPoint) -> SetPoint:
        """Both in one: what this one leaves open is what the one before asks for."""
        return SetPoint._make(old if new is None else new for new, old in zip(self, before, strict=True))

    def over(self, before: SetpointValues) -> SetpointValues:
        """The values before it, with what it asks for."""
        return SetpointValues._make(old if new is None else new for new, old in zip(self, before, strict=True))


NOTHING = SetPoint(None)
"""It asks for nothing and leaves all as it is."""
