"""Commands: COMMAND_LONG and COMMAND_INT in, one COMMAND_ACK out for each; handlers are registered by number."""

from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable
from typing import Any, NamedTuple

from twodof.errors import TwodofError
from twodof.fcu.command.command_lease import DONE, CommandResult, Source, unsupported
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, Steps, Work
from twodof.fcu.mavlink.service import Service, Vehicle, source, target
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import MavCmd, MavResult, MavSeverity
from twodof.link.mavlink.framing import stops_motors
from twodof.link.mavlink.messages import message

_QUESTIONS = (
    *(MavCmd.GET_HOME_POSITION, MavCmd.GET_MESSAGE_INTERVAL, MavCmd.REQUEST_MESSAGE),
    *(MavCmd.REQUEST_PROTOCOL_VERSION, MavCmd.REQUEST_AUTOPILOT_CAPABILITIES),
)
_ANSWERED_AGAIN = (*_QUESTIONS, MavCmd.SET_MESSAGE_INTERVAL)
"""Commands that are carried out as often as they come."""

LATEST_TICKS = 125
"""Ticks within which an equal command is a repetition: half a second."""
MOST_REMEMBERED = 64


class ReceivedCommand(NamedTuple):
    """Command to this drone; any of its seven numbers `params` may be NaN.

    `repeated`: by its `confirmation` it was sent before and got no answer.
    """

    number: int
    params: tuple[float, ...]
    source: Source
    peer: Hashable
    repeated: bool = False

    @property
    def what(self) -> Hashable:
        """Return a key of the whole command; the numbers as text, since NaN equals nothing."""
        return self.peer, self.source, self.number, str(self.params)


class CommandHandled(NamedTuple):
    """Event: a command was carried out and answered."""


Answering = Generator[Work, Any, CommandResult]
"""Steps to the answer of a command: disks are accessed in the background."""
Handler = Callable[[ReceivedCommand], CommandResult | Answering]


