"""HEARTBEAT: once a second to everybody who is connected, at each change of mode, and to a new client at once."""

from collections.abc import Hashable

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.clients import ClientJoined
from twodof.fcu.mavlink.commands.command_service import CommandHandled
from twodof.fcu.mavlink.service import Link, Service
from twodof.fcu.mavlink.telemetry.encoders import HEARTBEAT, TelemetryEncoders
from twodof.link.connection import Received

PERIOD_TICKS = 250


class Heartbeat(Service):
    """Says that the vehicle is there, also to peers that were silent so far: many clients wait for it first."""

    def __init__(self, link: Link, bus: OnboardEventBus, telemetry: TelemetryEncoders, commander: Commander) -> None:
        self._link = link
        self._telemetry = telemetry
        self._commander = commander
        self._said: tuple[int, int, int] | None = None
        bus.subscribe(ClientJoined, lambda joined: self._send(joined.client.peer))
        bus.subscribe(CommandHandled, lambda _: self._send_if_changed())

    def handle(self, received: Received) -> bool:
        """Takes other components' heartbeats, which need no answer."""
        return bool(received.message.get_type() == "HEARTBEAT")

    def after(self, step: ControlStep) -> None:
        if step.tick % PERIOD_TICKS == 0:
            self._said = None
        self._send_if_changed()

    def idle(self) -> None:
        self._send()

    def _send_if_changed(self) -> None:
        c = self._commander
        says = (c.base_mode, c.custom_mode, c.system_status)
        if says != self._said:
            self._said = says
            self._send()

    def _send(self, peer: Hashable | None = None) -> None:
        self._link.send(self._telemetry.message(HEARTBEAT), peer)
