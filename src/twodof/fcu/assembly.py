"""The flight controller's program put together: store, commander, control loop, links, services and controllers."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import ControllerIdentity, Controllers, controller_identity
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import Hardware, VirtualHardware
from twodof.fcu.control.loop import FlightController, OnboardEventBus
from twodof.fcu.mavlink.batches import BatchService
from twodof.fcu.mavlink.clients import Clients, LeaseService
from twodof.fcu.mavlink.command_service import CommandService, StatusTextService, StorageMonitor
from twodof.fcu.mavlink.encoders import TelemetryEncoders
from twodof.fcu.mavlink.file_tree import FileTree, Metadata
from twodof.fcu.mavlink.ftp import FileTransfer
from twodof.fcu.mavlink.lockstep import LockstepService
from twodof.fcu.mavlink.log_download import LogDownload
from twodof.fcu.mavlink.log_stream import LogStreamService
from twodof.fcu.mavlink.message_requests import MessageRequests, MissionService, answer_versions
from twodof.fcu.mavlink.parameter_service import ParameterService, TransactionService
from twodof.fcu.mavlink.service import Service, TextSent, Vehicle
from twodof.fcu.mavlink.setpoint_service import ExcitationService, SetpointService
from twodof.fcu.mavlink.streams import Heartbeat, StreamService
from twodof.fcu.mavlink.vehicle_commands import ArmingCommands, ModeService, ReloadCommand, StorageCommand
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParametersChanged, ParameterStore
from twodof.fcu.server import Server
from twodof.link.mavlink.dialect import ONBOARD, MavSeverity
from twodof.link.signing import Signing
from twodof.signals import TICK_MS


class MavlinkServices:
    """The MAVLink services of one vehicle, in the order in which they get messages.

    Further services, such as log download, register with `commands.on`, `requests.on` and `telemetry`.

    `restart` restarts the flight controller (command 246). `identity` returns the active controller, `lost` the number
    of messages that clients did not take, `truth` the true state of a virtual rig.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        restart: Callable[[], None] | None = None,
        identity: Callable[[], ControllerIdentity] = ControllerIdentity,
        lost: Callable[[], int] = lambda: 0,
        truth: Callable[[], tuple[float, float, float, float]] | None = None,
        profile: Mapping[int, float] = ONBOARD,
    ) -> None:
        controller = vehicle.controller
        self.vehicle = vehicle
        self.commands = commands = CommandService(vehicle)
        self.telemetry = telemetry = TelemetryEncoders(controller, vehicle.commander, identity, lost, truth)
        self.requests = MessageRequests(vehicle, commands, telemetry)
        answer_versions(self.requests, vehicle.address[0], controller.hardware.name)
        ArmingCommands(vehicle, commands, restart)
        StorageCommand(vehicle, commands)
        heartbeat = Heartbeat(vehicle, telemetry)
        modes = ModeService(vehicle, commands, self.requests, telemetry)
        batches = BatchService(vehicle)
        parameters = ParameterService(vehicle)
        self.services: list[Service] = [  # in the order in which a server asks them
            Clients(vehicle),
            commands,
            TransactionService(vehicle, parameters),
            parameters,
            modes,
            MissionService(vehicle),
            StreamService(vehicle, commands, telemetry, batches, profile),
            batches,
            heartbeat,
            StatusTextService(vehicle),
        ]


class ActiveConfiguration:
    """The flight code that flies, built from `controllers`, with its parameters kept at the values of `store`.

    `remarks` says what of the stored values could not be used. `fresh` starts without uploads and with all defaults.
    """

    def __init__(self, controllers: Controllers, store: ParameterStore, fresh: bool = False) -> None:
        """Build the flight code. Raises as `Controllers.build`, and DiagramError if uploads cannot be deleted."""
        if fresh:
            controllers.forget()
        self.code, damage = controllers.build()
        self._store = store
        tuned = store.carry(self.code.user_parameters)
        if fresh:
            tuned = ()
            store.reset()
        self._values = store.flying() | store.user_values()
        self.code.set_parameters(self._values)
        self.remarks = [text for text in (damage, *store.remarks, *tuned, *self._hidden()) if text]
        self._named = (self.code, controller_identity(self.code))
        self._counted = (-1, 0)  # a revision of the store, and how many parameters differ from their defaults in it

    def attach(self, controller: FlightController) -> None:
        """Apply each change of the store to the flight code of `controller` before its next tick."""
        self._controller = controller
        self._store.bus.subscribe(ParametersChanged, self._fly_changes)

    def fly_replaced(self) -> list[str]:
        """List the parameters of the users' controllers in a new flight code; return remarks for the clients."""
        self.code = self._controller.code
        remarks = self._store.carry(self.code.user_parameters)
        own = self._store.user_values()
        self._values = self._store.flying() | own
        self.code.set_parameters(own)
        return [*remarks, *self._hidden()]

    @property
    def identity(self) -> ControllerIdentity:
        """Return the active controller, and the number of parameters that differ from their defaults."""
        code = self._controller.code
        if self._named[0] is not code:
            self._named = (code, controller_identity(code))
        if self._counted[0] != self._store.revision:  # a client may have TWODOF_RIG sent in every control period
            self._counted = (self._store.revision, len(self._store.changed()))
        return self._named[1]._replace(changed=self._counted[1])

    def _fly_changes(self, _: ParametersChanged) -> None:
        values: dict[str, Any] = self._store.flying() | self._store.user_values()
        changed = {name: value for name, value in values.items() if value != self._values[name]}
        self._values = values
        if changed:
            self._controller.code.set_parameters(changed)

    def _hidden(self) -> list[str]:
        """Return remarks on parameters of the users' controllers that are not in the list."""
        return [one.remark for one in self.code.user_parameters if one.remark]


