"""Parameters: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET as PX4 answers them, and PARAM_ERROR.

An int32 travels with its bits in the float field. A list begins with `_HASH_CHECK`, so that a client that has
the values already can stop it by setting `_HASH_CHECK`. Other controllers bring other parameters: then `_HASH_CHECK`
goes to everybody, so that a client that keeps a list asks again. A list that is being sent begins anew. Bounds are
enforced: a refused value is answered by PARAM_ERROR and the value that stays, one of the wrong type by PARAM_ERROR.
"""

import struct
from collections import OrderedDict, deque
from collections.abc import Hashable, Iterator, Mapping

from twodof.errors import ParameterError, listed
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.addressing import VehicleAddress, source, target
from twodof.fcu.mavlink.clients import ClientLeft
from twodof.fcu.mavlink.commands.command_service import CommandService
from twodof.fcu.mavlink.service import Link, Service
from twodof.fcu.parameters.parameter_store import HASH_NAME, ParametersChanged, ParametersRelisted, ParameterStore
from twodof.fcu.parameters.row import VehicleParameter
from twodof.link.connection import Received
from twodof.link.mavlink.messages import Packed, Packer, message
from twodof.parameters import UNDO_STEPS

UINT32, INT32, REAL32 = 5, 6, 9
"""MAV_PARAM_TYPE."""
_TYPES = {"int32": INT32, "float": REAL32}
NO_ERROR, DOES_NOT_EXIST, OUT_OF_RANGE, PERMISSION_DENIED = range(4)
READ_ONLY, TYPE_UNSUPPORTED, TYPE_MISMATCH, READ_FAIL = 5, 6, 7, 8
"""MAV_PARAM_ERROR."""
HASH_INDEX = 0xFFFF
A_TICK = 4
"""Parameters of a list that are sent in a tick: a thousand a second."""
MOST_LISTS = 64


