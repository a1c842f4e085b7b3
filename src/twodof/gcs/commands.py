"""Commands with an answer: sent again until acknowledged, refusals with the drone's own reason."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from itertools import count
from typing import Any

from twodof.errors import LinkError, LinkLost, RefusalReason, Rejected, Timeout, shown
from twodof.gcs.drone_state import StatusTexts
from twodof.gcs.session import RETRY_S, Deadline, DroneSession
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import message

ACCEPTED, IN_PROGRESS = 0, 5
RESULTS = (
    "accepted",
    "it cannot be done now",
    "denied",
    "it does not know how",
    "it failed",
    "in progress",
    "it was cancelled",
    "it takes this as COMMAND_LONG only",
    "it takes this as COMMAND_INT only",
    "it does not know the frame",
    "somebody else is in control",
)
# The drone's words follow its refusal at once; a link with delay needs this long.
WORDS_S = 0.3


def number_of(command: str) -> int:
    """The number of "COMPONENT_ARM_DISARM". Raises LinkError for a name that is none."""
    found = getattr(dialect.load(), f"MAV_CMD_{command}", None)
    if not isinstance(found, int):
        raise LinkError(f"no command {shown(command)}", "MAV_CMD", "see common.xml for their names")
    return found


class CommandSender:
    """Commands to the session's vehicle. One of a kind at a time, as an answer names only its kind.

    `progress` makes the drone's time pass, by a deadline, where it stands still while a command is in progress.
    """

    def __init__(
        self, session: DroneSession, texts: StatusTexts, progress: Callable[[Deadline], Awaitable[None]]
    ) -> None:
        self._session = session
        self._texts = texts
        self._progress = progress
        self._turns: dict[int, asyncio.Lock] = {}
        self.words_follow = False
        """Whether its words come after its refusal, as one of ours says them; PX4 says them before."""
        self._spoken: dict[int, int] = {}  # lines that had come with the latest answer to each command
        self.refusals: dict[str, RefusalReason] = {}
        """The reason of the latest refusal of each kind of message that has no acknowledgement, by its name."""
        session.on(self._answered, "COMMAND_ACK")
        session.on(self._refused, "TWODOF_REFUSED")

    async def run(self, command: str, values: Sequence[float], timeout: float, doing: str) -> Any:
        """Send a command with up to seven `values` and return its COMMAND_ACK once it was accepted.

        Without an answer it is sent again, with a count, as MAVLink wants it; "in progress" lets it take its time
        within `timeout` [s]. Raises Rejected with the drone's reason, LinkLost, Timeout.
        """
        deadline = self._session.deadline(timeout, doing)
        number = number_of(command)
        turn = self._turns.setdefault(number, asyncio.Lock())
        async with deadline.turn(turn, "another call of the same kind did not end in time"):
            return await self._run(number, values, deadline)

    async def _run(self, number: int, values: Sequence[float], deadline: Deadline) -> Any:
        session, spoken = self._session, self._texts.count
        with session.listen("COMMAND_ACK") as heard:
            progress = False
            for attempt in count():
                if not progress:
                    session.send(self.long(number, values, attempt))
                until = min(deadline.end, session.now + RETRY_S)
                while (got := await heard.next(until)) is not None:
                    if got.command == number and self._is_ours(got):
                        if got.result == ACCEPTED:
                            return got
                        if got.result != IN_PROGRESS:
                            # What was said before the answer may be about another command.
                            spoken = self._spoken[number] if self.words_follow else spoken
                            raise await self._refusal(got, spoken, deadline)
                        progress = True
                    if progress:
                        await self._progress(deadline)
                    deadline.check()
                deadline.check()
        raise deadline.error()

    def _answered(self, got: Any) -> None:
        if got.command in self._turns:
            self._spoken[got.command] = self._texts.count

    def _refused(self, got: Any) -> None:
        kind = dialect.load().mavlink_map.get(got.message_id)
        if kind is not None and self._is_ours(got):
            self.refusals[kind.msgname] = RefusalReason.of(got.reason)

    def long(self, number: int, values: Sequence[float], attempt: int = 0) -> Any:
        """The COMMAND_LONG of a command."""
        params = {f"param{k}": float(value) for k, value in enumerate(values, 1)}
        return message("COMMAND_LONG", command=number, confirmation=min(attempt, 255), **self._session.target, **params)

    async def request(self, name: str, deadline: Deadline, retry_s: float = RETRY_S) -> Any | None:
        """The vehicle's next message of this name, asked for; None where it refuses. Raises Timeout, LinkLost."""
        asked = number_of("REQUEST_MESSAGE")

        def accept(got: Any) -> tuple[Any] | None:
            if got.get_type() == name:
                return (got,)
            return (None,) if got.command == asked and got.result not in (ACCEPTED, IN_PROGRESS) else None

        question = partial(self.request_of, name)
        return (await self._session.ask(question, (name, "COMMAND_ACK"), accept, deadline, retry_s))[0]

    def request_of(self, name: str, attempt: int = 0) -> Any:
        """What asks the vehicle for its message of this name."""
        return self.long(number_of("REQUEST_MESSAGE"), [dialect.message_id(name)], attempt)

    def _is_ours(self, got: Any) -> bool:
        connection = self._session.connection
        return got.target_system in (0, connection.system) and got.target_component in (0, connection.component)

    async def _refusal(self, got: Any, spoken: int, deadline: Deadline) -> Rejected:
        result = got.result
        words = RESULTS[result] if result < len(RESULTS) else f"result {result}"
        said = await self.words(spoken, deadline)
        where = f"drone {self._session.system}, {deadline.doing}"
        code = (
            RefusalReason.of(got.result_param2) if self.words_follow else RefusalReason.OTHER
        )  # PX4 has codes of its own
        return Rejected(said or words, where, _REMEDIES.get(result, ""), code)

    async def words(self, spoken: int, deadline: Deadline) -> str:
        """What the drone said since it had said `spoken` lines, waiting a moment for it; "" if it says nothing.

        It says nothing where something else is heard in that moment: one that stands still says neither.
        """
        session, before = self._session, self._session.taken
        until = min(deadline.end, session.now + WORDS_S)
        with session.listen("STATUSTEXT") as heard:
            try:
                while not (lines := self._texts.reasons_since(spoken)):
                    if await heard.next(until) is None:
                        if session.taken > before or deadline.left <= 0.0:
                            return ""
                        until = min(deadline.end, session.now + WORDS_S)
            except (LinkLost, Timeout):
                return ""
        return "; ".join(line.text for line in lines[-3:])


_REMEDIES = {
    1: "put right what it says and try again",
    3: "this drone's firmware has no such command",
    10: "wait until they have finished, or watch without taking the lease",
}
