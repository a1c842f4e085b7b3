"""Storage: command 245, by which ground stations store parameters and set all to their defaults."""

from __future__ import annotations

from collections.abc import Callable, Hashable

from twodof.errors import ParameterError
from twodof.fcu.asked import ACCEPTED, DENIED, FAILED, IN_PROGRESS, TEMPORARILY_REJECTED, UNSUPPORTED, Verdict
from twodof.fcu.services.addressing import whole
from twodof.fcu.services.commands import Command, Commands
from twodof.fcu.services.vehicle import Commander
from twodof.fcu.store import SAVE_S, Store

STORAGE = 245
LOAD, SAVE, RESET_CONFIG, RESET_SENSORS, RESET_ALL = range(5)
"""PREFLIGHT_STORAGE_PARAMETER_ACTION."""
MOST_WAITING = 16


class Storage:
    """As in PX4 while disarmed only. Each answer comes when what flies is on the disk, or says why it is not.

    The control loop does not wait for the disk: it asks after each control period. In lockstep, where periods may
    stand still, the command itself waits.
    """

    def __init__(self, commands: Commands, commander: Commander, store: Store, lockstep: bool = False) -> None:
        self._commander = commander
        self._store = store
        self._lockstep = lockstep
        self._waiting: dict[Hashable, Callable[[], bool]] = {}
        commands.on(STORAGE, self._act, self._stored)

    def _act(self, command: Command) -> Verdict:
        action = whole(command.params[0], -1)
        if not LOAD <= action <= RESET_ALL:
            return Verdict(DENIED)
        if action == RESET_SENSORS:
            return Verdict(UNSUPPORTED, "nothing of the sensors is calibrated")
        if self._commander.armed:
            return Verdict(TEMPORARILY_REJECTED, "parameters are stored and reset while disarmed only")
        if len(self._waiting) >= MOST_WAITING:
            return Verdict(TEMPORARILY_REJECTED, f"{MOST_WAITING} others wait for the disk: ask again")
        if action in (RESET_CONFIG, RESET_ALL):
            verdict = self._commander.take(command.source, "reset of the parameters")
            verdict = self._reset() if verdict.accepted else verdict
            if not verdict.accepted:
                return verdict
        stored = self._store.save()
        if stored is None:
            return _UNKEPT if action in (LOAD, SAVE) else Verdict(ACCEPTED)
        if self._lockstep:
            return self._flushed()
        self._waiting[command.what] = stored
        return self._stored(command)

    def _stored(self, command: Command) -> Verdict:
        """What has become of it."""
        try:
            if not self._waiting[command.what]():
                return Verdict(IN_PROGRESS)
        except ParameterError as reason:
            del self._waiting[command.what]
            return _failed(reason)
        del self._waiting[command.what]
        return Verdict(ACCEPTED)

    def _flushed(self) -> Verdict:
        try:
            self._store.flush(SAVE_S)
        except ParameterError as reason:
            return _failed(reason)
        return Verdict(ACCEPTED)

    def _reset(self) -> Verdict:
        try:
            self._store.reset(self._commander.armed)
        except ParameterError as reason:
            return Verdict(FAILED, str(reason))
        return Verdict(ACCEPTED)


_UNKEPT = Verdict(UNSUPPORTED, "it keeps no parameters: start it with a folder for its state")


def _failed(reason: ParameterError) -> Verdict:
    return Verdict(FAILED, f"parameters are not stored: {reason}")
