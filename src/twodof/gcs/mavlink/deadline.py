"""When a call ends, and how it says that it did not succeed."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from twodof.errors import Timeout


class Deadline:
    """`seconds` from now on the running loop's clock; `doing` and `where` are for the error's text."""

    def __init__(self, seconds: float, doing: str, where: str = "") -> None:
        if not 0.0 <= seconds < 1e7:
            raise ValueError(f"a deadline of {seconds!r} s")
        self.seconds, self.doing, self.where = seconds, doing, where
        self._loop = asyncio.get_running_loop()
        self.end = self._loop.time() + seconds

    @property
    def left(self) -> float:
        """Time that is left [s], never negative."""
        return max(0.0, self.end - self._loop.time())

    def error(self, remedy: str = "ask again, or give it more time") -> Timeout:
        """What to raise once it has passed."""
        return Timeout(f"{self.doing}: no answer within {self.seconds:.3g} s", self.where, remedy)

    @asynccontextmanager
    async def turn(self, lock: asyncio.Lock, remedy: str) -> AsyncIterator[None]:
        """Hold `lock` during the block. Raises Timeout with the `remedy` where it does not become free in time."""
        try:
            async with asyncio.timeout(self.left):
                await lock.acquire()
        except TimeoutError:
            raise self.error(remedy) from None
        try:
            yield
        finally:
            lock.release()

    def check(self) -> None:
        """Raises Timeout once it has passed."""
        if self.left <= 0.0:
            raise self.error()
