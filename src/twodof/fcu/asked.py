"""What the commander asks of the flight code in one tick, and what it answers to who commands."""

from __future__ import annotations

from typing import NamedTuple

Source = tuple[int, int]
"""Who sent a message: MAVLink system and component."""


class Asked(NamedTuple):
    """Inputs of the flight code that are not measured; names and units as in `flight.core.INPUTS`."""

    mode: int = 0
    arm: bool = False
    x0: float = 0.0
    v0: float = 0.0
    ax0: float = 0.0
    theta0: float = 0.0
    q0: float = 0.0
    thrust: float = 0.0
    M_open: float = 0.0
    use_trim: bool = False
    in_reset: bool = False
    setpoint_new: bool = False
    link_new: bool = False


class Verdict(NamedTuple):
    """The answer to a command: `result` is a MAV_RESULT, `text` says why it was refused."""

    result: int
    text: str = ""

    @property
    def accepted(self) -> bool:
        """Whether it was done."""
        return self.result == ACCEPTED


ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
"""MAV_RESULT."""
