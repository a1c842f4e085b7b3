"""Commands: COMMAND_LONG and COMMAND_INT in, one COMMAND_ACK out for each; who does what is registered by number."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

from twodof.fcu.asked import ACCEPTED, IN_PROGRESS, UNSUPPORTED, Source, Verdict
from twodof.fcu.flight_code import Step
from twodof.fcu.service import Link
from twodof.fcu.services.addressing import Us, source
from twodof.link.connection import Received
from twodof.link.messages import message, statustext

WARNING = 4
REPEATED_TICKS = 125
"""A frame that comes again within half a second is a copy made on the way, not a second command."""
MOST_REMEMBERED = 64


class Command(NamedTuple):
    """A command that is for us; `params` are its seven numbers, any of which may be NaN."""

    number: int
    params: tuple[float, ...]
    source: Source
    peer: Hashable


Handler = Callable[[Command], Verdict]


class Commands:
    """Dispatches commands to those that registered for them, and acknowledges every one.

    Repeated commands are idempotent: one that says itself that it is a repetition (`confirmation` above 0), or that
    the network doubled, gets the answer of the first and is not carried out again once it was accepted. In lockstep,
    where time may stand still between two real commands, only the former counts. Each of `carried_out` is called after
    each command.
    """

    def __init__(self, link: Link, us: Us, lockstep: bool = False) -> None:
        self._link = link
        self._us = us
        self._lockstep = lockstep
        self._handlers: dict[int, Handler] = {}
        self._done: OrderedDict[Hashable, int] = OrderedDict()  # accepted: what came -> tick
        self._polls: dict[int, Callable[[], Verdict]] = {}
        self._pending: dict[Hashable, Command] = {}
        self._slow: set[int] = set()
        self._tick = 0
        self.refused = 0
        self.carried_out: list[Callable[[], None]] = []

    def on(self, number: int, handler: Handler, poll: Callable[[], Verdict] | None = None, slow: bool = False) -> None:
        """Registers who carries out the command `number` (a MAV_CMD).

        A handler may answer IN_PROGRESS; then `poll` tells what became of it, after each control period, until it
        says something else. In lockstep the client is told IN_PROGRESS, so that it lets time run; of a `slow` command,
        which may take seconds, it is told in real time too.
        """
        if slow:
            self._slow.add(number)
        self._handlers[number] = handler
        if poll is not None:
            self._polls[number] = poll

    @property
    def supported(self) -> tuple[int, ...]:
        """The commands that are carried out."""
        return tuple(sorted(self._handlers))

    def handle(self, received: Received) -> bool:
        """Carries a command out and answers."""
        name = received.message.get_type()
        if name not in ("COMMAND_LONG", "COMMAND_INT"):
            return False
        got, sender = received.message, source(received)
        if self._us.addressed(got, everybody=True) and sender != tuple(self._us):
            last = (got.param5, got.param6) if name == "COMMAND_LONG" else (float(got.x), float(got.y))
            final = got.param7 if name == "COMMAND_LONG" else got.z
            params = (got.param1, got.param2, got.param3, got.param4, *last, final)
            command = Command(got.command, params, sender, received.peer)
            self._answer(command, self._verdict(command, received))
            for call in self.carried_out:
                call()
        return True

    def after(self, step: Step) -> None:
        """Answers what was still in progress."""
        self._tick = step.tick
        if self._pending:
            self.poll()

    def poll(self) -> None:
        """Answers what was in progress and is done."""
        if self._pending:
            for key, command in [*self._pending.items()]:
                verdict = self._polls[command.number]()
                if verdict.result != IN_PROGRESS:
                    del self._pending[key]
                    self._answer(command, verdict)

    def restart(self) -> None:
        """Time begins anew."""
        self._tick = 0
        self._done.clear()
        self._pending.clear()

    def explain(self, peer: Hashable, why: str) -> None:
        """Tells a peer in words why something was refused."""
        self.refused += 1
        for piece in statustext(why, WARNING, self.refused % 0xFFFF + 1) if why else ():
            self._link.send(piece, peer)

    def _verdict(self, command: Command, received: Received) -> Verdict:
        handler = self._handlers.get(command.number)
        if handler is None:
            return Verdict(UNSUPPORTED)
        if (command.source, command.number) in self._pending:
            return Verdict(IN_PROGRESS)
        # As text, since NaN equals nothing.
        what = (command.peer, command.source, command.number, str(command.params))
        repeats: Any = getattr(received.message, "confirmation", 0)
        copy = (what, received.frame.sequence)
        for key, counts in ((what, repeats), (copy, not self._lockstep)):
            done = self._done.get(key)
            if counts and done is not None and 0 <= self._tick - done <= REPEATED_TICKS:
                return Verdict(ACCEPTED)
        verdict = handler(command)
        if verdict.result in (ACCEPTED, IN_PROGRESS) and command.number not in _ANSWERED_AGAIN:
            for key in (what, copy):
                self._done[key] = self._tick
                self._done.move_to_end(key)
            while len(self._done) > MOST_REMEMBERED:
                self._done.popitem(last=False)
        return verdict

    def _answer(self, command: Command, verdict: Verdict) -> None:
        pending = verdict.result == IN_PROGRESS and command.number in self._polls
        if pending:
            self._pending[command.source, command.number] = command
        if pending and not self._lockstep and command.number not in self._slow:
            return
        system, component = command.source
        there = {"target_system": system, "target_component": component}
        self._link.send(message("COMMAND_ACK", command=command.number, result=verdict.result, **there), command.peer)
        if verdict.result not in (ACCEPTED, IN_PROGRESS):
            self.explain(command.peer, verdict.text)


# Those that ask for something are answered as often as they come.
_ANSWERED_AGAIN = frozenset({410, 510, 511, 512, 519, 520, 528})
