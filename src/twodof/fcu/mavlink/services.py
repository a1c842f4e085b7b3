"""The services in front of one vehicle, put together."""

from collections.abc import Callable, Mapping

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import ControllerIdentity
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.batches import BatchService
from twodof.fcu.mavlink.clients import Clients
from twodof.fcu.mavlink.command_service import CommandService
from twodof.fcu.mavlink.encoders import TelemetryEncoders
from twodof.fcu.mavlink.message_requests import MessageRequests, MissionService, VersionService
from twodof.fcu.mavlink.parameter_service import ParameterService, TransactionService
from twodof.fcu.mavlink.service import Link, Service, VehicleAddress
from twodof.fcu.mavlink.status_text import StatusTextService
from twodof.fcu.mavlink.streams import ChangeDetector, Heartbeat, StreamService
from twodof.fcu.mavlink.vehicle_commands import ArmingCommands, ModeService, StorageCommand
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.mavlink.rates import ONBOARD


class MavlinkServices:
    """The services of one vehicle, in the order in which they get messages; made once, then `services`.

    `commands.on`, `requests.on` and `telemetry` are open to further services, such as log download.

    `restart` begins the flight controller anew (command 246). `identity` says which controller flies. `lost` counts
    what clients did not take. `truth` is the virtual rig's state.
    """

    def __init__(
        self,
        link: Link,
        system: int,
        controller: FlightController,
        commander: Commander,
        store: ParameterStore,
        restart: Callable[[], None] | None = None,
        identity: Callable[[], ControllerIdentity] = ControllerIdentity,
        lost: Callable[[], int] = lambda: 0,
        truth: Callable[[], tuple[float, float, float, float]] | None = None,
        profile: Mapping[int, float] = ONBOARD,
    ) -> None:
        us, bus = VehicleAddress(system), store.bus
        self.commands = CommandService(link, us, bus, controller.lockstep)
        self.telemetry = TelemetryEncoders(controller, commander, identity, lost, truth)
        self.requests = MessageRequests(link, self.commands, self.telemetry)
        VersionService(self.requests, system, controller.hardware.name)
        ArmingCommands(self.commands, commander, restart)
        StorageCommand(self.commands, commander, store, controller.lockstep)
        heartbeat = Heartbeat(link, bus, self.telemetry, commander)
        modes = ModeService(us, self.commands, self.requests, self.telemetry, commander)
        batches = BatchService(link, bus, commander)
        changes = ChangeDetector(controller, commander)
        parameters = ParameterService(link, us, self.commands, controller, commander, store)
        self.services: list[Service] = [  # in the order in which a server asks them
            Clients(bus, controller.lockstep),
            self.commands,
            TransactionService(link, us, self.commands, parameters),
            parameters,
            modes,
            MissionService(link, us),
            StreamService(link, bus, self.commands, self.telemetry, changes, batches, profile),
            batches,
            heartbeat,
            StatusTextService(link, bus, commander.remarks),
        ]