class ParameterService(Service):
    """The parameter protocol in front of `store`.

    Anybody may change the rows for tuning, unless who holds the lease withholds it. The others need the lease. Undo
    needs it too, except for who made the latest change by tuning.
    """

    def __init__(
        self,
        link: Link,
        us: VehicleAddress,
        commands: CommandService,
        controller: FlightController,
        commander: Commander,
        store: ParameterStore,
    ) -> None:
        self._link = link
        self._us = us
        self._commands = commands
        self._controller = controller
        self._commander = commander
        self._store = store
        self._lists: OrderedDict[Hashable, Iterator[Packed]] = OrderedDict()
        self._tuners: deque[Source | None] = deque(maxlen=UNDO_STEPS)  # of each step to undo; None: not by tuning
        self._revision = store.revision  # after the latest of those steps
        self._pack = Packer("PARAM_VALUE", "param_count", "param_index", "param_id", "param_type")
        self._takes = {
            "PARAM_REQUEST_LIST": self._list,
            "PARAM_REQUEST_READ": self._read,
            "PARAM_SET": self._set,
        }
        store.bus.subscribe(ClientLeft, lambda left: self._lists.pop(left.client.peer, None))
        store.bus.subscribe(ParametersChanged, self._announce)
        store.bus.subscribe(ParametersRelisted, self._relist)

    def handle(self, received: Received) -> bool:
        take = self._takes.get(received.message.get_type())
        if take is None:
            return False
        if self._us.addressed(received.message):
            take(received)
        return True

    def after(self, step: ControlStep) -> None:
        for peer in [*self._lists]:
            self._go_on(peer, A_TICK)

    def change(self, wanted: Mapping[str, float], sender: Source) -> tuple[int, str, str]:
        """Changes all of `wanted` or nothing: MAV_PARAM_ERROR, the first parameter it is about, and why."""
        kept = next((name for name in wanted if name in self._store and not self._store.row(name).tuning), "")
        if kept:
            result = self._commander.lease.take(sender, f"{kept} (not for tuning)")
        else:
            result = self._commander.lease.may_tune(sender)
        if not result.accepted:
            return PERMISSION_DENIED, kept, result.text
        self._forget_tuners()
        try:
            self._store.update(wanted, self._commander.armed)
        except ParameterError as error:
            return (*self._blame(wanted), str(error))
        if self._store.revision != self._revision:
            self._tuners.append(None if kept else sender)
            self._tell_holder(sender, listed([f"{name} = {self._store[name]:g}" for name in wanted], 3))
        return NO_ERROR, "", ""

    def undo(self, sender: Source) -> tuple[int, str]:
        """Takes the latest change back: MAV_PARAM_ERROR and why."""
        self._forget_tuners()
        if self._tuners and self._tuners[-1] == sender:
            result = self._commander.lease.may_tune(sender, "undo")
        else:
            result = self._commander.lease.take(sender, "undo (the latest change is not this client's tuning)")
        if not result.accepted:
            return PERMISSION_DENIED, result.text
        try:
            self._store.undo(self._commander.armed)
        except ParameterError as error:
            return PERMISSION_DENIED, str(error)
        if self._tuners:
            self._tuners.pop()
        self._tell_holder(sender, "undo of parameters")
        return NO_ERROR, ""

    def checked(self, received: Received) -> tuple[str, float | None, int]:
        """Name and value that a PARAM_SET carries, and MAV_PARAM_ERROR if it has no value that fits its type."""
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

    def _value(self, row: VehicleParameter) -> Packed:
        """PARAM_VALUE of a parameter."""
        return self._packed(row.name, row.bits(self._store[row.name]), self._store.index(row.name), _TYPES[row.kind])

    def _hash(self) -> Packed:
        """PARAM_VALUE of `_HASH_CHECK`."""
        return self._packed(HASH_NAME, struct.pack("<I", self._store.hash_check()), HASH_INDEX, UINT32)

    def _error(self, received: Received, name: str, error: int, index: int = -1) -> None:
        who = target(source(received))
        sent = message("PARAM_ERROR", param_id=name.encode()[:16], param_index=index, error=error, **who)
        self._link.send(sent, received.peer)

    def _list(self, received: Received) -> None:
        # Asked again while it is being sent, it begins again without the hash, as PX4 does.
        again = self._lists.pop(received.peer, None) is not None
        self._lists[received.peer] = self._listed(with_hash=not again)
        if len(self._lists) > MOST_LISTS:
            self._lists.popitem(last=False)
        if self._controller.lockstep:  # time may stand still, and there is no radio to spare
            self._go_on(received.peer, len(self._store.rows) + 1)

    def _listed(self, with_hash: bool) -> Iterator[Packed]:
        if with_hash:
            yield self._hash()
        for row in self._store.rows:
            yield self._value(row)

    def _go_on(self, peer: Hashable, most: int) -> None:
        rows = self._lists[peer]
        for _ in range(most):
            packed = next(rows, None)
            if packed is None:
                del self._lists[peer]
                return
            self._link.send(packed, peer)

    def _read(self, received: Received) -> None:
        got, rows = received.message, self._store.rows
        name = text(got.param_id)
        if got.param_index >= 0:
            if got.param_index < len(rows):
                self._link.send(self._value(rows[got.param_index]), received.peer)
            else:
                self._error(received, "", DOES_NOT_EXIST, got.param_index)
        elif name == HASH_NAME:
            self._link.send(self._hash(), received.peer)
        elif name in self._store:
            self._link.send(self._value(self._store.row(name)), received.peer)
        else:
            self._error(received, name, DOES_NOT_EXIST)

    def _set(self, received: Received) -> None:
        if text(received.message.param_id) == HASH_NAME:
            self._lists.pop(received.peer, None)
            return
        name, value, error = self.checked(received)
        if value is None:
            self._error(received, name, error)
            return
        before = self._store.revision
        error, _, why = self.change({name: value}, source(received))
        if error != NO_ERROR:
            self._commands.explain(received.peer, why)  # first: who hears of the error looks for the reason
            self._error(received, name, error)
        # A change was announced to everybody; what is the same as before, or stays, is told to who asked.
        if self._store.revision == before:
            self._link.send(self._value(self._store.row(name)), received.peer)

    def _forget_tuners(self) -> None:
        """Where the parameters were changed in another way since, nobody knows whose the steps are."""
        if self._store.revision != self._revision:
            self._tuners.clear()
            self._revision = self._store.revision

    def _tell_holder(self, sender: Source, what: str) -> None:
        """Notes that `sender` has changed parameters, and has it told where somebody else holds the lease."""
        self._revision = self._store.revision
        self._commander.lease.tuned(sender, what)

    def _announce(self, changed: ParametersChanged) -> None:
        for name in changed.values:
            self._link.send(self._value(self._store.row(name)))

    def _relist(self, _: ParametersRelisted) -> None:
        for peer in self._lists:
            self._lists[peer] = self._listed(with_hash=True)
        self._link.send(self._hash())

    def _blame(self, wanted: Mapping[str, float]) -> tuple[int, str]:
        """Which of the values the store would not take, and MAV_PARAM_ERROR for it."""
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
    """A parameter's name as it came."""
    return name if isinstance(name, str) else name.decode("ascii", "replace")
