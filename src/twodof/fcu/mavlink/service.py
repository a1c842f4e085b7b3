"""Base of the flight controller's MAVLink services, and the vehicle that they share."""

from collections.abc import Callable, Hashable, Mapping
from math import isfinite
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from twodof.fcu.command.command_lease import CommandResult, Source
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import AUTOPILOT, MavSeverity
from twodof.link.mavlink.messages import message, statustext
from twodof.signals import TICK_MS


def source(received: Received) -> Source:
    """Return the sender of a message: MAVLink system and component."""
    return received.frame.system, received.frame.component


def target(sender: Source) -> dict[str, int]:
    """Return the target fields of an answer to `sender`."""
    return {"target_system": sender[0], "target_component": sender[1]}


def whole(value: float, default: int = 0) -> int:
    """Round a command's parameter; return `default` for NaN, infinity and values beyond 2^31."""
    return round(value) if isfinite(value) and abs(value) < 2**31 else default


RUN_OVER = 2**32
MASK_32 = RUN_OVER - 1
RUN_OVER_MS = RUN_OVER // TICK_MS
"""Ticks after which a 32-bit stamp in milliseconds wraps."""


def unwrap(value: int, now: int, run_over: int = RUN_OVER) -> int:
    """Return the tick nearest to `now` that a wrapped field of 32 bits with `value` can stand for.

    No tick is before 0, so in the first half of the field's range it is `value` itself.
    """
    nearest = now + (value - now + run_over // 2) % run_over - run_over // 2
    return nearest if nearest > 0 else value


def acts_at(tick: int, now: int) -> int:
    """Return the tick at which a message with this `tick` field acts; 0, an omitted field, stands for at once."""
    return unwrap(tick, now) if tick else 0


def acts_at_ms(time_boot_ms: int, now: int) -> int:
    """Return the tick at which a message with this stamp in milliseconds acts: the first not before it."""
    return unwrap(-(-time_boot_ms // TICK_MS), now, RUN_OVER_MS) if time_boot_ms else 0


class TextSent(NamedTuple):
    """Event: the vehicle has sent a text, with its MAV_SEVERITY."""

    severity: int
    text: str


class Link(Protocol):
    """Link for the messages of a service; the peer None stands for all clients on all links."""

    def send(self, message: Any, peer: Hashable | None = None) -> None:
        """Send a message, or drop and count it where the peer takes no more; never wait, never raise."""


class Vehicle:
    """The vehicle of all services: its address, control loop, commander and parameters, and the link to its clients.

    `know_ours` are the peers that know twodof's own messages. `refused` counts the refusals. It publishes TextSent for
    each text.
    """

    def __init__(
        self, link: Link, system: int, controller: FlightController, commander: Commander, store: ParameterStore
    ) -> None:
        self.address = system, AUTOPILOT
        self.send = link.send
        self.controller = controller
        self.commander = commander
        self.store = store
        self.bus = store.bus
        self.take = commander.lease.take
        self.lockstep = controller.lockstep
        self.know_ours: set[Hashable] = set()
        self.refused = 0

    def addressed(self, message: Any, everybody: bool = False) -> bool:
        """Return whether a message is for this vehicle or, with `everybody`, for all systems."""
        system = message.target if message.get_type() == "MANUAL_CONTROL" else message.target_system
        component = getattr(message, "target_component", 0)
        return (system == self.address[0] or (everybody and not system)) and component in (self.address[1], 0)

    def refuse(self, received: Received, result: CommandResult) -> None:
        """Send the reason for a refusal, as code and text, for messages without an acknowledgement of their own."""
        if received.peer in self.know_ours:
            code = {"message_id": received.frame.message_id, "reason": result.reason}
            self.send(message("TWODOF_REFUSED", **code, **target(source(received))), received.peer)
        self.explain(received.peer, result.text)

    def explain(self, peer: Hashable, why: str, severity: MavSeverity = MavSeverity.WARNING) -> None:
        """Count a refusal and send its reason to a peer as text."""
        self.refused += 1
        if why:
            self.say(why, severity, self.refused, peer)

    def say(self, text: str, severity: int, number: int, peer: Hashable | None = None) -> None:
        """Send a text as STATUSTEXT, a long one in pieces under `number`; the peer None stands for all clients."""
        self.bus.publish(TextSent(severity, text))
        for piece in statustext(text, severity, number % 0xFFFF + 1):
            self.send(piece, peer)


class Service:
    """Service between MAVLink and the flight controller; called from one task only.

    `takes` has a function for each message that the service consumes, None for one that needs no answer. The function
    is called if the message is for this vehicle or, with `everybody`, for all. A message with this vehicle's own id as
    sender has come back over a loop of links and is ignored.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        takes: Mapping[str, Callable[[Received], object] | None] = MappingProxyType({}),
        everybody: bool = False,
    ) -> None:
        self._vehicle = vehicle
        self._takes = takes
        self._everybody = everybody

    def handle(self, received: Received) -> bool:
        """Handle a message; return False to leave it to the next service. Answers go to `received.peer`.

        Any field of a message may hold any value; none of them may raise an exception.
        """
        got, vehicle = received.message, self._vehicle
        name = got.get_type()
        take = self._takes.get(name)
        if take is not None and source(received) != vehicle.address and vehicle.addressed(got, self._everybody):
            take(received)
        return name in self._takes

    def after(self, step: ControlStep) -> None:
        """Act after a control period; quick when nothing is due."""

    def restart(self) -> None:
        """Restart at tick 0."""

    def gone(self, peer: Hashable) -> None:
        """Forget a peer whose link has closed."""

    def idle(self) -> None:
        """Act about once a second of real time in lockstep, while no tick runs."""
