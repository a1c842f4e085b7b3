"""Storage: command 245, by which ground stations store parameters and set all to their defaults."""

from __future__ import annotations

from collections.abc import Callable, Hashable

from twodof.errors import ParameterError
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import (
    ACCEPTED,
    DENIED,
    FAILED,
    IN_PROGRESS,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    CommandResult,
)
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.parameters.parameter_store import SAVE_S, ParameterStore

STORAGE = 245
LOAD, SAVE, RESET_CONFIG, RESET_SENSORS, RESET_ALL = range(5)
"""PREFLIGHT_STORAGE_PARAMETER_ACTION."""
MOST_WAITING = 16


class StorageCommand:
    """As in PX4 while disarmed only. Each answer comes when what flies is on the disk, or says why it is not.

    The control loop does not wait for the disk: it asks after each control period. In lockstep, where periods may
    stand still, the command itself waits.
    """

    def __init__(
        self, commands: CommandService, commander: Commander, store: ParameterStore, lockstep: bool = False
    ) -> None:
        self._commander = commander
        self._store = store
        self._lockstep = lockstep
        self._waiting: dict[Hashable, Callable[[], bool]] = {}
        commands.on(STORAGE, self._act, self._stored)

    def _act(self, command: ReceivedCommand) -> CommandResult:
        action = whole(command.params[0], -1)
        if not LOAD <= action <= RESET_ALL:
            return CommandResult(DENIED)
        if action == RESET_SENSORS:
            return CommandResult(UNSUPPORTED, "nothing of the sensors is calibrated")
        if self._commander.armed:
            return CommandResult(TEMPORARILY_REJECTED, "parameters are stored and reset while disarmed only")
        if len(self._waiting) >= MOST_WAITING:
            return CommandResult(TEMPORARILY_REJECTED, f"{MOST_WAITING} others wait for the disk: ask again")
        if action in (RESET_CONFIG, RESET_ALL):
            verdict = self._commander.take(command.source, "reset of the parameters")
            verdict = self._reset() if verdict.accepted else verdict
            if not verdict.accepted:
                return verdict
        stored = self._store.save()
        if stored is None:
            return _UNKEPT if action in (LOAD, SAVE) else CommandResult(ACCEPTED)
        if self._lockstep:
            return self._flushed()
        self._waiting[command.what] = stored
        return self._stored(command)

    def _stored(self, command: ReceivedCommand) -> CommandResult:
        """What has become of it."""
        try:
            if not self._waiting[command.what]():
                return CommandResult(IN_PROGRESS)
        except ParameterError as reason:
            del self._waiting[command.what]
            return _failed(reason)
        del self._waiting[command.what]
        return CommandResult(ACCEPTED)

    def _flushed(self) -> CommandResult:
        try:
            self._store.flush(SAVE_S)
        except ParameterError as reason:
            return _failed(reason)
        return CommandResult(ACCEPTED)

    def _reset(self) -> CommandResult:
        try:
            self._store.reset(self._commander.armed)
        except ParameterError as reason:
            return CommandResult(FAILED, str(reason))
        return CommandResult(ACCEPTED)


_UNKEPT = CommandResult(UNSUPPORTED, "it keeps no parameters: start it with a folder for its state")


def _failed(reason: ParameterError) -> CommandResult:
    return CommandResult(FAILED, f"parameters are not stored: {reason}")
