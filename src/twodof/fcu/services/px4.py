"""All of PX4's microservices put together in front of one vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from twodof.fcu.service import Link, Service
from twodof.fcu.services.addressing import Us
from twodof.fcu.services.arming import Arming
from twodof.fcu.services.batches import BATCH, Batches
from twodof.fcu.services.changes import Changes
from twodof.fcu.services.clients import Clients
from twodof.fcu.services.commands import Commands
from twodof.fcu.services.events import Events
from twodof.fcu.services.heartbeat import Heartbeat
from twodof.fcu.services.missions import Missions
from twodof.fcu.services.modes import Modes
from twodof.fcu.services.own_telemetry import Flown
from twodof.fcu.services.parameters import Parameters
from twodof.fcu.services.remarks import Remarks
from twodof.fcu.services.requests import Requests
from twodof.fcu.services.storage import Storage
from twodof.fcu.services.streams import Streams
from twodof.fcu.services.telemetry import Telemetry
from twodof.fcu.services.transactions import Transactions
from twodof.fcu.services.vehicle import Commander, Controller
from twodof.fcu.services.version import Versions
from twodof.fcu.store import Store
from twodof.link.mavlink.rates import ONBOARD


class PX4:
    """The services of one vehicle, in the order in which they get messages; made once, then `services`.

    `commands.on`, `requests.on` and `telemetry` are open to further services: log download, component metadata.
    `restart` begins the flight controller anew (command 246), `flown` says which controller flies, `lost` counts what
    clients did not take, `truth` is the virtual rig's state, `capabilities` are bits of MAV_PROTOCOL_CAPABILITY that
    further services bring.
    """

    def __init__(
        self,
        link: Link,
        system: int,
        controller: Controller,
        commander: Commander,
        store: Store,
        restart: Callable[[], None] | None = None,
        flown: Callable[[], Flown] = Flown,
        lost: Callable[[], int] = lambda: 0,
        truth: Callable[[], tuple[float, float, float, float]] | None = None,
        profile: Mapping[int, float] = ONBOARD,
        capabilities: int = 0,
    ) -> None:
        us = Us(system)
        self.clients = Clients(controller.lockstep)
        self.commands = Commands(link, us, controller.lockstep)
        self.telemetry = Telemetry(controller, commander, flown, lost, truth)
        self.requests = Requests(link, self.commands, self.telemetry)
        changes = Changes(controller, commander)
        self.heartbeat = Heartbeat(link, self.clients, self.telemetry, commander)
        self.commands.carried_out.append(self.heartbeat.check)
        self.modes = Modes(us, self.commands, self.requests, self.telemetry, commander)
        self.streams = Streams(link, self.clients, self.commands, self.telemetry, changes, profile)
        self.parameters = Parameters(link, us, self.clients, self.commands, controller, commander, store)
        self.arming = Arming(self.commands, commander, restart)
        self.storage = Storage(self.commands, commander, store, controller.lockstep)
        self.versions = Versions(self.requests, system, controller.hardware.name, capabilities)
        self.transactions = Transactions(link, us, self.commands, commander, self.parameters, store)
        self.batches = Batches(link, self.clients, commander)
        self.streams.elsewhere[BATCH] = self.batches
        self.events = Events(link, us, self.telemetry, controller, commander, self.clients)
        self.arming.denied.append(self.events.denied)
        self.arming.killed.append(self.events.killed)
        self.arming.asked.append(self.events.report)
        self.missions = Missions(link, us, self.commands, self.requests)
        self.remarks = Remarks(link, commander.remarks)

    @property
    def services(self) -> list[Service]:
        """In the order in which a server asks them."""
        return [
            self.clients,
            self.commands,
            self.transactions,
            self.parameters,
            self.modes,
            self.missions,
            self.events,
            self.streams,
            self.batches,
            self.heartbeat,
            self.remarks,
        ]
