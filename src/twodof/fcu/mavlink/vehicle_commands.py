"""Commands to the vehicle: arming and stopping, modes, storing parameters, flying uploaded controllers."""

import asyncio
import gc
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from twodof.compile.wasm.target import check_ready
from twodof.errors import CompileError, ParameterError, RefusalReason, TwodofError
from twodof.fcu.command.command_lease import DONE, CommandResult, denied, failed, rejected, unsupported
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.mavlink.command_service import Answering, CommandService, ReceivedCommand
from twodof.fcu.mavlink.encoders import TelemetryEncoders
from twodof.fcu.mavlink.message_requests import MessageRequests
from twodof.fcu.mavlink.service import Service, Vehicle, source, whole
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import MavCmd, MavResult
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.modes import BY_NUMBER, MODES

FORCE = 21196
"""Second parameter of command 400 that makes a disarming a kill."""
MOST_CODE, REBOOT_AUTOPILOT = 4, 1
"""REBOOT_SHUTDOWN_ACTION."""


class ArmingCommands:
    """Commands for arming and stopping, which go to the commander, and for a restart by `restart` (None: refused)."""

    def __init__(self, vehicle: Vehicle, commands: CommandService, restart: Callable[[], None] | None = None) -> None:
        self._vehicle = vehicle
        self._commander = vehicle.commander
        self._restart = restart
        commands.on(MavCmd.COMPONENT_ARM_DISARM, self._arm_or_disarm, lambda _: self._commander.arming.answer)
        commands.on(MavCmd.DO_FLIGHTTERMINATION, self._terminate)
        commands.on(MavCmd.PREFLIGHT_REBOOT_SHUTDOWN, self._reboot)
        commands.on(MavCmd.RUN_PREARM_CHECKS, self._check)

    def _arm_or_disarm(self, command: ReceivedCommand) -> CommandResult:
        if command.params[0] == 1.0:  # with FORCE too no check is skipped
            return self._commander.arming.arm(command.source, command.repeated)
        if command.params[0] != 0.0:
            return denied("arm is 1, disarm is 0")
        if whole(command.params[1]) == FORCE:
            return self._commander.arming.kill(command.source)
        return self._commander.arming.disarm(command.source)

    def _check(self, command: ReceivedCommand) -> CommandResult:
        """Send the findings of the pre-arm checks, which the failsafe makes at every tick, as text."""
        if not self._commander.armed and (against := self._commander.arming.obstacles()):
            self._vehicle.explain(command.peer, f"arming is not possible: {against}")
        return DONE

    def _terminate(self, command: ReceivedCommand) -> CommandResult:
        if command.params[0] == 0.0:
            return self._commander.arming.release(command.source)
        if not command.params[0] > 0.5:
            return denied("a kill is 1, its release 0")
        return self._commander.arming.kill(command.source)

    def _reboot(self, command: ReceivedCommand) -> CommandResult:
        action = whole(command.params[0], -1)
        if not 0 <= action <= MOST_CODE:
            return denied()
        if action == 0:
            return DONE
        if self._restart is None or action != REBOOT_AUTOPILOT:  # it has no boot loader, and is not shut down
            return unsupported()
        if self._commander.armed:
            return rejected("no restart while armed: disarm first", RefusalReason.ARMED)
        result = self._commander.lease.take(command.source, "restart")
        if result.accepted:
            self._commander.arming.release(command.source)  # it begins as after being switched on
            self._restart()
        return result


_CUSTOM = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


class ModeService(Service):
    """Service for SET_MODE and the commands 176 and 262; AVAILABLE_MODES on request; two streamed messages."""

    def __init__(
        self, vehicle: Vehicle, commands: CommandService, requests: MessageRequests, telemetry: TelemetryEncoders
    ) -> None:
        super().__init__(vehicle, {"SET_MODE": self._set_by_message})
        self._commands = commands
        self._commander = vehicle.commander
        commands.on(MavCmd.DO_SET_MODE, self._set)
        commands.on(MavCmd.DO_SET_STANDARD_MODE, self._set_standard)
        requests.on("AVAILABLE_MODES", self._available)
        telemetry.add("CURRENT_MODE", self._current)
        # The list is the same for as long as the flight controller runs.
        telemetry.add("AVAILABLE_MODES_MONITOR", lambda: message("AVAILABLE_MODES_MONITOR", seq=0))

    def _set_by_message(self, received: Received) -> None:
        """Take SET_MODE, which is acknowledged as command 176, as in PX4."""
        got = received.message
        if got.base_mode & _CUSTOM:
            number = got.custom_mode
            params = (float(got.base_mode), float(number >> 16 & 0xFF), float(number >> 24), *(0.0,) * 4)
            command = ReceivedCommand(MavCmd.DO_SET_MODE, params, source(received), received.peer)
            self._commands.acknowledge(command, self._commander.set_mode(command.source, number))

    def _current(self) -> Any:
        number = self._commander.custom_mode
        standard = BY_NUMBER[number].standard_mode if number in BY_NUMBER else 0
        return message("CURRENT_MODE", standard_mode=standard, custom_mode=number, intended_custom_mode=number)

    def _set(self, command: ReceivedCommand) -> CommandResult:
        base, main, sub = (whole(value, -1) for value in command.params[:3])
        if base < 0 or not base & _CUSTOM or not 0 <= main <= 255:
            return denied("a mode is set by base mode 1 and PX4's main and sub mode")
        return self._commander.set_mode(command.source, main << 16 | (max(sub, 0) & 0xFF) << 24)

    def _set_standard(self, command: ReceivedCommand) -> CommandResult:
        wanted = whole(command.params[0])
        for row in MODES:
            if wanted > 0 and row.standard_mode == wanted:
                return self._commander.set_mode(command.source, row.custom_mode)
        return unsupported()

    def _available(self, command: ReceivedCommand) -> Iterable[Any] | None:
        """Return all modes, or the one whose number from 1 is the second parameter."""
        wanted = whole(command.params[1])
        if not 0 <= wanted <= len(MODES):
            return None
        found = []
        for place, row in enumerate(MODES, start=1):
            if wanted in (0, place):
                mode = {"standard_mode": row.standard_mode, "custom_mode": row.custom_mode, "mode_name": row.name}
                place_of = {"number_modes": len(MODES), "mode_index": place}
                found.append(message("AVAILABLE_MODES", **place_of, **mode, properties=row.properties))
        return found


