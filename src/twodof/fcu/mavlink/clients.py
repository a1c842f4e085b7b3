"""Clients: the peers that have sent a message, and their lease."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import NamedTuple

from twodof.fcu.command.command_lease import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.service import Service, Vehicle, source
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import FIRST_OWN_ID, LAST_OWN_ID, NO_AUTOPILOT, MavCmd
from twodof.link.mavlink.messages import message
from twodof.signals import TICK_MS

SILENT_TICKS = 15_000
"""Ticks without a frame after which a client is forgotten: 60 s."""
MOST_CLIENTS = 64
_SWEEP_TICKS = 250
_ABOUT_MESSAGES = (MavCmd.GET_MESSAGE_INTERVAL, MavCmd.SET_MESSAGE_INTERVAL, MavCmd.REQUEST_MESSAGE)


class ClientJoined(NamedTuple):
    """Event: a peer has sent its first message."""

    peer: Hashable


class ClientRecognised(NamedTuple):
    """Event: a client has sent or requested a twodof message. To others they would count as losses."""

    peer: Hashable


class ClientLeft(NamedTuple):
    """Event: a client's link has closed, or the client was silent for too long."""

    peer: Hashable


class Clients(Service):
    """List of the connected clients. First among the services: it sees every message and consumes none.

    It publishes ClientJoined, ClientRecognised and ClientLeft. In lockstep silent clients are not forgotten, as a
    minute of the drone's time may pass between two heartbeats of a bystander.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._heard: dict[Hashable, int] = {}  # the tick at which each peer spoke last
        self._tick = 0

    def handle(self, received: Received) -> bool:
        peer, vehicle = received.peer, self._vehicle
        if peer not in self._heard:
            if len(self._heard) >= MOST_CLIENTS:
                self.gone(min(self._heard, key=self._heard.__getitem__))
            vehicle.bus.publish(ClientJoined(peer))
        self._heard[peer] = self._tick
        if peer not in vehicle.know_ours and _knows(received):
            vehicle.know_ours.add(peer)
            vehicle.bus.publish(ClientRecognised(peer))
        return False

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick
        if step.tick % _SWEEP_TICKS == 0 and not self._vehicle.lockstep:
            for peer, heard in [*self._heard.items()]:
                if step.tick - heard > SILENT_TICKS:
                    self.gone(peer)

    def gone(self, peer: Hashable) -> None:
        if self._heard.pop(peer, None) is not None:
            self._vehicle.know_ours.discard(peer)
            self._vehicle.bus.publish(ClientLeft(peer))

    def restart(self) -> None:
        self._tick = 0
        self._heard = dict.fromkeys(self._heard, 0)


def _knows(received: Received) -> bool:
    """Return whether a message shows that its sender knows twodof's own messages."""
    number, got = received.frame.message_id, received.message
    if got.get_type() in ("COMMAND_LONG", "COMMAND_INT"):
        return got.command in _ABOUT_MESSAGES and FIRST_OWN_ID <= got.param1 <= LAST_OWN_ID
    return FIRST_OWN_ID <= number <= LAST_OWN_ID


ASK, GIVE_UP = 1, 2
"""TWODOF_LEASE_ACTION."""

MOST_VEHICLES = 64

IDLE_TICKS = 250
"""Time that has stood still when `idle` is called in lockstep [ticks]: a second (`server.IDLE_S`)."""


class LeaseService(Service):
    """Service that reports every frame to the lease and carries out TWODOF_LEASE; telemetry has the lease's state."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, {"TWODOF_LEASE": self._act})
        self._lease = vehicle.commander.lease
        self._vehicles: OrderedDict[Source, None] = OrderedDict()

    def handle(self, received: Received) -> bool:
        """Note the sender; consume TWODOF_LEASE."""
        sender, got = source(received), received.message
        if sender == self._vehicle.address:
            return False  # our own, come round
        if got.get_type() == "HEARTBEAT":
            self._vehicles.pop(sender, None)
            if got.autopilot != NO_AUTOPILOT:
                self._vehicles[sender] = None
                if len(self._vehicles) > MOST_VEHICLES:
                    self._vehicles.popitem(last=False)
        self._lease.note_frame(sender, sender not in self._vehicles)
        return super().handle(received)

    def idle(self) -> None:
        self._lease.note_standstill(IDLE_TICKS)

    def _act(self, received: Received) -> None:
        got, sender, lease = received.message, source(received), self._lease
        if got.action == ASK:
            result = lease.request(sender, got.duration_ms, bool(got.tuning_withheld))
        elif got.action == GIVE_UP:
            result = lease.give_up(sender)
        else:
            return
        if not result.accepted:
            self._vehicle.refuse(received, result)
        system, component = lease.holder or (0, 0)
        holder = {"holder_system": system, "holder_component": component, "tuning_withheld": int(lease.tuning_withheld)}
        self._vehicle.send(message("TWODOF_LEASE", duration_ms=lease.left * TICK_MS, **holder), received.peer)
