"""HEARTBEAT: once a second to everybody who is connected, at each change of mode, and to a new client at once."""

from __future__ import annotations

from typing import Any

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.addressing import ConnectedClient
from twodof.fcu.mavlink.clients import Clients
from twodof.fcu.mavlink.service import Link
from twodof.fcu.mavlink.telemetry.encoders import HEARTBEAT, TelemetryEncoders
from twodof.fcu.mavlink.vehicle import CommanderView
from twodof.link.connection import Received

PERIOD_TICKS = 250


class Heartbeat:
    """Says that we are there, also to those who have not spoken yet: many clients wait for it first."""

    def __init__(self, link: Link, clients: Clients, telemetry: TelemetryEncoders, commander: CommanderView) -> None:
        self._link = link
        self._telemetry = telemetry
        self._commander = commander
        self._said: tuple[int, int, int] | None = None
        clients.joined.append(self._greet)

    def handle(self, received: Received) -> bool:
        """Other components' heartbeats need no answer."""
        return bool(received.message.get_type() == "HEARTBEAT")

    def after(self, step: ControlStep) -> None:
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

    def _greet(self, client: ConnectedClient) -> None:
        self._link.send(self._beat(), client.peer)

    def _beat(self) -> Any:
        return self._telemetry.standing[HEARTBEAT]()
