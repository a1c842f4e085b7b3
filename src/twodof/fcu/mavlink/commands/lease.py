"""TWODOF_LEASE: asking for the lease and giving it up. And who is heard: first of the services, it sees every frame."""

from collections import OrderedDict

from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import CommandResult, Source
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.service import Explain, Link, Service
from twodof.link.connection import Received
from twodof.link.mavlink.enums import NO_AUTOPILOT
from twodof.link.mavlink.messages import message
from twodof.signals import TICK_MS

ASK, GIVE_UP = 1, 2
"""TWODOF_LEASE_ACTION."""

MOST_VEHICLES = 64

IDLE_TICKS = 250
"""In lockstep `idle` is called when time has stood still for so long: a second (`server.IDLE_S`)."""


class LeaseService(Service):
    """Tells the commander of every frame, and answers TWODOF_LEASE to who asks; the state goes out as telemetry."""

    def __init__(self, link: Link, us: VehicleAddress, commander: Commander, tell: Explain) -> None:
        self._link = link
        self._us = us
        self._lease = commander.lease
        self._tell = tell
        self._vehicles: OrderedDict[Source, None] = OrderedDict()

    def handle(self, received: Received) -> bool:
        """Notes who was heard; takes TWODOF_LEASE."""
        sender, got = source(received), received.message
        if sender == tuple(self._us):
            return False  # our own, come round
        name = got.get_type()
        if name == "HEARTBEAT":
            self._note(sender, vehicle=got.autopilot != NO_AUTOPILOT)
        self._lease.hear(sender, sender not in self._vehicles)
        if name != "TWODOF_LEASE":
            return False
        if self._us.addressed(got):
            if got.action == ASK:
                self._answer(received, self._lease.ask(sender, got.duration_ms, bool(got.tuning_withheld)))
            elif got.action == GIVE_UP:
                self._answer(received, self._lease.give_up(sender))
        return True

    def idle(self) -> None:
        self._lease.stands(IDLE_TICKS)

    def _answer(self, received: Received, result: CommandResult) -> None:
        if not result.accepted:
            self._tell(received.peer, result.text)
        system, component = self._lease.holder or (0, 0)
        self._link.send(
            message(
                "TWODOF_LEASE",
                duration_ms=self._lease.left * TICK_MS,
                holder_system=system,
                holder_component=component,
                tuning_withheld=int(self._lease.tuning_withheld),
            ),
            received.peer,
        )

    def _note(self, sender: Source, vehicle: bool) -> None:
        self._vehicles.pop(sender, None)
        if vehicle:
            self._vehicles[sender] = None
            if len(self._vehicles) > MOST_VEHICLES:
                self._vehicles.popitem(last=False)