class Assembly:
    """The program of a drone: MAVLink system `system` on `hardware`.

    `state` is the folder for parameters.json, logs/ and controllers/ (uploads); None keeps nothing. `rates` are those
    of the streams that every client gets (link/mavlink/dialect.py). `signing` is required of every client. `fresh`
    starts with all parameters at their defaults and without uploads. `close` ends the parts that run outside the event
    loop; the server closes by itself.
    """

    def __init__(
        self,
        hardware: Hardware,
        controllers: Controllers,
        system: int,
        lockstep: bool = False,
        signing: Signing | None = None,
        state: Path | None = None,
        rates: Mapping[int, float] = ONBOARD,
        fresh: bool = False,
    ) -> None:
        bus = OnboardEventBus()
        self.store = store = ParameterStore(None if state is None else state / "parameters.json", system, bus=bus)
        self.configuration = ActiveConfiguration(controllers, store, fresh)
        self.commander = commander = Commander(hardware, lambda: store["THRUST_BAR"], lockstep)
        self.controller = FlightController(hardware, self.configuration.code, commander, lockstep, bus)
        self.controller.remarks = commander.remarks
        self.configuration.attach(self.controller)
        self.server = server = Server(self.controller, system, signing, pilot=lambda: commander.lease.holder)
        self._closing = ExitStack()
        self._closing.callback(store.close)
        self.log: OnboardLogger | None = None
        if state is not None:
            self.log = OnboardLogger(state / "logs", store, lockstep, self._about)
            self._closing.callback(self.log.close)
            note = self.log.remark
            bus.subscribe(ControlStep, self.log.step)
            bus.subscribe(TextSent, lambda sent: note(*sent))
        self.px4 = MavlinkServices(
            Vehicle(server, system, self.controller, commander, store),
            restart=self.controller.reset if hardware.virtual else None,
            identity=lambda: self.configuration.identity,
            lost=lambda: server.lost,
            truth=(lambda: cast(VirtualHardware, hardware).truth) if hardware.virtual else None,
            profile=rates,
        )
        self._reload = ReloadCommand(self.px4.vehicle, self.px4.commands, controllers, self._replaced)
        server.services += self._services(state)
        commander.unfit = self._unfit
        self._say(self.configuration.remarks)

    def _services(self, state: Path | None) -> list[Service]:
        """Return all services in their order: the lease hears every frame, lockstep ends a tick last."""
        px4, vehicle, log = self.px4, self.px4.vehicle, self.log
        metadata = Metadata(self.store, lambda: TICK_MS * self.controller.tick)
        px4.requests.on("COMPONENT_METADATA", metadata.message)
        tree = FileTree(lambda: metadata.files, None if state is None else state / "controllers")
        return [
            px4.services[0],
            LeaseService(vehicle),
            # It hears every frame, and so knows whether its client is there.
            *([] if log is None else [LogStreamService(vehicle, px4.commands, log)]),
            *px4.services[1:],
            SetpointService(vehicle),
            ExcitationService(vehicle),
            FileTransfer(vehicle, tree),
            StorageMonitor(vehicle, log),
            *([] if log is None else [LogDownload(vehicle, log)]),
            LockstepService(vehicle, px4.telemetry.rig),
        ]

    def close(self) -> None:
        """Write parameters and log to the disk, and end. Raises ParameterError or LogError if the disk refuses."""
        self._closing.close()

    def _replaced(self) -> None:
        """List the parameters of the uploaded controllers, which fly from the next tick on."""
        self._say(self.configuration.fly_replaced())

    def _say(self, remarks: Iterable[str]) -> None:
        self.commander.remarks.extend((MavSeverity.WARNING, text) for text in remarks)

    def _about(self) -> dict[str, str | int]:
        """Return the facts of the flight for a log."""
        hardware = self.controller.hardware
        about: dict[str, str | int] = {"rig": hardware.name, "seed": hardware.seed, "rings": int(hardware.rings)}
        return about | {"controller": self.configuration.identity.controller}

    def _unfit(self) -> str:
        """Return why the controller cannot fly, "" if it can."""
        if self._reload.building:
            return "a controller is being built"
        fault = self.controller.code.user_fault
        return f"the controller has stopped: {fault}" if fault else ""
