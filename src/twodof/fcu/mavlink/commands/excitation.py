"""TWODOF_EXCITE: an excitation's definition in pieces, its start and stop; TWODOF_EXCITE_STATUS tells how it stands."""

from collections.abc import Hashable
from math import isnan
from typing import Any, NamedTuple

from twodof.fcu.command import result
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.excitation_player import DONE, RECEIVING, REFUSED, SampledExcitation, prepare
from twodof.fcu.command.result import CommandResult, Source, denied
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.background import BackgroundWorker
from twodof.fcu.mavlink.service import Explain, Link, Service
from twodof.fcu.mavlink.wire_tick import MASK_32, acts_at
from twodof.link.connection import Received
from twodof.link.mavlink.messages import ExcitationReceiver, message

PIECE, START, STOP = range(3)
"""TWODOF_EXCITE_ACTION."""

STATUS_TICKS = 250
REASON_BYTES = 80


class ExcitationDefinition(NamedTuple):
    """Which definition pieces belong to."""

    sender: Source
    transfer: int
    crc: int
    total: int


class ExcitationService(Service):
    """Puts definitions together, hands them to the commander, and tells everybody how the excitation stands.

    Writing a definition out may take a second: it is done beside the control loop, but in lockstep, where time waits.
    """

    def __init__(self, link: Link, us: VehicleAddress, commander: Commander, tell: Explain) -> None:
        self._link = link
        self._us = us
        self._commander = commander
        self._tell = tell
        self._background = BackgroundWorker(inline=commander.lockstep)
        self._begin(None)
        self._tick = 0
        self._revision = 0

    def handle(self, received: Received) -> bool:
        """Takes pieces, starts and stops."""
        got, name = received.message, received.message.get_type()
        if name == "TWODOF_EXCITE" and self._us.addressed(got) and source(received) != tuple(self._us):
            answer = self._act(got, source(received), received.peer)
            if not answer.accepted:
                self._tell(received.peer, answer.text)
                self._send(received.peer, got.transfer, REFUSED, answer.text)
            self._tell_changes()
        return bool(name in ("TWODOF_EXCITE", "TWODOF_EXCITE_STATUS"))

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

    def _begin(self, coming: ExcitationDefinition | None) -> None:
        """Waits for the pieces of this definition; None: of any."""
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
                return result.DONE
            thrust = None if isnan(got.thrust) else got.thrust
            at_tick = acts_at(got.tick, self._tick)
            return self._commander.excitation.start(sender, got.transfer, got.loop, thrust, at_tick)
        if got.action == STOP:
            return self._commander.excitation.stop(sender)
        return denied(f"excitation refused: there is no action {got.action}")

    def _piece(self, got: Any, sender: Source, peer: Hashable) -> CommandResult:
        taken = self._commander.lease.take(sender, "excitation")
        if not taken.accepted:
            return taken
        definition = ExcitationDefinition(sender, got.transfer, got.crc, got.total)
        if definition != self._coming:
            self._begin(definition)
        if not self._whole:
            before = self._receiver.received
            data = self._receiver.take(got)
            if data is not None:
                self._write_out(definition, data)
            elif self._receiver.received != before:
                self._send(peer, got.transfer, RECEIVING)
        elif self._refused:
            self._send(peer, got.transfer, REFUSED, self._refused)
        else:  # a piece that comes once more: what became of the definition is asked for
            self._tell_player(peer)
        return taken

    def _write_out(self, definition: ExcitationDefinition, data: bytes) -> None:
        self._whole = True
        if not self._background.submit(lambda: prepare(data), lambda made: self._made(definition, made)):
            self._refuse(definition, "too many wait to be written out")

    def _made(self, definition: ExcitationDefinition, made: object) -> None:
        if not isinstance(made, SampledExcitation):
            self._refuse(definition, str(made))
            return
        answer = self._commander.excitation.define(definition.sender, definition.transfer, made)
        if not answer.accepted:
            self._refuse(definition, answer.text)

    def _refuse(self, definition: ExcitationDefinition, reason: str) -> None:
        if definition == self._coming:
            self._refused = reason
        self._send(None, definition.transfer, REFUSED, reason)

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
        self._link.send(
            message(
                "TWODOF_EXCITE_STATUS",
                tick=self._tick & MASK_32,
                start_tick=start & MASK_32,
                end_tick=end & MASK_32,
                transfer=transfer,
                received=self._receiver.received if self._coming is not None else 0,
                state=state,
                reason=reason.encode()[:REASON_BYTES],
            ),
            peer,
        )
