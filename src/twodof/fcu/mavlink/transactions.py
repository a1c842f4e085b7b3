"""Transactions: TWODOF_PARAM_TRANSACTION sets several parameters at one tick or none, and undoes the last change."""

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import NamedTuple

from twodof.fcu.command.result import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.commands.command_service import CommandService
from twodof.fcu.mavlink.parameter_service import NO_ERROR, READ_FAIL, ParameterService, text
from twodof.fcu.mavlink.service import Link, Service
from twodof.fcu.parameters.parameter_store import HASH_NAME
from twodof.link.connection import Received
from twodof.link.mavlink.messages import Packer

BEGIN, COMMIT, ROLL_BACK, UNDO = range(4)
"""TWODOF_TRANSACTION."""
LONGEST_TICKS = 15_000
"""A transaction that is not ended within a minute is forgotten."""
MOST_OPEN = 16
MOST_ANSWERS = 32


class TransactionAnswer(NamedTuple):
    """What became of it: MAV_PARAM_ERROR, how many PARAM_SETs have come for it, and which was refused first."""

    result: int
    have: int = 0
    name: str = ""
    why: str = ""


@dataclass
class Transaction:
    """A sender's PARAM_SETs that are kept back; `fault` is the first that cannot be."""

    number: int
    begun: int
    values: dict[str, float] = field(default_factory=dict)
    fault: tuple[int, str] | None = None

    @property
    def count(self) -> int:
        """How many different parameters have come."""
        return len(self.values) + (self.fault is not None)


class TransactionService(Service):
    """Stands before `parameters` and keeps back what belongs to a transaction.

    Each sender has at most one open. A message that comes again, with the number of what was done already, gets the
    same answer and does nothing. A COMMIT that overtakes some of its PARAM_SETs leaves the transaction open for them,
    and the client sends it again.
    """

    def __init__(self, link: Link, us: VehicleAddress, commands: CommandService, parameters: ParameterService) -> None:
        self._link = link
        self._us = us
        self._commands = commands
        self._parameters = parameters
        self._open: OrderedDict[Source, Transaction] = OrderedDict()
        self._answered: OrderedDict[tuple[Source, int, int], TransactionAnswer] = OrderedDict()
        self._pack = Packer("TWODOF_PARAM_TRANSACTION", "transaction", "count", "action", "result", "param_id")
        self._tick = 0

    def handle(self, received: Received) -> bool:
        got = received.message
        kind = got.get_type()
        if kind == "PARAM_SET":
            return self._keep(received)
        if kind != "TWODOF_PARAM_TRANSACTION":
            return False
        if self._us.addressed(got) and got.action <= UNDO:
            self._answer(received)
        return True

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick
        while self._open:
            oldest = next(iter(self._open))
            if 0 <= step.tick - self._open[oldest].begun <= LONGEST_TICKS:
                break
            del self._open[oldest]

    def restart(self) -> None:
        self._open.clear()
        self._answered.clear()

    def _keep(self, received: Received) -> bool:
        transaction = self._open.get(source(received))
        if transaction is None or text(received.message.param_id) == HASH_NAME:
            return False
        if not self._us.addressed(received.message):
            return False
        name, value, error = self._parameters.checked(received)
        if value is not None:
            transaction.values[name] = value
        elif transaction.fault is None:
            transaction.fault = error, name
        return True

    def _answer(self, received: Received) -> None:
        got, sender = received.message, source(received)
        key = (sender, got.action, got.transaction)
        if got.action == BEGIN:
            # Begun again is begun anew; its old answers no longer count.
            for done in [done for done in self._answered if done[0] == sender and done[2] == got.transaction]:
                del self._answered[done]
            self._open.pop(sender, None)
            self._open[sender] = Transaction(got.transaction, self._tick)
            if len(self._open) > MOST_OPEN:
                self._open.popitem(last=False)
            answer = TransactionAnswer(NO_ERROR)
        elif key in self._answered:
            answer = self._answered[key]
        else:
            answer = self._end(received, sender)
            if answer.result != READ_FAIL:  # what is still under way may come yet
                self._answered[key] = answer
                if len(self._answered) > MOST_ANSWERS:
                    self._answered.popitem(last=False)
            self._commands.explain(received.peer, answer.why)
        name = answer.name.encode()[:16]
        self._link.send(self._pack(got.transaction, answer.have, got.action, answer.result, name), received.peer)

    def _end(self, received: Received, sender: Source) -> TransactionAnswer:
        got = received.message
        if got.action == UNDO:
            error, why = self._parameters.undo(sender)
            return TransactionAnswer(error, why=why)
        transaction = self._open.get(sender)
        if transaction is None or transaction.number != got.transaction:
            return TransactionAnswer(READ_FAIL, why=f"there is no open transaction {got.transaction}")
        if got.action == ROLL_BACK:
            del self._open[sender]
            return TransactionAnswer(NO_ERROR, transaction.count)
        return self._commit(transaction, sender, got.count)

    def _commit(self, transaction: Transaction, sender: Source, count: int) -> TransactionAnswer:
        have = transaction.count
        if transaction.fault is None and have != count:
            return TransactionAnswer(
                READ_FAIL, have, why=f"{have} of {count} parameters have come; nothing was changed yet"
            )
        del self._open[sender]
        if transaction.fault is not None:
            error, name = transaction.fault
            return TransactionAnswer(
                error, have, name, f"{name}: no such parameter, or of another type; nothing was changed"
            )
        error, name, why = self._parameters.change(transaction.values, sender)
        return TransactionAnswer(error, have, name, why)
