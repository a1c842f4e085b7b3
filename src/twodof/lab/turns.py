"""Turns at what is scarce: the event loop, a process, a place. Each role has its own, and people take turns in it."""

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

from twodof.errors import Rejected


def greediest(people: Iterable[str]) -> str:
    """Return the person that is named most often, the last one of several; "" if none is named."""
    counted = Counter(people)
    return max(reversed(counted), key=counted.__getitem__, default="")


class Turns:
    """Queue that lets `at_once` requests run at a time; the others wait, and people get their turns in rotation.

    If more than `waiting` requests wait, the latest one of the person with the most is refused. `subject` names what is
    waited for in its error.
    """

    def __init__(self, at_once: int, waiting: int, subject: str) -> None:
        self._free, self._most, self._subject = at_once, waiting, subject
        self._lines: dict[str, deque[asyncio.Future[None]]] = {}

    async def take(self, person: str) -> None:
        """Wait for a turn. Raises Rejected if too many wait."""
        if self._free:
            self._free -= 1
            return
        mine = asyncio.get_running_loop().create_future()
        self._lines.setdefault(person, deque()).append(mine)
        if sum(map(len, self._lines.values())) > self._most:
            waiting = (name for name, line in self._lines.items() for _ in line)
            refusal = Rejected("too many requests wait", self._subject, "try again in a moment")
            refused = self._next(greediest(waiting), latest=True)
            if not refused.done():
                refused.set_exception(refusal)
        try:
            await mine
        except asyncio.CancelledError:
            if not mine.cancelled() and mine.exception() is None:
                self.give_back()
            elif mine in (line := self._lines.get(person, deque())):
                line.remove(mine)
                if not line:
                    del self._lines[person]
            raise

    def give_back(self) -> None:
        """End a turn: the person whose last turn is longest ago gets the next one."""
        while self._lines:
            mine = self._next(next(iter(self._lines)))
            if not mine.done():  # a cancelled one wants none
                mine.set_result(None)
                return
        self._free += 1

    @asynccontextmanager
    async def turn(self, person: str) -> AsyncIterator[None]:
        """Hold a turn in the block. Raises Rejected if too many wait."""
        await self.take(person)
        try:
            yield
        finally:
            self.give_back()

    def _next(self, person: str, latest: bool = False) -> asyncio.Future[None]:
        """Take a request of a person out of the line; all other people come before the person's next one."""
        line = self._lines.pop(person)
        found = line.pop() if latest else line.popleft()
        if line:
            self._lines[person] = line
        return found


TURN_S = 0.0125
"""Time that a turn in the event loop counts [s]; the work itself takes a few milliseconds."""
TURN_BYTES = 64 * 1024
"""Bytes for which a turn counts twice as long."""
EVENT_LOOP_TURNS = 2
"""Turns at once: few, because all of them may begin between two steps of what waits for no turn."""


class Pace:
    """Share of one role in the event loop: pieces of work begin in turns, `EVENT_LOOP_TURNS` in each `TURN_S`."""

    def __init__(self) -> None:
        self._turns = Turns(EVENT_LOOP_TURNS, 10_000, "server")

    async def turn(self, person: str, size: int = 0) -> None:
        """Wait until a piece of work about `size` bytes may begin."""
        await self._turns.take(person)
        asyncio.get_running_loop().call_later(TURN_S * (1 + size / TURN_BYTES), self._turns.give_back)
