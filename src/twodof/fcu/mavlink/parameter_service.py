"""Parameters: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET as PX4 answers them, PARAM_ERROR, and transactions.

An int32 travels with its bits in the float field. A list begins with `_HASH_CHECK`, so that a client that has the
values already can stop it by setting `_HASH_CHECK`. Other controllers bring other parameters: then `_HASH_CHECK` is
sent to all clients, so that they request the list again, and a list that is being sent starts again. Bounds are
enforced: a refused value is answered by PARAM_ERROR and the value that stays, one of the wrong type by PARAM_ERROR.
TWODOF_PARAM_TRANSACTION sets several parameters at one tick, or none.
"""

import struct
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from twodof.errors import ParameterError, listed
from twodof.fcu.command.command_lease import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import PacedSender
from twodof.fcu.mavlink.clients import ClientLeft
from twodof.fcu.mavlink.service import Service, Vehicle, source, target
from twodof.fcu.parameters.parameter_store import HASH_NAME, ParametersChanged, ParametersRelisted
from twodof.link.connection import Received
from twodof.link.mavlink.messages import Packed, Packer, message

UINT32, INT32, REAL32 = 5, 6, 9
"""MAV_PARAM_TYPE."""
_TYPES = {"int32": INT32, "float": REAL32}
NO_ERROR, DOES_NOT_EXIST, OUT_OF_RANGE, PERMISSION_DENIED = range(4)
READ_ONLY, TYPE_UNSUPPORTED, TYPE_MISMATCH, READ_FAIL = 5, 6, 7, 8
"""MAV_PARAM_ERROR."""
HASH_INDEX = 0xFFFF
A_TICK = 4
"""Parameters of a list sent in a tick to each client: a thousand a second."""


