"""Reload: the command after which the controllers fly that were uploaded."""

from __future__ import annotations

import asyncio
from typing import Protocol

from twodof.errors import TwodofError
from twodof.fcu.asked import ACCEPTED, FAILED, IN_PROGRESS, TEMPORARILY_REJECTED, UNSUPPORTED, Source, Verdict
from twodof.fcu.controllers import Controllers
from twodof.fcu.loop import FlightController
from twodof.fcu.services.commands import Command, Commands

RELOAD = 31010
"""MAV_CMD_USER_1: builds the flight code of the controllers in the folder of uploads, and flies it from then on."""


class Commander(Protocol):
    """What this service asks of the commander."""

    @property
    def armed(self) -> bool:
        """Whether motors may turn."""

    def take(self, source: Source, what: str = "") -> Verdict:
        """Whether `source` may command."""


class Reload:
    """Carries out `RELOAD`, disarmed only; the answer comes when the controllers fly, or says why they do not.

    In real time it is compiled in a thread; in lockstep time waits for it.
    """

    def __init__(
        self, commands: Commands, controller: FlightController, commander: Commander, controllers: Controllers
    ) -> None:
        self._controller = controller
        self._commander = commander
        self._controllers = controllers
        self._task: asyncio.Task[None] | None = None
        self._verdict = Verdict(ACCEPTED)
        commands.on(RELOAD, self._reload, lambda: self._verdict)

    def _reload(self, command: Command) -> Verdict:
        if self._controllers.slot is None:
            return Verdict(UNSUPPORTED, "it keeps no uploads: start it with a folder for its state")
        if self._commander.armed:
            return Verdict(TEMPORARILY_REJECTED, "no other controller while armed: disarm first")
        verdict = self._commander.take(command.source, "reload")
        if not verdict.accepted:
            return verdict
        if self._controller.lockstep:
            return self._built()
        if self._task is None or self._task.done():
            self._verdict = Verdict(IN_PROGRESS)
            self._task = asyncio.get_running_loop().create_task(self._build(), name="reload")
        return self._verdict

    def _built(self) -> Verdict:
        try:
            self._controller.replace(self._controllers.build())
        except TwodofError as error:
            return Verdict(FAILED, str(error))
        return Verdict(ACCEPTED)

    async def _build(self) -> None:
        try:
            code = await asyncio.to_thread(self._controllers.build)
            self._controller.replace(code)
        except TwodofError as error:
            self._verdict = Verdict(FAILED, str(error))
        else:
            self._verdict = Verdict(ACCEPTED)
