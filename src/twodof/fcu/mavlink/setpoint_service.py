"""Set-points by message, stick and open loop; excitations in pieces, their start, stop and state."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from math import isnan
from typing import Any

from twodof.errors import RefusalReason
from twodof.fcu.command.command_lease import DONE as ACCEPTED
from twodof.fcu.command.command_lease import CommandResult, Source, denied
from twodof.fcu.command.excitation_player import DONE, RECEIVING, REFUSED, SampledExcitation, prepare
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker
from twodof.fcu.mavlink.service import MASK_32, Service, Vehicle, acts_at, acts_at_ms, source
from twodof.link.connection import Received
from twodof.link.mavlink.messages import ExcitationReceiver, message
from twodof.link.mavlink.setpoints import SetPoint, read_attitude, read_position

TOLD_TICKS = 250
"""Ticks between two texts about refusals to one source; all refusals are counted."""
MOST_TOLD = 16
"""Most sources that get a text in this time, so that a flood under ever new ids makes few texts."""

FULL_STICK = 1000
"""MANUAL_CONTROL's largest value."""


class SetpointService(Service):
    """Service that passes set-points to the commander and tells a client the reason for a refusal.

    In lockstep a set-point acts at the tick of its `time_boot_ms`. In real time it acts at once, since that is the time
    of an unknown clock.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._readers: dict[str, Callable[[Any, Source], CommandResult]] = {
            "SET_ATTITUDE_TARGET": lambda got, sender: self._target(read_attitude(got), got, sender),
            "SET_POSITION_TARGET_LOCAL_NED": lambda got, sender: self._target(read_position(got), got, sender),
            "TWODOF_OPENLOOP": self._open_loop,
            "MANUAL_CONTROL": self._sticks,
        }
        super().__init__(vehicle, dict.fromkeys(self._readers, self._read), everybody=True)
        self._commander = vehicle.commander
        self._tick = 0
        self._told: OrderedDict[Source, int] = OrderedDict()  # when each was told last, the oldest first

    def _read(self, received: Received) -> None:
        got, sender = received.message, source(received)
        result = self._readers[got.get_type()](got, sender)
        if not result.accepted and self._may_tell(sender):
            self._vehicle.refuse(received, result)

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick

    def restart(self) -> None:
        self._tick = 0
        self._told.clear()

    def _may_tell(self, sender: Source) -> bool:
        """Return whether this sender may get a text: not if it, or too many others, got one lately."""
        while self._told and self._tick - next(iter(self._told.values())) >= TOLD_TICKS:
            self._told.popitem(last=False)
        if sender in self._told or len(self._told) >= MOST_TOLD:
            return False
        self._told[sender] = self._tick
        return True

    def _target(self, setpoint: SetPoint | None, got: Any, sender: Source) -> CommandResult:
        if setpoint is None:
            return self._commander.refuse(RefusalReason.NOTHING, "it asks for nothing that this drone can fly")
        at_tick = acts_at_ms(got.time_boot_ms, self._tick) if self._commander.lockstep else 0
        return self._commander.setpoint(sender, setpoint, at_tick)

    def _open_loop(self, got: Any, sender: Source) -> CommandResult:
        flags = bool(got.openloop), bool(got.enableM), bool(got.enableT)
        return self._commander.open_loop(sender, got.M, got.T, *flags, at_tick=acts_at(got.tick, self._tick))

    def _sticks(self, got: Any, sender: Source) -> CommandResult:
        return self._commander.sticks(sender, got.x / FULL_STICK, got.z / FULL_STICK)


PIECE, START, STOP = range(3)
"""TWODOF_EXCITE_ACTION."""

STATUS_TICKS = 250
REASON_BYTES = 80


Definition = tuple[Source, int, int, int]
"""Identity of a definition sent in pieces: sender, transfer, checksum, length."""


class ExcitationService(Service):
    """Service that assembles definitions, passes them to the commander, and sends the excitation's state to all.

    Sampling a definition may take a second: it is done beside the control loop, in lockstep at once, as time waits.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, {"TWODOF_EXCITE": self._take, "TWODOF_EXCITE_STATUS": None})
        self._commander = vehicle.commander
        self._background = BackgroundWorker(inline=vehicle.lockstep)
        self._begin(None)
        self._tick = 0
        self._revision = 0

    def _take(self, received: Received) -> None:
        """Take pieces, starts and stops."""
        got = received.message
        answer = self._act(got, source(received), received.peer)
        if not answer.accepted:
            self._vehicle.refuse(received, answer)
            self._send(received.peer, got.transfer, REFUSED, answer.text)
        self._tell_changes()

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick
        self._background.poll()
        player = self._commander.excitation.player
        if player.revision != self._revision:
            self._tell_changes()
        elif player.playing and (step.tick - player.start) % STATUS_TICKS == 0:
            self._tell_player(None)

    def restart(self) -> None:
        self._begin(None)
        self._tick, self._revision = 0, self._commander.excitation.player.revision

    def _begin(self, coming: Definition | None) -> None:
        """Wait for the pieces of this definition; None: of any."""
        self._coming = coming
        self._receiver = ExcitationReceiver()
        self._whole = False  # all pieces of it have come
        self._refused = ""  # why it was refused then

    def _act(self, got: Any, sender: Source, peer: Hashable) -> CommandResult:
        if got.action == PIECE:
            return self._piece(got, sender, peer)
        if got.action == START:
            player = self._commander.excitation.player
            if player.transfer == got.transfer and player.state == DONE:
                # A start that comes once more, since its answer was lost: it was played, and is not played twice.
                self._tell_player(peer)
                return ACCEPTED
            thrust = None if isnan(got.thrust) else got.thrust
            at_tick = acts_at(got.tick, self._tick)
            return self._commander.excitation.start(sender, got.transfer, got.loop, thrust, at_tick)
        if got.action == STOP:
            return self._commander.excitation.stop(sender)
        return denied(f"excitation refused: unknown action {got.action}")

    def _piece(self, got: Any, sender: Source, peer: Hashable) -> CommandResult:
        taken = self._commander.lease.take(sender, "excitation")
        if not taken.accepted:
            return taken
        definition = sender, got.transfer, got.crc, got.total
        if definition != self._coming:
            self._begin(definition)
        if not self._whole:
            before = self._receiver.received
            data = self._receiver.take(got)
            if data is not None:
                self._whole = True
                if not self._background.submit(partial(prepare, data), partial(self._made, definition)):
                    self._refuse(definition, "too many wait to be written out")
            elif self._receiver.received != before:
                self._send(peer, got.transfer, RECEIVING)
        elif self._refused:
            self._send(peer, got.transfer, REFUSED, self._refused)
        else:  # a piece that comes once more: what became of the definition is asked for
            self._tell_player(peer)
        return taken

    def _made(self, definition: Definition, made: object) -> None:
        answer = denied(str(made))
        if isinstance(made, SampledExcitation):
            answer = self._commander.excitation.define(*definition[:2], made)
        if not answer.accepted:
            self._refuse(definition, answer.text)

    def _refuse(self, definition: Definition, reason: str) -> None:
        if definition == self._coming:
            self._refused = reason
        self._send(None, definition[1], REFUSED, reason)

    def _tell_changes(self) -> None:
        if self._commander.excitation.player.revision != self._revision:
            self._revision = self._commander.excitation.player.revision
            self._tell_player(None)

    def _tell_player(self, peer: Hashable | None) -> None:
        player = self._commander.excitation.player
        self._send(peer, player.transfer, player.state, player.reason, player.start, player.end)

    def _send(
        self, peer: Hashable | None, transfer: int, state: int, reason: str = "", start: int = 0, end: int = 0
    ) -> None:
        ticks = {"tick": self._tick & MASK_32, "start_tick": start & MASK_32, "end_tick": end & MASK_32}
        received = self._receiver.received if self._coming is not None else 0
        what = {"transfer": transfer, "received": received, "state": state, "reason": reason.encode()[:REASON_BYTES]}
        self._vehicle.send(message("TWODOF_EXCITE_STATUS", **ticks, **what), peer)
