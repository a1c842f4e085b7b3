"""Arming, disarming, stopping, restarting: the commands 400, 401, 185 and 246."""

from collections.abc import Callable
from typing import NamedTuple

from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import DONE, CommandResult, Source, denied, rejected, unsupported
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.link.mavlink.enums import MavCmd

FORCE = 21196
"""Second parameter of command 400: a disarming with it is a kill."""
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
        commands.on(MavCmd.COMPONENT_ARM_DISARM, self._arm_or_disarm, self._armed)
        commands.on(MavCmd.DO_FLIGHTTERMINATION, self._terminate)
        commands.on(MavCmd.PREFLIGHT_REBOOT_SHUTDOWN, self._reboot)
        commands.on(MavCmd.RUN_PREARM_CHECKS, self._check)

    def _arm_or_disarm(self, command: ReceivedCommand) -> CommandResult:
        if command.params[0] == 1.0:  # with FORCE too no check is skipped
            holder = self._commander.lease.holder
            result = self._commander.arming.arm(command.source)
            return self._told(result, by_lease=holder not in (None, command.source))
        if command.params[0] != 0.0:
            return denied("arm is 1, disarm is 0")
        if whole(command.params[1]) == FORCE:
            return self._kill(command.source)
        return self._commander.arming.disarm(command.source)

    def _armed(self, _command: ReceivedCommand) -> CommandResult:
        """What became of it, once that is known."""
        return self._told(self._commander.arming.answer, by_lease=False)

    def _told(self, result: CommandResult, by_lease: bool) -> CommandResult:
        if not result.accepted and not result.in_progress:
            self._bus.publish(ArmingDenied(by_lease))
        return result

    def _check(self, _command: ReceivedCommand) -> CommandResult:
        """The failsafe checks at every tick; events, SYS_STATUS and TWODOF_SAFETY tell what it finds."""
        self._bus.publish(ChecksRequested())
        return DONE

    def _kill(self, source: Source) -> CommandResult:
        result = self._commander.arming.kill(source)
        self._bus.publish(MotorsKilled(source))
        return result

    def _terminate(self, command: ReceivedCommand) -> CommandResult:
        if command.params[0] == 0.0:
            return self._commander.arming.release(command.source)
        if not command.params[0] > 0.5:
            return denied("a kill is 1, its release 0")
        return self._kill(command.source)

    def _reboot(self, command: ReceivedCommand) -> CommandResult:
        action = whole(command.params[0], -1)
        if not 0 <= action <= MOST_CODE:
            return denied()
        if action == 0:
            return DONE
        if self._restart is None or action != REBOOT_AUTOPILOT:  # it has no boot loader, and is not shut down
            return unsupported()
        if self._commander.armed:
            return rejected("no restart while armed: disarm first")
        result = self._commander.lease.take(command.source, "restart")
        if result.accepted:
            self._commander.arming.release(command.source)  # it begins as after being switched on
            self._restart()
        return result
