"""The flight controller's program put together: commander, control loop, links and services."""

from __future__ import annotations

from twodof.fcu.commander import Commander
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
    commander = Commander(hardware, lambda: float(controller.code.parameter("THRUST_BAR")), lockstep)
    controller = FlightController(hardware, code, commander, lockstep)
    server = Server(controller, system, signing)
    server.services.append(Heartbeat(server))
    controller.on_restart += [service.restarted for service in server.services if hasattr(service, "restarted")]
    return controller, server


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
