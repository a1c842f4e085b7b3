"""Storage: command 245, by which ground stations store parameters and set all to their defaults."""

from __future__ import annotations

from twodof.errors import ParameterError
from twodof.fcu.asked import ACCEPTED, DENIED, FAILED, TEMPORARILY_REJECTED, UNSUPPORTED, Verdict
from twodof.fcu.services.addressing import whole
from twodof.fcu.services.commands import Command, Commands
from twodof.fcu.services.vehicle import Commander
from twodof.fcu.store import Store

STORAGE = 245
LOAD, SAVE, RESET_CONFIG, RESET_SENSORS, RESET_ALL = range(5)
"""PREFLIGHT_STORAGE_PARAMETER_ACTION."""


class Storage:
    """As in PX4 while disarmed only. What is set is stored at once, so that loading and saving change nothing."""

    def __init__(self, commands: Commands, commander: Commander, store: Store) -> None:
        self._commander = commander
        self._store = store
        commands.on(STORAGE, self._act)

    def _act(self, command: Command) -> Verdict:
        action = whole(command.params[0], -1)
        if not LOAD <= action <= RESET_ALL:
            return Verdict(DENIED)
        if action == RESET_SENSORS:
            return Verdict(UNSUPPORTED, "nothing of the sensors is calibrated")
        if self._commander.armed:
            return Verdict(TEMPORARILY_REJECTED, "parameters are stored and reset while disarmed only")
        if action in (LOAD, SAVE):
            failure = self._store.failure
            return Verdict(ACCEPTED) if failure is None else Verdict(FAILED, f"parameters are not stored: {failure}")
        verdict = self._commander.take(command.source, "reset of the parameters")
        return self._reset() if verdict.accepted else verdict

    def _reset(self) -> Verdict:
        try:
            self._store.reset(self._commander.armed)
        except ParameterError as reason:
            return Verdict(FAILED, str(reason))
        return Verdict(ACCEPTED)