LOAD, SAVE, RESET_CONFIG, RESET_SENSORS, RESET_ALL = range(5)
"""PREFLIGHT_STORAGE_PARAMETER_ACTION."""


class StorageCommand:
    """Command to store, load or reset parameters, while disarmed only, as in PX4.

    Each answer comes when the present values are on the disk, or gives the reason why they are not. The control loop
    does not wait for the disk; in lockstep, where periods may stand still, the command itself does.
    """

    def __init__(self, vehicle: Vehicle, commands: CommandService) -> None:
        self._commander = vehicle.commander
        self._store = vehicle.store
        commands.on(MavCmd.PREFLIGHT_STORAGE, self._act)

    def _act(self, command: ReceivedCommand) -> CommandResult | Answering:
        action = whole(command.params[0], -1)
        if not LOAD <= action <= RESET_ALL:
            return denied()
        if action == RESET_SENSORS:
            return unsupported("nothing of the sensors is calibrated")
        if self._commander.armed:
            return rejected("parameters are stored and reset while disarmed only", RefusalReason.ARMED)
        if action in (RESET_CONFIG, RESET_ALL):
            taken = self._commander.lease.take(command.source, "reset of the parameters")
            if not taken.accepted:
                return taken
            try:
                self._store.reset(self._commander.armed)
            except ParameterError as reason:
                return failed(str(reason))
        if self._store.kept:
            return self._save()
        unkept = unsupported("it keeps no parameters: start it with a folder for its state")
        return unkept if action in (LOAD, SAVE) else DONE

    def _save(self) -> Answering:
        try:
            yield self._store.save
        except TwodofError as reason:
            return failed(f"parameters are not stored: {reason}")
        return DONE


ASK = 1.0


class ReloadCommand:
    """Command MAV_CMD_USER_1: build the flight code of the uploaded controllers and fly it from then on.

    It needs a disarmed drone. The answer comes when the controllers fly, or gives the reason why they do not. If the
    command's first number is `ASK`, it only reports whether uploads can be built, and needs no lease: a client asks
    this before it uploads. Uploads that cannot be built are deleted, so that the folder holds what flies.

    Compiling takes seconds, in a thread beside the control loop. Arming is refused while it runs (`building`), since
    both threads need the interpreter. `flies` is called before the first tick in which the new controllers fly.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandService,
        controllers: Controllers,
        flies: Callable[[], None] = lambda: None,
    ) -> None:
        self._controller = vehicle.controller
        self._commander = vehicle.commander
        self._controllers = controllers
        self._flies = flies
        self._task: asyncio.Task[None] | None = None
        self._result = DONE
        self._commands = commands
        commands.on(MavCmd.USER_1, self._reload, lambda _: self._result, slow=True)

    @property
    def building(self) -> bool:
        """Return whether a controller is being built."""
        return self._result.in_progress

    def _reload(self, command: ReceivedCommand) -> CommandResult:
        if self._controllers.uploads is None:
            return unsupported("uploads are not kept: start the drone with a folder for its state")
        if self._commander.armed or self._commander.arming.pending:
            return rejected("no other controller while armed: disarm first", RefusalReason.ARMED)
        if command.params[0] == ASK:
            return _equipped()
        taken = self._commander.lease.take(command.source, "reload")
        if not taken.accepted:
            return taken
        if not self.building:
            self._result = CommandResult(MavResult.IN_PROGRESS)
            self._task = asyncio.get_running_loop().create_task(self._build(), name="reload")
        return self._result

    async def _build(self) -> None:
        flies, made = False, failed("the program itself has a fault: report it")
        try:
            code, uploaded = await asyncio.to_thread(self._controllers.build_uploaded)
            self._controller.replace(code)
            self._flies()
            flies = True
            # Only what flies is kept: else a restart would bring what this command refused.
            await asyncio.to_thread(self._controllers.keep, uploaded)
            made = DONE
            gc.collect()
            gc.freeze()  # see `Server`: not in flight
        except TwodofError as error:
            made = failed(f"it flies until a restart and is not stored: {error}" if flies else str(error))
        finally:
            if not made.accepted:
                with suppress(TwodofError):  # a disk that refuses changes nothing of what flies
                    await asyncio.to_thread(self._controllers.restore)
            self._result = made
            self._commands.poll()


def _equipped() -> CommandResult:
    """Return DONE if the sandbox can be built on this computer, else the refusal."""
    try:
        check_ready()
    except CompileError as lack:
        return failed(f"{lack.what}: {lack.remedy}")
    return DONE
