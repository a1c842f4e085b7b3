"""Clients: the peers that have spoken. Each gets its own streams, until it is silent or its link closes."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.service import Service
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import FIRST_OWN_ID, LAST_OWN_ID
from twodof.link.mavlink.enums import MavCmd

SILENT_TICKS = 15_000
"""60 s without a frame: a client is forgotten."""
MOST_CLIENTS = 64
_SWEEP_TICKS = 250
_ABOUT_MESSAGES = (MavCmd.GET_MESSAGE_INTERVAL, MavCmd.SET_MESSAGE_INTERVAL, MavCmd.REQUEST_MESSAGE)


@dataclass(slots=True)
class ConnectedClient:
    """A peer that has spoken, and the tick at which it did so last; `ours`: it knows twodof's own messages."""

    peer: Hashable
    heard: int
    ours: bool = False


class ClientJoined(NamedTuple):
    """A peer has spoken for the first time."""

    client: ConnectedClient


class ClientRecognised(NamedTuple):
    """A client has sent a message of twodof's own, or asked for one. Others would count these messages as lost."""

    client: ConnectedClient


class ClientLeft(NamedTuple):
    """A client's link has closed, or it was silent for too long."""

    client: ConnectedClient


class Clients(Service):
    """Who is there. First among the services: it sees every message and takes none.

    It publishes ClientJoined, ClientRecognised and ClientLeft. In `lockstep` nobody is forgotten for silence, as a
    minute may pass between two heartbeats of a bystander.
    """

    def __init__(self, bus: OnboardEventBus, lockstep: bool = False) -> None:
        self._bus = bus
        self._lockstep = lockstep
        self.known: dict[Hashable, ConnectedClient] = {}
        self._tick = 0

    def handle(self, received: Received) -> bool:
        client = self.known.get(received.peer)
        if client is None:
            client = self._welcome(received.peer)
        client.heard = self._tick
        if not client.ours and _knows(received):
            client.ours = True
            self._bus.publish(ClientRecognised(client))
        return False

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick
        if step.tick % _SWEEP_TICKS == 0 and not self._lockstep:
            for client in [*self.known.values()]:
                if step.tick - client.heard > SILENT_TICKS:
                    self.gone(client.peer)

    def gone(self, peer: Hashable) -> None:
        client = self.known.pop(peer, None)
        if client is not None:
            self._bus.publish(ClientLeft(client))

    def restart(self) -> None:
        self._tick = 0
        for client in self.known.values():
            client.heard = 0

    def _welcome(self, peer: Hashable) -> ConnectedClient:
        if len(self.known) >= MOST_CLIENTS:
            self.gone(min(self.known.values(), key=lambda one: one.heard).peer)
        client = self.known[peer] = ConnectedClient(peer, self._tick)
        self._bus.publish(ClientJoined(client))
        return client


def _knows(received: Received) -> bool:
    """Whether a message shows that its sender knows twodof's own."""
    number, got = received.frame.message_id, received.message
    if got.get_type() in ("COMMAND_LONG", "COMMAND_INT"):
        return got.command in _ABOUT_MESSAGES and FIRST_OWN_ID <= got.param1 <= LAST_OWN_ID
    return FIRST_OWN_ID <= number <= LAST_OWN_ID
