"""The flight controller's program put together: store, commander, control loop, links and services."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import Controllers, controller_identity
from twodof.fcu.control.hardware import Hardware, VirtualHardware
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.addressing import VehicleAddress
from twodof.fcu.mavlink.commands.excitation import ExcitationService
from twodof.fcu.mavlink.commands.lease import LeaseService
from twodof.fcu.mavlink.commands.lockstep import LockstepService
from twodof.fcu.mavlink.commands.reload import ReloadCommand
from twodof.fcu.mavlink.commands.setpoints import SetpointService
from twodof.fcu.mavlink.files.file_tree import FileTree
from twodof.fcu.mavlink.files.ftp import FTP_CAPABILITY, FileTransfer
from twodof.fcu.mavlink.files.log_download import LogDownload
from twodof.fcu.mavlink.files.metadata import COMPONENT_METADATA, Metadata
from twodof.fcu.mavlink.service import Service
from twodof.fcu.mavlink.services import MavlinkServices
from twodof.fcu.mavlink.storage_monitor import StorageMonitor
from twodof.fcu.mavlink.telemetry.twodof_messages import ControllerIdentity, rig
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.store import ParameterStore
from twodof.fcu.px4_compat.log_stream import LogStreamService
from twodof.fcu.server import Server
from twodof.link.mavlink.rates import ONBOARD
from twodof.link.signing.frame_signing import Signing

WARNING = 4
"""MAV_SEVERITY."""


class Assembly:
    """The program of a drone: MAVLink system `system` on `hardware`.

    `state` is the folder of what it keeps: parameters.json, logs/, controllers/ (uploads); None keeps nothing.
    `rates` are those of the streams that every client gets (link/mavlink/rates.py). `signing` is asked of every
    client. `fresh` begins with all parameters at their defaults and without what was uploaded. `close` ends what stands
    outside the event loop; the server closes by itself.
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
        if fresh:
            controllers.forget()
        code, damage = controllers.build()
        self.store = ParameterStore(None if state is None else state / "parameters.json", system)
        self._what = (code, controller_identity(code))
        self._changed = (-1, 0)  # at this revision of the store, so many parameters differ from their defaults
        tuned = self.store.carry(code.own_parameters)
        if fresh:
            tuned = ()
            self.store.reset()
        self._flies = self.store.flying() | self.store.own()
        code.set_parameters(self._flies)
        self._metadata = Metadata(self.store.rows, lambda: 4 * self.controller.tick)
        self.commander = commander = Commander(hardware, lambda: self.store["THRUST_BAR"], lockstep)
        self.controller = controller = FlightController(hardware, code, commander, lockstep)
        self.server = server = Server(controller, system, signing)
        server.pilot = lambda: commander.lease.holder
        self.store.listen(lambda _: self._fly_with(self.store.flying() | self.store.own()))
        self.log: OnboardLogger | None = None
        self._state = state
        self._closing = ExitStack()
        self._closing.callback(self.store.close)
        if state is not None:
            self.log = OnboardLogger(state / "logs", self.store, lockstep, self._about)
            self._closing.callback(self.log.close)
            controller.listeners.append(self.log.step)
        self.px4 = MavlinkServices(
            server,
            system,
            controller,
            commander,
            self.store,
            restart=self._restart if hardware.virtual else None,
            flown=self.controller_identity,
            lost=lambda: server.lost,
            truth=(lambda: cast(VirtualHardware, hardware).truth) if hardware.virtual else None,
            profile=rates,
            capabilities=FTP_CAPABILITY,
        )
        if self.log is not None:
            self.px4.remarks.listeners.append(self.log.remark)
            self.px4.commands.explained.append(self.log.remark)
        self.reload = ReloadCommand(self.px4.commands, controller, commander, controllers, self._fly_others)
        server.serve(self._services(controller, commander))
        controller.remarks = commander.remarks
        commander.unfit = self._unfit
        said = (damage, *self.store.remarks, *tuned, *self._hidden())
        commander.remarks += [(WARNING, text) for text in said if text]

    def _services(self, controller: FlightController, commander: Commander) -> list[Service]:
        """All, in their order: every frame is heard first, and a tick is over when all else of it was sent."""
        px4, server, us = self.px4, self.server, VehicleAddress(self.server.system)
        explain = px4.commands.explain
        return [
            px4.services[0],
            LeaseService(server, us, commander, explain),
            *self._streamed(us, controller.lockstep),
            *px4.services[1:],
            SetpointService(us, commander, explain),
            ExcitationService(server, us, commander, explain),
            *self._files(us, controller.lockstep),
            LockstepService(server, us, controller, commander, explain, rig(controller, self.controller_identity)),
        ]

    def _files(self, us: VehicleAddress, lockstep: bool) -> list[Service]:
        """Descriptions of the parameters, logs and uploads over MAVLink, and word of what cannot be written."""
        server, log, state, commander = self.server, self.log, self._state, self.commander
        self.px4.requests.on(COMPONENT_METADATA, self._metadata.message)
        self._tree = FileTree(self._made(), log.folder if log else None, state / "controllers" if state else None)
        files: list[Service] = [
            FileTransfer(server, us, self._tree, commander.take, self.px4.commands.explain, lockstep),
            StorageMonitor(self.store, log, commander.remarks),
        ]
        if log is not None:
            files.append(LogDownload(server, us, log, commander.take, self.px4.commands.explain, lockstep))
        return files

    def _streamed(self, us: VehicleAddress, lockstep: bool) -> list[Service]:
        """The log as it is written; it hears every frame, so as to know whether its client is there."""
        if self.log is None:
            return []
        return [LogStreamService(self.server, us, self.px4.commands, self.log, self.commander.take, lockstep)]

    def close(self) -> None:
        """Writes what is not written yet. Raises ParameterError or LogError where the disk refuses; twice is once."""
        self._closing.close()

    def _fly_with(self, values: dict[str, Any]) -> None:
        changed = {name: value for name, value in values.items() if value != self._flies[name]}
        self._flies = values
        if changed:
            self.controller.set_parameters(changed)

    def _fly_others(self) -> None:
        """Other controllers fly from the next tick on: theirs are the parameters that are listed and described."""
        remarks = self.store.carry(self.controller.code.own_parameters)
        own = self.store.own()
        self._flies = self.store.flying() | own
        self.controller.set_parameters(own)
        self._metadata.renew(self.store.rows)
        self._tree.made = self._made()
        self.commander.remarks += [(WARNING, text) for text in (*remarks, *self._hidden())]

    def _made(self) -> dict[str, bytes]:
        """The descriptions that clients read as files: of the parameters and events, and the diagrams that fly."""
        own = self.controller.code.own_parameters
        return {**self._metadata.files, **{f"{one.kind}.json": one.text.encode() for one in own}}

    def _hidden(self) -> list[str]:
        """What of the controllers' parameters is not shown."""
        return [own.remark for own in self.controller.code.own_parameters if own.remark]

    def _about(self) -> dict[str, str | int]:
        """What a log says of the flight."""
        hardware = self.controller.hardware
        about: dict[str, str | int] = {"rig": hardware.name, "seed": hardware.seed, "rings": int(hardware.rings)}
        return about | {"controller": self.controller_identity().controller}

    def controller_identity(self) -> ControllerIdentity:
        """Which controller flies, and how many parameters differ from their defaults."""
        code = self.controller.code
        if self._what[0] is not code:
            self._what = (code, controller_identity(code))
        if self._changed[0] != self.store.revision:  # a client may have TWODOF_RIG sent in every control period
            self._changed = (self.store.revision, len(self.store.changed()))
        return self._what[1]._replace(changed=self._changed[1])

    def _unfit(self) -> str:
        """A controller that cannot fly, or is in the making: who arms is to know it before."""
        if self.reload.building:
            return "a controller is being built"
        fault = self.controller.code.own_fault
        return f"the controller has stopped: {fault}" if fault else ""

    def _restart(self) -> None:
        self.controller.reset()
