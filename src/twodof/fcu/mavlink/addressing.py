"""Who a message is for, who sent it, and numbers of messages made safe to use."""

from math import isfinite
from typing import Any, NamedTuple

from twodof.fcu.command.result import Source
from twodof.link.connection import Received
from twodof.link.mavlink.enums import AUTOPILOT


class VehicleAddress(NamedTuple):
    """Our own address."""

    system: int
    component: int = AUTOPILOT

    def addressed(self, message: Any, everybody: bool = False) -> bool:
        """Whether a message with a target is for us; `everybody`: one for all systems is for us too."""
        systems = (self.system, 0) if everybody else (self.system,)
        return message.target_system in systems and message.target_component in (self.component, 0)


def source(received: Received) -> Source:
    """Who sent it."""
    return received.frame.system, received.frame.component


def target(sender: Source) -> dict[str, int]:
    """The fields of an answer that name who asked."""
    return {"target_system": sender[0], "target_component": sender[1]}


def whole(value: float, default: int = 0) -> int:
    """The nearest whole number of a command's parameter; `default` for NaN, infinity and what exceeds 2^31."""
    return round(value) if isfinite(value) and abs(value) < 2**31 else default
