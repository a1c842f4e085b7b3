"""Arming, disarming, stopping, restarting: the commands 400, 401, 185 and 246."""

from __future__ import annotations

from collections.abc import Callable

from twodof.fcu.command.result import (
    ACCEPTED,
    DENIED,
    IN_PROGRESS,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    CommandResult,
    Source,
)
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.vehicle import CommanderView

ARM_DISARM, TERMINATE, REBOOT, RUN_CHECKS = 400, 185, 246, 401
FORCE = 21196
"""Second parameter of command 400: disarm in flight, too."""
MOST_CODE, REBOOT_AUTOPILOT = 4, 1
"""REBOOT_SHUTDOWN_ACTION."""


class ArmingCommands:
    """Hands arming and stopping to the commander, and a restart to whoever can (`restart`, None: nobody).

    Each of `denied` is called when somebody was not let arm, and told whether that is for another's lease; of `killed`
    with who stopped the motors; of `asked` when somebody wants to know what keeps from arming.
    """

    def __init__(
        self, commands: CommandService, commander: CommanderView, restart: Callable[[], None] | None = None
    ) -> None:
        self._commander = commander
        self._restart = restart
        self.denied: list[Callable[[bool], None]] = []
        self.killed: list[Callable[[Source], None]] = []
        self.asked: list[Callable[[], None]] = []
        commands.on(ARM_DISARM, self._arm_or_disarm, self._armed)
        commands.on(TERMINATE, self._terminate)
        commands.on(REBOOT, self._reboot)
        commands.on(RUN_CHECKS, self._check)

    def _arm_or_disarm(self, command: ReceivedCommand) -> CommandResult:
        wanted, force = command.params[0], whole(command.params[1]) == FORCE
        if wanted == 1.0:
            holder = self._commander.lease.holder
            verdict = self._commander.arm(command.source, force)
            return self._told(verdict, holder not in (None, command.source))
        if wanted == 0.0:
            verdict = self._commander.disarm(command.source, force)
            return self._told_of_kill(command.source, verdict) if force else verdict
        return CommandResult(DENIED, "arm is 1, disarm is 0")

    def _armed(self, _command: ReceivedCommand) -> CommandResult:
        """What became of it, once that is known."""
        return self._told(self._commander.arming, by_lease=False)

    def _told(self, verdict: CommandResult, by_lease: bool) -> CommandResult:
        if verdict.result not in (ACCEPTED, IN_PROGRESS):
            for call in self.denied:
                call(by_lease)
        return verdict

    def _check(self, _command: ReceivedCommand) -> CommandResult:
        """The failsafe checks at every tick; events, SYS_STATUS and TWODOF_SAFETY tell what it finds."""
        for call in self.asked:
            call()
        return CommandResult(ACCEPTED)

    def _told_of_kill(self, who: Source, verdict: CommandResult) -> CommandResult:
        for call in self.killed:
            call(who)
        return verdict

    def _terminate(self, command: ReceivedCommand) -> CommandResult:
        if command.params[0] == 0.0:
            return self._commander.release(command.source)
        if not command.params[0] > 0.5:
            return CommandResult(DENIED, "a kill is 1, its release 0")
        return self._told_of_kill(command.source, self._commander.kill(command.source))

    def _reboot(self, command: ReceivedCommand) -> CommandResult:
        action = whole(command.params[0], -1)
        if not 0 <= action <= MOST_CODE:
            return CommandResult(DENIED)
        if action == 0:
            return CommandResult(ACCEPTED)
        if self._restart is None or action != REBOOT_AUTOPILOT:  # it has no boot loader, and is not shut down
            return CommandResult(UNSUPPORTED)
        if self._commander.armed:
            return CommandResult(TEMPORARILY_REJECTED, "no restart while armed: disarm first")
        verdict = self._commander.take(command.source, "restart")
        if verdict.accepted:
            self._commander.release(command.source)  # it begins as after being switched on
            self._restart()
        return verdict
