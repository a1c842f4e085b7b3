"""Commands with an answer: sent again until acknowledged, refusals with the drone's own reason."""

import asyncio
from collections.abc import Sequence
from functools import partial
from typing import Any

from twodof.errors import LinkError, LinkLost, RefusalReason, Rejected, Timeout, shown
from twodof.gcs.clock import DroneClock
from twodof.gcs.drone_state import StatusTexts, words_of
from twodof.gcs.session import RETRY_S, Deadline, DroneSession
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import message

ACCEPTED, IN_PROGRESS = 0, 5
# The drone's words follow its refusal at once; a link with delay needs this long.
WORDS_S = 0.3


def number_of(command: str) -> int:
    """Return the number of a command such as "COMPONENT_ARM_DISARM". Raises LinkError for an unknown name."""
    found = getattr(dialect.load(), f"MAV_CMD_{command}", None)
    if not isinstance(found, int):
        raise LinkError(f"no command {shown(command)}", "MAV_CMD", "see common.xml for their names")
    return found


class CommandSender:
    """Sender of commands to the session's vehicle, one of a kind at a time, as an answer names only its kind."""

    def __init__(self, session: DroneSession, texts: StatusTexts, clock: DroneClock) -> None:
        self._session, self._texts, self._clock = session, texts, clock
        self._turns: dict[int, asyncio.Lock] = {}
        self._spoken: dict[int, int] = {}  # lines that had come with the latest answer to each command
        self.refusals: dict[str, RefusalReason] = {}
        """The reason of the latest refusal of each kind of message that has no acknowledgement, by its name."""
        session.on(self._answered, "COMMAND_ACK")
        session.on(self._refused, "TWODOF_REFUSED")

    async def run(self, command: str, values: Sequence[float], timeout: float, doing: str) -> Any:
        """Send a command with up to seven `values` and return its COMMAND_ACK once it was accepted.

        Without an answer it is sent again with a count, as MAVLink requires. After the answer "in progress" the call
        waits on, within `timeout` [s]. `doing` describes the request in errors. Raises Rejected with the drone's
        reason, LinkLost, Timeout.
        """
        deadline = self._session.deadline(timeout, doing)
        number = number_of(command)
        turn = self._turns.setdefault(number, asyncio.Lock())
        async with deadline.turn(turn, "another call of the same kind did not end in time"):
            return await self._run(number, values, deadline)

    async def _run(self, number: int, values: Sequence[float], deadline: Deadline) -> Any:
        spoken, progress = self._texts.count, False

        def question(attempt: int) -> Any:
            return None if progress else self.long(number, values, attempt)

        def accept(got: Any) -> Any | None:
            nonlocal progress
            if got.command != number or not self._is_ours(got):
                return None
            progress = got.result == IN_PROGRESS
            return None if progress else got

        async def pass_time() -> None:
            if progress:
                await self._clock.one_tick(deadline)

        got = await self._session.ask(question, ("COMMAND_ACK",), accept, deadline, meanwhile=pass_time)
        if got.result != ACCEPTED:
            # Lines before the answer may be about another command. PX4 says its reason before it.
            raise await self._refusal(got, self._spoken[number] if self._session.ours else spoken, deadline)
        return got

    def _answered(self, got: Any) -> None:
        if got.command in self._turns:
            self._spoken[got.command] = self._texts.count

    def _refused(self, got: Any) -> None:
        kind = dialect.load().mavlink_map.get(got.message_id)
        if kind is not None and self._is_ours(got):
            self.refusals[kind.msgname] = RefusalReason.of(got.reason)

    def long(self, number: int, values: Sequence[float], attempt: int = 0) -> Any:
        """Return the COMMAND_LONG of a command."""
        params = {f"param{k}": float(value) for k, value in enumerate(values, 1)}
        return message("COMMAND_LONG", command=number, confirmation=min(attempt, 255), **self._session.target, **params)

    async def request(self, name: str, deadline: Deadline, retry_s: float = RETRY_S) -> Any | None:
        """Ask for a message and return it; None if the vehicle refuses. Raises Timeout, LinkLost."""
        asked = number_of("REQUEST_MESSAGE")

        def accept(got: Any) -> tuple[Any] | None:
            if got.get_type() == name:
                return (got,)
            return (None,) if got.command == asked and got.result not in (ACCEPTED, IN_PROGRESS) else None

        question = partial(self.request_of, name)
        return (await self._session.ask(question, (name, "COMMAND_ACK"), accept, deadline, retry_s))[0]

    def request_of(self, name: str, attempt: int = 0) -> Any:
        """Return the COMMAND_LONG that asks for a message."""
        return self.long(number_of("REQUEST_MESSAGE"), [dialect.message_id(name)], attempt)

    def _is_ours(self, got: Any) -> bool:
        connection = self._session.connection
        return got.target_system in (0, connection.system) and got.target_component in (0, connection.component)

    async def _refusal(self, got: Any, spoken: int, deadline: Deadline) -> Rejected:
        said = await self.words(spoken, deadline)
        where = f"{self._session.where}, {deadline.doing}"
        # PX4 has codes of its own.
        code = RefusalReason.of(got.result_param2) if self._session.ours else RefusalReason.OTHER
        return Rejected(said or words_of("MAV_RESULT", got.result), where, _REMEDIES.get(got.result, ""), code)

    async def words(self, spoken: int, deadline: Deadline) -> str:
        """Return the drone's lines of text after the first `spoken`, after a moment of waiting; "" if none come.

        Another message in that moment ends the waiting.
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
    1: "remove this cause and try again",
    3: "this drone's firmware has no such command",
    10: "wait until the other client has finished, or watch without taking the lease",
}
