"""Storage: command 245, by which ground stations store parameters and set all to their defaults."""

from collections.abc import Callable, Hashable

from twodof.errors import ParameterError
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import DONE, CommandResult, denied, failed, rejected, unsupported
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.parameters.parameter_store import SAVE_S, ParameterStore
from twodof.link.mavlink.enums import MavCmd, MavResult

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
        commands.on(MavCmd.PREFLIGHT_STORAGE, self._act, self._stored)

    def _act(self, command: ReceivedCommand) -> CommandResult:
        action = whole(command.params[0], -1)
        if not LOAD <= action <= RESET_ALL:
            return denied()
        if action == RESET_SENSORS:
            return unsupported("nothing of the sensors is calibrated")
        if self._commander.armed:
            return rejected("parameters are stored and reset while disarmed only")
        if len(self._waiting) >= MOST_WAITING:
            return rejected(f"{MOST_WAITING} others wait for the disk: ask again")
        if action in (RESET_CONFIG, RESET_ALL):
            taken = self._commander.lease.take(command.source, "reset of the parameters")
            if not taken.accepted:
                return taken
            try:
                self._store.reset(self._commander.armed)
            except ParameterError as reason:
                return failed(str(reason))
        stored = self._store.save()
        if stored is None:
            unkept = unsupported("it keeps no parameters: start it with a folder for its state")
            return unkept if action in (LOAD, SAVE) else DONE
        self._waiting[command.what] = stored
        return self._stored(command)

    def _stored(self, command: ReceivedCommand) -> CommandResult:
        """What has become of it."""
        try:
            if self._lockstep:
                self._store.flush(SAVE_S)
            elif not self._waiting[command.what]():
                return CommandResult(MavResult.IN_PROGRESS)
        except ParameterError as reason:
            del self._waiting[command.what]
            return failed(f"parameters are not stored: {reason}")
        del self._waiting[command.what]
        return DONE