class ParameterService(Service):
    """The parameter protocol for the vehicle's store.

    Any client may change parameters for tuning, unless the holder of the lease withholds it. Other parameters need the
    lease.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(
            vehicle, {"PARAM_REQUEST_LIST": self._list, "PARAM_REQUEST_READ": self._read, "PARAM_SET": self._set}
        )
        self._commander, self._store = vehicle.commander, vehicle.store
        self._sender = PacedSender(lambda peer, sent: vehicle.send(sent, peer), False, A_TICK)
        self._pack = Packer("PARAM_VALUE", "param_count", "param_index", "param_id", "param_type")
        vehicle.bus.subscribe(ClientLeft, lambda left: self._sender.stop(left.peer))
        vehicle.bus.subscribe(ParametersChanged, self._announce)
        vehicle.bus.subscribe(ParametersRelisted, self._relist)

    def after(self, step: ControlStep) -> None:
        self._sender.most = A_TICK * len(self._sender.messages)
        self._sender.tick()

    def change(self, wanted: Mapping[str, float], sender: Source) -> tuple[int, str, str]:
        """Change all of `wanted` or nothing; return MAV_PARAM_ERROR, the first faulty parameter, and the reason."""
        kept = next((name for name in wanted if name in self._store and not self._store.row(name).tuning), "")
        if kept:
            result = self._commander.lease.take(sender, f"{kept} (not for tuning)")
        else:
            result = self._commander.lease.may_tune(sender)
        if not result.accepted:
            return PERMISSION_DENIED, kept, result.text
        before = self._store.revision
        try:
            self._store.update(wanted, self._commander.armed)
        except ParameterError as error:
            return (*self._blame(wanted), str(error))
        if self._store.revision != before:
            self._commander.lease.tuned(sender, listed([f"{name} = {self._store[name]:g}" for name in wanted], 3))
        return NO_ERROR, "", ""

    def checked(self, received: Received) -> tuple[str, float | None, int]:
        """Return name, value and MAV_PARAM_ERROR of a PARAM_SET; the value is None if the type does not fit."""
        got = received.message
        name = text(got.param_id)
        if name not in self._store:
            return name, None, DOES_NOT_EXIST
        kind = self._store.row(name).kind
        if got.param_type not in _TYPES.values():
            return name, None, TYPE_UNSUPPORTED
        if got.param_type != _TYPES[kind]:
            return name, None, TYPE_MISMATCH
        # From the frame's bytes: a float of Python does not keep those of every int32.
        raw = received.frame.payload[:4].ljust(4, b"\0")
        return name, struct.unpack("<i" if kind == "int32" else "<f", raw)[0], NO_ERROR

    def _value(self, name: str) -> Packed:
        """Return PARAM_VALUE of a parameter."""
        row = self._store.row(name)
        return self._packed(row.name, row.bits(self._store[row.name]), self._store.index(row.name), _TYPES[row.kind])

    def _hash(self) -> Packed:
        """Return PARAM_VALUE of `_HASH_CHECK`."""
        return self._packed(HASH_NAME, struct.pack("<I", self._store.hash_check()), HASH_INDEX, UINT32)

    def _error(self, received: Received, name: str, error: int, index: int = -1) -> None:
        who = target(source(received))
        sent = message("PARAM_ERROR", param_id=name.encode()[:16], param_index=index, error=error, **who)
        self._vehicle.send(sent, received.peer)

    def _list(self, received: Received) -> None:
        # Asked again while it is being sent, it begins again without the hash, as PX4 does.
        again = self._sender.stop(received.peer)
        rows = self._listed(with_hash=not again)
        if not self._vehicle.lockstep:
            self._sender.start(received.peer, rows)
            return
        for packed in rows:  # time may stand still, and there is no radio to spare
            self._vehicle.send(packed, received.peer)

    def _listed(self, with_hash: bool) -> Iterator[Packed]:
        if with_hash:
            yield self._hash()
        for row in self._store.rows:
            yield self._value(row.name)

    def _read(self, received: Received) -> None:
        got, rows = received.message, self._store.rows
        name = text(got.param_id)
        if got.param_index >= 0:
            name = rows[got.param_index].name if got.param_index < len(rows) else ""
        if name == HASH_NAME:
            self._vehicle.send(self._hash(), received.peer)
        elif name in self._store:
            self._vehicle.send(self._value(name), received.peer)
        else:
            self._error(received, name, DOES_NOT_EXIST, max(got.param_index, -1))

    def _set(self, received: Received) -> None:
        if text(received.message.param_id) == HASH_NAME:
            self._sender.stop(received.peer)
            return
        name, value, error = self.checked(received)
        if value is None:
            self._error(received, name, error)
            return
        before = self._store.revision
        error, _, why = self.change({name: value}, source(received))
        if error != NO_ERROR:
            self._vehicle.explain(received.peer, why)  # first: who hears of the error looks for the reason
            self._error(received, name, error)
        # A change was announced to everybody; what is the same as before, or stays, is told to who asked.
        if self._store.revision == before:
            self._vehicle.send(self._value(name), received.peer)

    def _announce(self, changed: ParametersChanged) -> None:
        for name in changed.values:
            self._vehicle.send(self._value(name))

    def _relist(self, _: ParametersRelisted) -> None:
        for peer in [*self._sender.messages]:
            self._sender.start(peer, self._listed(with_hash=True))
        self._vehicle.send(self._hash())

    def _blame(self, wanted: Mapping[str, float]) -> tuple[int, str]:
        """Return the MAV_PARAM_ERROR and the name of the first value that the store refuses."""
        for name, value in wanted.items():
            if name not in self._store:
                return DOES_NOT_EXIST, name
            row = self._store.row(name)
            if row.fixed:
                return READ_ONLY, name
            if not row.low <= value <= row.high:
                return OUT_OF_RANGE, name
        locked = [name for name in wanted if self._store.row(name).disarmed]
        return PERMISSION_DENIED, locked[0] if locked else next(iter(wanted), "")

    def _packed(self, name: str, bits: bytes, index: int, kind: int) -> Packed:
        packed = self._pack(len(self._store.rows), index, name.encode(), kind)
        packed.payload = bits + packed.payload[4:]  # the very bits, those of a signalling NaN too
        return packed


def text(name: str | bytes) -> str:
    """Return a parameter's name as text."""
    return name if isinstance(name, str) else name.decode("ascii", "replace")


