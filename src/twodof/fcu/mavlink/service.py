"""A service: one MAVLink microservice of the flight controller, such as parameters or streams."""

from collections.abc import Callable, Hashable
from typing import Any, Protocol

from twodof.fcu.command.result import CommandResult, Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.link.connection import Received

Take = Callable[[Source, str], CommandResult]
"""Says whether a source may command; what it wanted is named in a refusal."""
Explain = Callable[[Hashable, str], None]
"""Tells a peer in words why something was refused."""


class Link(Protocol):
    """Where a service's messages go: `peer` is None for everybody on every link."""

    def send(self, message: Any, peer: Hashable | None = None) -> None:
        """Sends a message, or drops and counts it where the peer takes no more; never waits, never raises."""


class Service:
    """Translates between MAVLink and the flight controller; called from one task only.

    A service overrides what it needs of these methods; here each of them does nothing.
    """

    def handle(self, received: Received) -> bool:
        """Takes a message in; False leaves it to the next service. `received.peer` tells where answers go.

        Any field of a message may hold any value. Never raises on them.
        """
        return False

    def after(self, step: ControlStep) -> None:
        """Called after each control period; does next to nothing when nothing is due."""

    def restart(self) -> None:
        """Time begins again at tick 0."""

    def gone(self, peer: Hashable) -> None:
        """A peer's link has closed."""

    def idle(self) -> None:
        """In lockstep, called about once a second of real time while no tick runs."""
