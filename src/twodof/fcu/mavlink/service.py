"""A service: one MAVLink microservice of the flight controller, such as parameters or streams."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Protocol

from twodof.fcu.control.flight_code import ControlStep
from twodof.link.connection import Received


class Link(Protocol):
    """Where a service's messages go: `peer` is None for everybody on every link."""

    def send(self, message: Any, peer: Hashable | None = None) -> None:
        """Sends a message, or drops and counts it where the peer takes no more; never waits, never raises."""


class Service(Protocol):
    """Translates between MAVLink and the flight controller; called from one task only.

    It may have three methods more: `restart()`, time begins again at tick 0; `gone(peer)`, a peer's link has closed;
    `idle()`, in lockstep, about once a second of real time while no tick runs.
    """

    def handle(self, received: Received) -> bool:
        """Takes a message in; False if it is none of this service's. `received.peer` tells where answers go.

        Messages come as they come: any field may hold anything. Never raises on them.
        """

    def after(self, step: ControlStep) -> None:
        """Called after each control period; does next to nothing when nothing is due."""
