"""Reload: the command after which the controllers fly that were uploaded."""

import asyncio
import gc
from collections.abc import Callable, Mapping
from contextlib import suppress

from twodof.blocks import Diagram
from twodof.compile.wasm.target import check_ready
from twodof.errors import CompileError, TwodofError
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import DONE, CommandResult, failed, rejected, unsupported
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.link.mavlink.enums import MavCmd, MavResult

ASK = 1.0


class ReloadCommand:
    """Builds the flight code of the controllers in the folder of uploads, and flies it from then on, at MAV_CMD_USER_1.

    It does so disarmed only. The answer comes when the controllers fly, or says why they do not. Where the command's
    first number is `ASK`, it only tells whether there is what that takes, and takes no lease: a client asks so before
    it uploads. What could not be built is not among the uploads any more: they are what flies, also for a later
    command.

    It compiles for seconds, in a thread beside the control loop. Nobody may arm during that time (`building`), since
    both threads want the interpreter. `flies` is called before the first tick in which the new controllers fly.
    """

    def __init__(
        self,
        commands: CommandService,
        controller: FlightController,
        commander: Commander,
        controllers: Controllers,
        flies: Callable[[], None] = lambda: None,
    ) -> None:
        self._controller = controller
        self._commander = commander
        self._controllers = controllers
        self._flies = flies
        self._task: asyncio.Task[None] | None = None
        self._result = DONE
        self._commands = commands
        commands.on(MavCmd.USER_1, self._reload, lambda _: self._result, slow=True)

    @property
    def building(self) -> bool:
        """Whether a controller is being built."""
        return self._result.in_progress

    def _reload(self, command: ReceivedCommand) -> CommandResult:
        if self._controllers.uploads is None:
            return unsupported("it keeps no uploads: start it with a folder for its state")
        if self._commander.armed or self._commander.arming.pending:
            return rejected("no other controller while armed: disarm first")
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
        made = failed("the program itself has a fault: report it")
        try:
            code, uploaded = await asyncio.to_thread(self._controllers.build_uploaded)
            self._controller.replace(code)
            self._flies()
            # Only what flies is kept: else a restart would bring what this command refused.
            made = await self._kept(uploaded)
            gc.collect()
            gc.freeze()  # see `Server`: not in flight
        except TwodofError as error:
            made = failed(str(error))
        finally:
            if not made.accepted:
                with suppress(TwodofError):  # a disk that refuses changes nothing of what flies
                    await asyncio.to_thread(self._controllers.restore)
            self._result = made
            self._commands.poll()

    async def _kept(self, uploaded: Mapping[str, Diagram]) -> CommandResult:
        """The result for what flies now: it is on the disk, or it flies until the program ends."""
        try:
            await asyncio.to_thread(self._controllers.keep, uploaded)
        except TwodofError as refusal:
            return failed(f"it flies until a restart and is not stored: {refusal}")
        return DONE


def _equipped() -> CommandResult:
    """Whether the sandbox can be made here."""
    try:
        check_ready()
    except CompileError as lack:
        return failed(f"{lack.what}: {lack.remedy}")
    return DONE
