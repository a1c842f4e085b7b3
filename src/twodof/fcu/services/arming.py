"""Arming, disarming, stopping, restarting: the commands 400, 401, 185 and 246."""

from __future__ import annotations

from collections.abc import Callable

from twodof.fcu.asked import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Verdict
from twodof.fcu.services.addressing import whole
from twodof.fcu.services.commands import Command, Commands
from twodof.fcu.services.vehicle import Commander

ARM_DISARM, TERMINATE, REBOOT, RUN_CHECKS = 400, 185, 246, 401
FORCE = 21196
"""Second parameter of command 400: disarm in flight, too."""
MOST_CODE = 4
"""Actions of command 246 that MAVLink knows: 0 nothing, 1 reboot, 2 shut down, 3, 4 reboot in other ways."""


class Arming:
    """Hands arming and stopping to the commander, and a restart to whoever can (`restart`, None: nobody)."""

    def __init__(self, commands: Commands, commander: Commander, restart: Callable[[], None] | None = None) -> None:
        self._commander = commander
        self._restart = restart
        commands.on(ARM_DISARM, self._arm_or_disarm, lambda: commander.arming)
        commands.on(TERMINATE, self._terminate)
        commands.on(REBOOT, self._reboot)
        commands.on(RUN_CHECKS, self._check)

    def _arm_or_disarm(self, command: Command) -> Verdict:
        wanted, force = command.params[0], whole(command.params[1]) == FORCE
        if wanted == 1.0:
            return self._commander.arm(command.source, force)
        if wanted == 0.0:
            return self._commander.disarm(command.source, force)
        return Verdict(DENIED, "arm is 1, disarm is 0")

    def _check(self, _command: Command) -> Verdict:
        """The failsafe checks at every tick; SYS_STATUS and TWODOF_SAFETY tell what it finds."""
        return Verdict(TEMPORARILY_REJECTED, "it is armed") if self._commander.armed else Verdict(ACCEPTED)

    def _terminate(self, command: Command) -> Verdict:
        if not command.params[0] > 0.5:  # 0 asks to stop terminating, which nothing does
            return Verdict(UNSUPPORTED)
        return self._commander.kill(command.source)

    def _reboot(self, command: Command) -> Verdict:
        action = whole(command.params[0], -1)
        if not 0 <= action <= MOST_CODE:
            return Verdict(DENIED)
        if action == 0:
            return Verdict(ACCEPTED)
        if self._restart is None or action == 2:
            return Verdict(UNSUPPORTED)
        if self._commander.armed:
            return Verdict(TEMPORARILY_REJECTED, "no restart while armed: disarm first")
        verdict = self._commander.take(command.source, "restart")
        if verdict.accepted:
            self._restart()
        return verdict
