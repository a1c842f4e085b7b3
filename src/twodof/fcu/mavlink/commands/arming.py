"""Arming, disarming, stopping, restarting: the commands 400, 401, 185 and 246."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import (
    ACCEPTED,
    DENIED,
    IN_PROGRESS,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    CommandResult,
    Source,
)
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand

ARM_DISARM, TERMINATE, REBOOT, RUN_CHECKS = 400, 185, 246, 401
FORCE = 21196
"""Second parameter of command 400: disarm in flight, too."""
MOST_CODE, REBOOT_AUTOPILOT = 4, 1
"""REBOOT_SHUTDOWN_ACTION."""


class ArmingDenied(NamedTuple):
    """Somebody was not let arm; `by_lease`: since another client holds the lease."""

    by_lease: bool


class MotorsKilled(NamedTuple):
    """`source` has stopped the motors."""

    source: Source


class ChecksRequested(NamedTuple):
    """Somebody wants to know what keeps from arming."""


class ArmingCommands:
    """Hands arming and stopping to the commander, and a restart to `restart` (None: it cannot restart).

    It publishes ArmingDenied, MotorsKilled and ChecksRequested.
    """

    def __init__(
        self,
        commands: CommandService,
        commander: Commander,
        bus: OnboardEventBus,
        restart: Callable[[], None] | None = None,
    ) -> None:
        self._commander = commander
        self._restart = restart
        self._bus = bus
        commands.on(ARM_DISARM, self._arm_or_disarm, self._armed)
        commands.on(TERMINATE, self._terminate)
        commands.on(REBOOT, self._reboot)
        commands.on(RUN_CHECKS, self._check)

    def _arm_or_disarm(self, command: ReceivedCommand) -> CommandResult:
        wanted, force = command.params[0], whole(command.params[1]) == FORCE
        if wanted == 1.0:
            holder = self._commander.lease.holder
            verdict = self._commander.arming.arm(command.source, force)
            return self._told(verdict, holder not in (None, command.source))
        if wanted == 0.0:
            verdict = self._commander.arming.disarm(command.source, force)
            return self._told_of_kill(command.source, verdict) if force else verdict
        return CommandResult(DENIED, "arm is 1, disarm is 0")

    def _armed(self, _command: ReceivedCommand) -> CommandResult:
        """What became of it, once that is known."""
        return self._told(self._commander.arming.answer, by_lease=False)

    def _told(self, verdict: CommandResult, by_lease: bool) -> CommandResult:
        if verdict.result not in (ACCEPTED, IN_PROGRESS):
            self._bus.publish(ArmingDenied(by_lease))
        return verdict

    def _check(self, _command: ReceivedCommand) -> CommandResult:
        """The failsafe checks at every tick; events, SYS_STATUS and TWODOF_SAFETY tell what it finds."""
        self._bus.publish(ChecksRequested())
        return CommandResult(ACCEPTED)

    def _told_of_kill(self, who: Source, verdict: CommandResult) -> CommandResult:
        self._bus.publish(MotorsKilled(who))
        return verdict

    def _terminate(self, command: ReceivedCommand) -> CommandResult:
        if command.params[0] == 0.0:
            return self._commander.arming.release(command.source)
        if not command.params[0] > 0.5:
            return CommandResult(DENIED, "a kill is 1, its release 0")
        return self._told_of_kill(command.source, self._commander.arming.kill(command.source))

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
            self._commander.arming.release(command.source)  # it begins as after being switched on
            self._restart()
        return verdict
