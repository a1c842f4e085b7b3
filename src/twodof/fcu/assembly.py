"""The flight controller's program put together: commander, control loop, links and services."""

from __future__ import annotations

from twodof.fcu.asked import Asked
from twodof.fcu.flight_code import FlightCode, Step
from twodof.fcu.hardware import Hardware
from twodof.fcu.loop import FlightController
from twodof.fcu.server import Server
from twodof.link.connection import Received
from twodof.link.messages import message
from twodof.link.signing import Signing

HEARTBEAT_TICKS = 250


def assemble(
    hardware: Hardware, code: FlightCode, system: int, lockstep: bool = False, signing: Signing | None = None
) -> tuple[FlightController, Server]:
    """The control loop on `hardware` and its shell as MAVLink system `system`, with every service."""
    controller = FlightController(hardware, code, Nobody(), lockstep)
    server = Server(controller, system, signing)
    server.services.append(Heartbeat(server))
    return controller, server


class Nobody:
    """A commander that asks for nothing."""

    def asked(self, tick: int) -> Asked:
        """Nothing."""
        return Asked()

    def seen(self, step: Step) -> None:
        """Nothing comes of it."""

    def restart(self) -> None:
        """Nothing begins again."""


class Heartbeat:
    """HEARTBEAT at 1 Hz."""

    def __init__(self, link: Server) -> None:
        self._link = link

    def handle(self, received: Received) -> bool:
        """Takes nothing."""
        return False

    def after(self, step: Step) -> None:
        """Sends when it is time."""
        if step.tick % HEARTBEAT_TICKS == 0:
            self._link.send(
                message("HEARTBEAT", type=2, autopilot=12, base_mode=81, system_status=3, mavlink_version=3)
            )