class CommandService(Service):
    """Dispatcher of commands to their handlers; it acknowledges every command.

    A repeated command gets the answer of the first and is not carried out again, unless it stops motors. A command is
    repeated if its sender says so (`confirmation` above 0), or if the network doubled its frame, which the frame's
    sequence number tells. In lockstep, where time may stand still between two equal sessions of a client, only the
    former counts. CommandHandled is published after each command.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._handlers: dict[int, Handler] = {}
        self._polls: dict[int, Callable[[ReceivedCommand], CommandResult]] = {}
        self._background = BackgroundWorker(inline=vehicle.lockstep)
        self._slow: set[int] = set()
        self.restart()

    def on(
        self,
        number: MavCmd,
        handler: Handler,
        poll: Callable[[ReceivedCommand], CommandResult] | None = None,
        slow: bool = False,
    ) -> None:
        """Register the handler of a command, which returns the answer, or steps to it.

        A handler may answer IN_PROGRESS. Then `poll` is called after each control period until it returns another
        result. In lockstep IN_PROGRESS is sent to the client, so that it lets time run; for a `slow` command, which may
        take seconds, also in real time.
        """
        if slow:
            self._slow.add(number)
        self._handlers[number] = handler
        if poll is not None:
            self._polls[number] = poll

    @property
    def supported(self) -> tuple[int, ...]:
        """Return the numbers of the commands that have a handler."""
        return tuple(sorted(self._handlers))

    def handle(self, received: Received) -> bool:
        """Carry a command out and answer."""
        name = received.message.get_type()
        if name not in ("COMMAND_LONG", "COMMAND_INT"):
            return False
        got, sender, vehicle = received.message, source(received), self._vehicle
        stops = stops_motors(got.command, got.param1)
        # What comes under our own number is our own, come round, and ignored as in PX4. We send no stop. Of commands to
        # system 0 questions and stops alone are for us: one careless client would arm a whole laboratory.
        if (stops or sender != vehicle.address) and vehicle.addressed(got, stops or got.command in _QUESTIONS):
            last = (
                (got.param5, got.param6, got.param7) if name == "COMMAND_LONG" else (float(got.x), float(got.y), got.z)
            )
            params = (got.param1, got.param2, got.param3, got.param4, *last)
            repeated = getattr(got, "confirmation", 0) > 0
            command = ReceivedCommand(got.command, params, sender, received.peer, repeated)
            result = self._carried_out(command, received)
            if result is not None:
                self.acknowledge(command, result)
            vehicle.bus.publish(CommandHandled())
        return True

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick
        self._background.poll()
        if self._pending:
            self.poll()

    def poll(self) -> None:
        """Answer commands that were in progress and are done."""
        for command, sequence in [*self._pending.values()]:
            poll = self._polls.get(command.number)
            if poll is not None and not (result := poll(command)).in_progress:
                self._end(command, sequence, result)

    def restart(self) -> None:
        self._tick = 0
        self._done: OrderedDict[Hashable, int] = OrderedDict()  # what was carried out, with the tick
        self._pending: dict[Hashable, tuple[ReceivedCommand, int]] = {}

    def acknowledge(self, command: ReceivedCommand, result: CommandResult) -> None:
        """Send COMMAND_ACK for a command, also for one that came in another message, such as SET_MODE."""
        if command.what in self._pending and not self._vehicle.lockstep and command.number not in self._slow:
            return
        answer = {"command": command.number, "result": result.result, "result_param2": result.reason}
        self._vehicle.send(message("COMMAND_ACK", **answer, **target(command.source)), command.peer)
        if not result.accepted and not result.in_progress:
            # QGroundControl opens a message box for an error or worse; the others it only lists.
            arms = command.number == MavCmd.COMPONENT_ARM_DISARM
            self._vehicle.explain(command.peer, result.text, MavSeverity.CRITICAL if arms else MavSeverity.WARNING)

    def _end(self, command: ReceivedCommand, sequence: int, result: CommandResult) -> None:
        """Answer a command that was in progress."""
        if self._pending.pop(command.what, None) is not None:
            if result.accepted:
                self._remember(command.what, sequence)
            self.acknowledge(command, result)

    def _completed(self, command: ReceivedCommand, sequence: int, answering: Answering) -> Steps:
        self._end(command, sequence, (yield from answering))

    def _carried_out(self, command: ReceivedCommand, received: Received) -> CommandResult | None:
        """Carry out a command and return the answer, None if it comes later."""
        handler = self._handlers.get(command.number)
        if handler is None:
            return unsupported()
        what, sequence = command.what, received.frame.sequence
        if what in self._pending:
            return CommandResult(MavResult.IN_PROGRESS)
        # What stops motors is carried out as often as it comes: somebody may have armed in between.
        copies = [what] if command.repeated else []
        copies += [] if self._vehicle.lockstep else [(what, sequence)]
        again = any(0 <= self._tick - self._done.get(copy, self._tick + 1) <= LATEST_TICKS for copy in copies)
        if again and not stops_motors(command.number, command.params[0]):
            return DONE
        result = handler(command)
        if isinstance(result, Generator):
            self._pending[what] = command, sequence
            self._background.carry_out(self._completed(command, sequence, result))
            return None
        if result.in_progress and command.number in self._polls:
            self._pending[what] = command, sequence
        elif result.accepted and command.number not in _ANSWERED_AGAIN:
            self._remember(what, sequence)
        return result

    def _remember(self, what: Hashable, sequence: int) -> None:
        """Remember that a command was carried out."""
        for key in (what, (what, sequence)):
            self._done[key] = self._tick
            self._done.move_to_end(key)
        while len(self._done) > MOST_REMEMBERED:
            self._done.popitem(last=False)


LOOK_TICKS = 250


class StatusTextService(Service):
    """Service that sends the commander's remarks as STATUSTEXT. It consumes those of others, which are not for us."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, {"STATUSTEXT": None})
        self._number = 0

    def after(self, step: ControlStep) -> None:
        remarks = self._vehicle.commander.remarks
        if remarks:
            told = remarks[:]
            remarks.clear()
            for severity, text in told:
                self._vehicle.say(text, severity, self._number)
                self._number += 1


class StorageMonitor(Service):
    """Service that remarks, once each, that parameters or logs cannot be written; it looks once a second."""

    def __init__(self, vehicle: Vehicle, log: OnboardLogger | None) -> None:
        super().__init__(vehicle)
        self._log = log
        self._said: dict[str, str] = {}
        self._dropped = 0

    def after(self, step: ControlStep) -> None:
        if step.tick % LOOK_TICKS:
            return
        self._look("parameters are not stored", self._vehicle.store.failure)
        if self._log is not None:
            self._look("no on-board log", self._log.failure)
            count, self._dropped = self._log.dropped - self._dropped, self._log.dropped
            if count:
                slow = f"on-board log: the disk is too slow, {count} steps are missing"
                self._vehicle.commander.remarks.append((MavSeverity.WARNING, slow))

    def _look(self, what: str, failure: TwodofError | None) -> None:
        said, now = self._said.get(what), "" if failure is None else str(failure)
        if now and now != said:
            self._vehicle.commander.remarks.append((MavSeverity.ERROR, f"{what}: {now}"))
        self._said[what] = now