BEGIN, COMMIT, ROLL_BACK = range(3)
"""TWODOF_TRANSACTION."""
LONGEST_TICKS = 15_000
"""Ticks after which an open transaction is forgotten: a minute."""
MOST_OPEN = 16


class TransactionAnswer(NamedTuple):
    """Result of a transaction: MAV_PARAM_ERROR, the number of its PARAM_SETs, the first refused one, the reason."""

    result: int
    have: int = 0
    name: str = ""
    why: str = ""


@dataclass
class Transaction:
    """PARAM_SETs of a sender that wait for COMMIT; `fault` is the first invalid one.

    `ended` is the action that ended the transaction, BEGIN while it is open; `answer` is the answer to that action.
    """

    number: int
    begun: int
    values: dict[str, float] = field(default_factory=dict)
    fault: tuple[int, str] | None = None
    ended: int = BEGIN
    answer: TransactionAnswer | None = None


class TransactionService(Service):
    """Service before `parameters` that holds back the PARAM_SETs of transactions until COMMIT.

    Each sender has at most one transaction. A repeated message of an ended one gets the same answer and has no effect.
    A COMMIT that overtakes some of its PARAM_SETs leaves the transaction open for them, and the client repeats it.
    """

    def __init__(self, vehicle: Vehicle, parameters: ParameterService) -> None:
        super().__init__(vehicle, {"TWODOF_PARAM_TRANSACTION": self._answer})
        self._parameters = parameters
        self._latest: OrderedDict[Source, Transaction] = OrderedDict()
        self._pack = Packer("TWODOF_PARAM_TRANSACTION", "transaction", "count", "action", "result", "param_id")
        self._tick = 0

    def handle(self, received: Received) -> bool:
        return self._keep(received) if received.message.get_type() == "PARAM_SET" else super().handle(received)

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick
        while self._latest and step.tick - next(iter(self._latest.values())).begun > LONGEST_TICKS:
            self._latest.popitem(last=False)

    def restart(self) -> None:
        self._latest.clear()

    def _keep(self, received: Received) -> bool:
        transaction = self._latest.get(source(received))
        if transaction is None or transaction.ended != BEGIN or text(received.message.param_id) == HASH_NAME:
            return False
        if not self._vehicle.addressed(received.message):
            return False
        name, value, error = self._parameters.checked(received)
        if value is not None:
            transaction.values[name] = value
        elif transaction.fault is None:
            transaction.fault = error, name
        return True

    def _answer(self, received: Received) -> None:
        got, sender = received.message, source(received)
        if got.action == BEGIN:
            self._latest.pop(sender, None)
            self._latest[sender] = Transaction(got.transaction, self._tick)
            if len(self._latest) > MOST_OPEN:
                self._latest.popitem(last=False)
            answer = TransactionAnswer(NO_ERROR)
        elif got.action in (COMMIT, ROLL_BACK):
            answer = self._end(got, sender)
        else:
            return
        if answer.why:
            self._vehicle.explain(received.peer, answer.why)
        name = answer.name.encode()[:16]
        self._vehicle.send(self._pack(got.transaction, answer.have, got.action, answer.result, name), received.peer)

    def _end(self, got: Any, sender: Source) -> TransactionAnswer:
        found = self._latest.get(sender)
        if found is None or found.number != got.transaction or found.ended not in (BEGIN, got.action):
            return TransactionAnswer(READ_FAIL, why=f"transaction {got.transaction} is not open")
        if found.answer is not None:
            return found.answer
        have = len(found.values) + (found.fault is not None)
        answer = TransactionAnswer(NO_ERROR, have)
        if got.action == COMMIT and found.fault is not None:
            why = f"{found.fault[1]}: no such parameter, or of another type; nothing was changed"
            answer = TransactionAnswer(found.fault[0], have, found.fault[1], why)
        elif got.action == COMMIT and have != got.count:
            why = f"{have} of {got.count} parameters have come; nothing was changed yet"
            return TransactionAnswer(READ_FAIL, have, why=why)
        elif got.action == COMMIT:
            error, name, why = self._parameters.change(found.values, sender)
            answer = TransactionAnswer(error, have, name, why)
        found.ended, found.answer = got.action, answer._replace(why="")
        return answer
