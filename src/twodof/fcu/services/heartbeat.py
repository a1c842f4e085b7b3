"""HEARTBEAT: once a second to everybody who is connected, at each change of mode, and to a new client at once."""

from __future__ import annotations

from typing import Any

from twodof.fcu.flight_code import Step
from twodof.fcu.service import Link
from twodof.fcu.services.addressing import Client
from twodof.fcu.services.clients import Clients
from twodof.fcu.services.telemetry import HEARTBEAT, Telemetry
from twodof.fcu.services.vehicle import Commander
from twodof.link.connection import Received

PERIOD_TICKS = 250


class Heartbeat:
    """Says that we are there, also to those who have not spoken yet: many clients wait for it first."""

    def __init__(self, link: Link, clients: Clients, telemetry: Telemetry, commander: Commander) -> None:
        self._link = link
        self._telemetry = telemetry
        self._commander = commander
        self._said: tuple[int, int, int] | None = None
        clients.joined.append(self._greet)

    def handle(self, received: Received) -> bool:
        """Other components' heartbeats need no answer."""
        return bool(received.message.get_type() == "HEARTBEAT")

    def after(self, step: Step) -> None:
        """Sends it when it is due or says something new."""
        if step.tick % PERIOD_TICKS == 0:
            self._said = None
        self.check()

    def check(self) -> None:
        """Sends it if it says something new."""
        c = self._commander
        says = (c.base_mode, c.custom_mode, c.system_status)
        if says != self._said:
            self._said = says
            self._link.send(self._beat())

    def idle(self) -> None:
        """Called about once a second of real time while simulated time stands still."""
        self._link.send(self._beat())

    def _greet(self, client: Client) -> None:
        self._link.send(self._beat(), client.peer)

    def _beat(self) -> Any:
        return self._telemetry.standing[HEARTBEAT]()
