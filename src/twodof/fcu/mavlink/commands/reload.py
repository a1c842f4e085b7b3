"""Reload: the command after which the controllers fly that were uploaded."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Mapping
from contextlib import suppress

from twodof.blocks import Diagram
from twodof.compile.wasm.target import check_ready
from twodof.errors import CompileError, TwodofError
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import (
    ACCEPTED,
    FAILED,
    IN_PROGRESS,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    CommandResult,
)
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand

RELOAD = 31010
"""MAV_CMD_USER_1: builds the flight code of the controllers in the folder of uploads, and flies it from then on.

With its first number `ASK` it only tells whether there is what that takes.
"""

ASK = 1.0


class ReloadCommand:
    """Carries out `RELOAD`, disarmed only; the answer comes when the controllers fly, or says why they do not.

    With `ASK` nothing is built and no lease taken: a client asks so before it uploads. What could not be built is not
    among the uploads any more: they are what flies, also for a later command.

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
        self._verdict = CommandResult(ACCEPTED)
        self._commands = commands
        commands.on(RELOAD, self._reload, lambda _: self._verdict, slow=True)

    @property
    def building(self) -> bool:
        """Whether a controller is being built."""
        return self._verdict.result == IN_PROGRESS

    def _reload(self, command: ReceivedCommand) -> CommandResult:
        if self._controllers.uploads is None:
            return CommandResult(UNSUPPORTED, "it keeps no uploads: start it with a folder for its state")
        if self._commander.armed or self._commander.arming.answer.result == IN_PROGRESS:
            return CommandResult(TEMPORARILY_REJECTED, "no other controller while armed: disarm first")
        if command.params[0] == ASK:
            return _equipped()
        verdict = self._commander.take(command.source, "reload")
        if not verdict.accepted:
            return verdict
        if not self.building:
            self._verdict = CommandResult(IN_PROGRESS)
            self._task = asyncio.get_running_loop().create_task(self._build(), name="reload")
        return self._verdict

    async def _build(self) -> None:
        made = CommandResult(FAILED, "the program itself has a fault: report it")
        try:
            code, uploaded = await asyncio.to_thread(self._controllers.build_uploaded)
            self._controller.replace(code)
            self._flies()
            # Only what flies is kept: else a restart would bring what this command refused.
            made = await self._kept(uploaded)
            gc.collect()
            gc.freeze()  # see `Server`: not in flight
        except TwodofError as error:
            made = CommandResult(FAILED, str(error))
        finally:
            if made.result != ACCEPTED:
                with suppress(TwodofError):  # a disk that refuses changes nothing of what flies
                    await asyncio.to_thread(self._controllers.restore)
            self._verdict = made
            self._commands.poll()

    async def _kept(self, uploaded: Mapping[str, Diagram]) -> CommandResult:
        """The result for what flies now: it is on the disk, or it flies until the program ends."""
        try:
            await asyncio.to_thread(self._controllers.keep, uploaded)
        except TwodofError as refusal:
            return CommandResult(FAILED, f"it flies until a restart and is not stored: {refusal}")
        return CommandResult(ACCEPTED)


def _equipped() -> CommandResult:
    """Whether the sandbox can be made here."""
    try:
        check_ready()
    except CompileError as lack:
        return CommandResult(FAILED, f"{lack.what}: {lack.remedy}")
    return CommandResult(ACCEPTED)
