"""The flight controller's program put together: store, commander, control loop, links, services and controllers."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import cast

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.flight_code import ControllerIdentity, ControlStep
from twodof.fcu.control.hardware import Hardware, VirtualHardware
from twodof.fcu.control.loop import FlightController, OnboardEventBus
from twodof.fcu.mavlink.clients import Clients, LeaseService
from twodof.fcu.mavlink.command_service import CommandService, StatusTextService, StorageMonitor
from twodof.fcu.mavlink.encoders import TelemetryEncoders
from twodof.fcu.mavlink.file_tree import FileTree, Metadata
from twodof.fcu.mavlink.ftp import FileTransfer
from twodof.fcu.mavlink.lockstep import LockstepService
from twodof.fcu.mavlink.log_transfer import LogDownload, LogStreamService
from twodof.fcu.mavlink.message_requests import MessageRequests, MissionService, answer_versions
from twodof.fcu.mavlink.parameter_service import ParameterService, TransactionService
from twodof.fcu.mavlink.service import Service, TextSent, Vehicle
from twodof.fcu.mavlink.setpoint_service import ExcitationService, SetpointService
from twodof.fcu.mavlink.streams import BatchService, Heartbeat, StreamService
from twodof.fcu.mavlink.vehicle_commands import ArmingCommands, ModeService, ReloadCommand, StorageCommand
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParametersChanged, ParameterStore
from twodof.fcu.server import Server
from twodof.link.mavlink.dialect import ONBOARD, MavSeverity
from twodof.link.signing import Signing
from twodof.signals import TICK_MS


class MavlinkServices:
    """The MAVLink services of one vehicle: `services` get messages in this order.

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
        parameters, batches = ParameterService(vehicle), BatchService(vehicle)
        self.services: list[Service] = [
            Clients(vehicle),
            commands,
            TransactionService(vehicle, parameters),
            parameters,
            ModeService(vehicle, commands, self.requests, telemetry),
            MissionService(vehicle),
            StreamService(vehicle, commands, telemetry, batches, profile),
            batches,
            Heartbeat(vehicle, telemetry),
            StatusTextService(vehicle),
        ]


class Assembly:
    """The program of a drone: MAVLink system `system` on `hardware`.

    `state` is the folder for parameters.json, logs/ and controllers/ (uploads); None keeps nothing. `rates` are those
    of the streams that every client gets (link/mavlink/dialect.py). `signing` is required of every client. `fresh`
    starts with all parameters at their defaults and without uploads; `defaults` are this drone's own, by path. `close`
    ends the parts that run outside the event loop; the server closes by itself.

    Raises as `Controllers.build`, and DiagramError if uploads cannot be deleted.
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
        defaults: Mapping[str, float] | None = None,
    ) -> None:
        bus = OnboardEventBus()
        path = None if state is None else state / "parameters.json"
        self.store = store = ParameterStore(path, system, bus=bus, defaults=defaults)
        if fresh:
            controllers.forget()
        code, damage = controllers.build()
        tuned = store.carry(code.user_parameters)
        if fresh:
            tuned = ()
            store.reset()
        self._values = store.values_by_path()
        code.set_parameters(self._values)
        self.commander = commander = Commander(hardware, lambda: store["THRUST_BAR"], lockstep)
        self.controller = FlightController(hardware, code, commander, lockstep, bus)
        self.controller.remarks = commander.remarks
        bus.subscribe(ParametersChanged, self._fly_changes)
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
            identity=lambda: self.flown,
            lost=lambda: server.lost,
            truth=(lambda: cast(VirtualHardware, hardware).truth) if hardware.virtual else None,
            profile=rates,
        )
        self._reload = ReloadCommand(self.px4.vehicle, self.px4.commands, controllers, self._replaced)
        server.services += self._services(state)
        commander.unfit = self._unfit
        self._say((damage, *store.remarks, *tuned))

    @property
    def flown(self) -> ControllerIdentity:
        """Identity of the controller that flies, and the number of parameters that differ from their defaults."""
        return self.controller.code.identity._replace(changed=len(self.store.changed()))

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

    def _fly_changes(self, _: ParametersChanged) -> None:
        """Apply changed parameters before the next tick."""
        values = self.store.values_by_path()
        changed = {name: value for name, value in values.items() if value != self._values[name]}
        self._values = values
        if changed:
            self.controller.code.set_parameters(changed)

    def _replaced(self) -> None:
        """List the parameters of the uploaded controllers, which fly from the next tick on."""
        code = self.controller.code
        remarks = self.store.carry(code.user_parameters)
        self._values = self.store.values_by_path()
        code.set_parameters(self.store.user_values())
        self._say(remarks)

    def _say(self, remarks: Iterable[str]) -> None:
        """Tell the clients `remarks`, and which parameters of the users' controllers are not in the list."""
        hidden = (one.remark for one in self.controller.code.user_parameters)
        self.commander.remarks.extend((MavSeverity.WARNING, text) for text in (*remarks, *hidden) if text)

    def _about(self) -> dict[str, str | int]:
        """Return the facts of the flight for a log."""
        hardware = self.controller.hardware
        about: dict[str, str | int] = {"rig": hardware.name, "seed": hardware.seed, "rings": int(hardware.rings)}
        return about | {"controller": self.flown.controller}

    def _unfit(self) -> str:
        """Return why the controller cannot fly, "" if it can."""
        if self._reload.building:
            return "a controller is being built"
        fault = self.controller.code.user_fault
        return f"the controller has stopped: {fault}" if fault else ""
