"""Arming, disarming, stopping, restarting: the commands 400, 401, 185 and 246."""

from __future__ import annotations

from collections.abc import Callable

from twodof.fcu.asked import ACCEPTED, DENIED, IN_PROGRESS, TEMPORARILY_REJECTED, UNSUPPORTED, Source, Verdict
from twodof.fcu.services.addressing import whole
from twodof.fcu.services.commands import Command, Commands
from twodof.fcu.services.vehicle import Commander

ARM_DISARM, TERMINATE, REBOOT, RUN_CHECKS = 400, 185, 246, 401
FORCE = 21196
"""Second parameter of command 400: disarm in flight, too."""
MOST_CODE, REBOOT_AUTOPILOT = 4, 1
"""REBOOT_SHUTDOWN_ACTION."""


class Arming:
    """Hands arming and stopping to the commander, and a restart to whoever can (`restart`, None: nobody).

    Each of `denied` is called when somebody was not let arm, and told whether that is for another's lease; of `killed`
    with who stopped the motors; of `asked` when somebody wants to know what keeps from arming.
    """

    def __init__(self, commands: Commands, commander: Commander, restart: Callable[[], None] | None = None) -> None:
        self._commander = commander
        self._restart = restart
        self.denied: list[Callable[[bool], None]] = []
        self.killed: list[Callable[[Source], None]] = []
        self.asked: list[Callable[[], None]] = []
        commands.on(ARM_DISARM, self._arm_or_disarm, self._armed)
        commands.on(TERMINATE, self._terminate)
        commands.on(REBOOT, self._reboot)
        commands.on(RUN_CHECKS, self._check)

    def _arm_or_disarm(self, command: Command) -> Verdict:
        wanted, force = command.params[0], whole(command.params[1]) == FORCE
        if wanted == 1.0:
            holder = self._commander.lease.holder
            verdict = self._commander.arm(command.source, force)
            return self._told(verdict, holder not in (None, command.source))
        if wanted == 0.0:
            verdict = self._commander.disarm(command.source, force)
            return self._told_of_kill(command.source, verdict) if force else verdict
        return Verdict(DENIED, "arm is 1, disarm is 0")

    def _armed(self, _command: Command) -> Verdict:
        """What became of it, once that is known."""
        return self._told(self._commander.arming, by_lease=False)

    def _told(self, verdict: Verdict, by_lease: bool) -> Verdict:
        if verdict.result not in (ACCEPTED, IN_PROGRESS):
            for call in self.denied:
                call(by_lease)
        return verdict

    def _check(self, _command: Command) -> Verdict:
        """The failsafe checks at every tick; events, SYS_STATUS and TWODOF_SAFETY tell what it finds."""
        for call in self.asked:
            call()
        return Verdict(ACCEPTED)

    def _told_of_kill(self, who: Source, verdict: Verdict) -> Verdict:
        for call in self.killed:
            call(who)
        return verdict

    def _terminate(self, command: Command) -> Verdict:
        if command.params[0] == 0.0:
            return self._commander.release(command.source)
        if not command.params[0] > 0.5:
            return Verdict(DENIED, "a kill is 1, its release 0")
        return self._told_of_kill(command.source, self._commander.kill(command.source))

    def _reboot(self, command: Command) -> Verdict:
        action = whole(command.params[0], -1)
        if not 0 <= action <= MOST_CODE:
            return Verdict(DENIED)
        if action == 0:
            return Verdict(ACCEPTED)
        if self._restart is None or action != REBOOT_AUTOPILOT:  # it has no boot loader, and is not shut down
            return Verdict(UNSUPPORTED)
        if self._commander.armed:
            return Verdict(TEMPORARILY_REJECTED, "no restart while armed: disarm first")
        verdict = self._commander.take(command.source, "restart")
        if verdict.accepted:
            self._commander.release(command.source)  # it begins as after being switched on
            self._restart()
        return verdict
