"""The flight controller's program put together: store, commander, control loop, links and services."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import cast

from twodof.fcu.active_configuration import ActiveConfiguration
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import Hardware, VirtualHardware
from twodof.fcu.control.loop import FlightController
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.addressing import VehicleAddress
from twodof.fcu.mavlink.commands.excitation import ExcitationService
from twodof.fcu.mavlink.commands.lease import LeaseService
from twodof.fcu.mavlink.commands.lockstep import LockstepService
from twodof.fcu.mavlink.commands.reload import ReloadCommand
from twodof.fcu.mavlink.commands.setpoints import SetpointService
from twodof.fcu.mavlink.files.file_tree import FileTree
from twodof.fcu.mavlink.files.ftp import FileTransfer
from twodof.fcu.mavlink.files.log_download import LogDownload
from twodof.fcu.mavlink.files.metadata import Metadata
from twodof.fcu.mavlink.service import Service
from twodof.fcu.mavlink.services import MavlinkServices
from twodof.fcu.mavlink.status_text import StorageMonitor, TextSent
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.fcu.px4_compat.log_stream import LogStreamService
from twodof.fcu.server import Server
from twodof.link.mavlink.enums import MavSeverity
from twodof.link.mavlink.rates import ONBOARD
from twodof.link.signing import Signing
from twodof.signals import TICK_MS


class Assembly:
    """The program of a drone: MAVLink system `system` on `hardware`.

    `state` is the folder of what it keeps: parameters.json, logs/, controllers/ (uploads); None keeps nothing.
    `rates` are those of the streams that every client gets (link/mavlink/rates.py). `signing` is asked of every
    client. `fresh` begins with all parameters at their defaults and without uploads. `close` ends what runs outside
    the event loop; the server closes by itself.
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
            server,
            system,
            self.controller,
            commander,
            store,
            restart=self.controller.reset if hardware.virtual else None,
            identity=lambda: self.configuration.identity,
            lost=lambda: server.lost,
            truth=(lambda: cast(VirtualHardware, hardware).truth) if hardware.virtual else None,
            profile=rates,
        )
        self._reload = ReloadCommand(self.px4.commands, self.controller, commander, controllers, self._replaced)
        server.services += self._services(state)
        commander.unfit = self._unfit
        self._say(self.configuration.remarks)

    def _services(self, state: Path | None) -> list[Service]:
        """All, in their order: every frame is heard first, and a tick is over when all else of it was sent."""
        px4, server, commander, log = self.px4, self.server, self.commander, self.log
        us, explain, lockstep = VehicleAddress(server.system), px4.commands.explain, self.controller.lockstep
        metadata = Metadata(self.store, lambda: TICK_MS * self.controller.tick)
        px4.requests.on("COMPONENT_METADATA", metadata.message)
        uploads = None if state is None else state / "controllers"
        tree = FileTree(lambda: metadata.files, log.folder if log else None, uploads)
        streamed, downloaded = [], []
        if log is not None:
            streamed = [LogStreamService(server, us, px4.commands, log, commander.lease.take, lockstep)]
            downloaded = [LogDownload(server, us, log, commander.lease.take, explain, lockstep)]
        return [
            px4.services[0],
            LeaseService(server, us, commander, explain),
            *streamed,  # it hears every frame, and so knows whether its client is there
            *px4.services[1:],
            SetpointService(us, commander, explain),
            ExcitationService(server, us, commander, explain),
            FileTransfer(server, us, tree, commander.lease.take, explain, lockstep),
            StorageMonitor(self.store, log, commander.remarks),
            *downloaded,
            LockstepService(server, us, self.controller, commander, explain, px4.telemetry.rig),
        ]

    def close(self) -> None:
        """Writes what is not written yet. Raises ParameterError or LogError where the disk refuses; twice is once."""
        self._closing.close()

    def _replaced(self) -> None:
        """The uploaded controllers fly from the next tick on."""
        self._say(self.configuration.fly_replaced())

    def _say(self, remarks: Iterable[str]) -> None:
        self.commander.remarks.extend((MavSeverity.WARNING, text) for text in remarks)

    def _about(self) -> dict[str, str | int]:
        """What a log says of the flight."""
        hardware = self.controller.hardware
        about: dict[str, str | int] = {"rig": hardware.name, "seed": hardware.seed, "rings": int(hardware.rings)}
        return about | {"controller": self.configuration.identity.controller}

    def _unfit(self) -> str:
        """Why the controller cannot fly, before somebody arms."""
        if self._reload.building:
            return "a controller is being built"
        fault = self.controller.code.user_fault
        return f"the controller has stopped: {fault}" if fault else ""
