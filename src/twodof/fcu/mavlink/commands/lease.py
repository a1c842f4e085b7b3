"""TWODOF_LEASE: asking for the lease and giving it up. And who is heard: first of the services, it sees every frame."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable

from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import CommandResult, Source
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.service import Link, Service
from twodof.link.connection import Received
from twodof.link.control_period import TICK_MS
from twodof.link.mavlink.components import NO_AUTOPILOT
from twodof.link.mavlink.messages import message

ASK, GIVE_UP = 1, 2
"""TWODOF_LEASE_ACTION."""

MOST_VEHICLES = 64

IDLE_TICKS = 250
"""In lockstep `idle` is called when time has stood still for so long: a second (`server.IDLE_S`)."""


class LeaseService(Service):
    """Tells the commander of every frame, and answers TWODOF_LEASE to who asks; the state goes out as telemetry."""

    def __init__(
        self, link: Link, us: VehicleAddress, commander: Commander, tell: Callable[[Hashable, str], None]
    ) -> None:
        self._link = link
        self._us = us
        self._commander = commander
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
        self._commander.heard(sender, sender not in self._vehicles)
        if name != "TWODOF_LEASE":
            return False
        if self._us.addressed(got):
            if got.action == ASK:
                self._answer(received, self._commander.ask_lease(sender, got.duration_ms, bool(got.tuning_withheld)))
            elif got.action == GIVE_UP:
                self._answer(received, self._commander.give_up_lease(sender))
        return True

    def idle(self) -> None:
        """Time stands still, and nobody grants any."""
        self._commander.stands(IDLE_TICKS)

    def _answer(self, received: Received, verdict: CommandResult) -> None:
        if not verdict.accepted:
            self._tell(received.peer, verdict.text)
        now = self._commander.lease
        system, component = now.holder or (0, 0)
        self._link.send(
            message(
                "TWODOF_LEASE",
                duration_ms=now.left * TICK_MS,
                holder_system=system,
                holder_component=component,
                tuning_withheld=int(self._commander.tuning_withheld),
            ),
            received.peer,
        )

    def _note(self, sender: Source, vehicle: bool) -> None:
        self._vehicles.pop(sender, None)
        if vehicle:
            self._vehicles[sender] = None
            if len(self._vehicles) > MOST_VEHICLES:
                self._vehicles.popitem(last=False)
