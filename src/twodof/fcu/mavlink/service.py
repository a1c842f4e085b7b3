"""A service: one MAVLink microservice of the flight controller, and what all of them share."""

from collections.abc import Callable, Hashable
from math import isfinite
from typing import Any, NamedTuple, Protocol

from twodof.fcu.command.command_lease import CommandResult, Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import AUTOPILOT
from twodof.signals import TICK_MS


class VehicleAddress(NamedTuple):
    """Our own address."""

    system: int
    component: int = AUTOPILOT

    def addressed(self, message: Any, everybody: bool = False) -> bool:
        """Return whether a message is for us; with `everybody`, so is a message for all systems."""
        systems = (self.system, 0) if everybody else (self.system,)
        return message.target_system in systems and message.target_component in (self.component, 0)


def source(received: Received) -> Source:
    """Return the sender."""
    return received.frame.system, received.frame.component


def target(sender: Source) -> dict[str, int]:
    """Return the fields of an answer that name its addressee."""
    return {"target_system": sender[0], "target_component": sender[1]}


def whole(value: float, default: int = 0) -> int:
    """Round a command's parameter; return `default` for NaN, infinity and values beyond 2^31."""
    return round(value) if isfinite(value) and abs(value) < 2**31 else default


RUN_OVER = 2**32
MASK_32 = RUN_OVER - 1
RUN_OVER_MS = RUN_OVER // TICK_MS
"""Ticks after which a stamp in milliseconds begins anew."""


def meant(value: int, now: int, run_over: int = RUN_OVER) -> int:
    """Return the tick that a field of 32 bits names: the one nearest to `now` that looks like `value`.

    None is before tick 0, so until the first half of the field's range has passed it is `value` itself.
    """
    nearest = now + (value - now + run_over // 2) % run_over - run_over // 2
    return nearest if nearest > 0 else value


def acts_at(tick: int, now: int) -> int:
    """Return the tick at which a message with this field acts; 0, an omitted field, is at once."""
    return meant(tick, now) if tick else 0


def acts_at_ms(time_boot_ms: int, now: int) -> int:
    """Return the tick at which a message with this stamp in milliseconds acts: the first not before it."""
    return meant(-(-time_boot_ms // TICK_MS), now, RUN_OVER_MS) if time_boot_ms else 0


Take = Callable[[Source, str], CommandResult]
"""Says whether a source may command; what it wanted is named in a refusal."""
Explain = Callable[[Hashable, str], None]
"""Tells a peer in words why something was refused."""
Refuse = Callable[[Received, CommandResult], None]
"""Tells the sender of a message without an acknowledgement, by code and in words, why it was refused."""


class Link(Protocol):
    """Where a service's messages go: `peer` is None for everybody on every link."""

    def send(self, message: Any, peer: Hashable | None = None) -> None:
        """Send a message, or drop and count it where the peer takes no more; never wait, never raise."""


class Service:
    """Translates between MAVLink and the flight controller; called from one task only.

    A service overrides what it needs of these methods; here each of them does nothing.
    """

    def handle(self, received: Received) -> bool:
        """Take a message; False leaves it to the next service. Answers go to `received.peer`.

        Any field of a message may hold any value. Never raises on them.
        """
        return False

    def after(self, step: ControlStep) -> None:
        """Act after a control period; fast when nothing is due."""

    def restart(self) -> None:
        """Restart at tick 0."""

    def gone(self, peer: Hashable) -> None:
        """Forget a peer whose link has closed."""

    def idle(self) -> None:
        """Act about once a second of real time in lockstep, while no tick runs."""
