"""Outbox: what one client is still to be sent. It has an end: where the client is slow the oldest rows go, counted."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field

MOST_BYTES = 128 * 1024
"""Of rows that wait for one client: 7 s of 15 columns at the full rate."""
MOST_EVENTS = 500


@dataclass(eq=False)
class StreamState:
    """One subscription of one client: its number, and how many rows it lost so far."""

    number: int
    dropped: int = 0
    ended: bool = False


@dataclass
class Rows:
    """Rows of one subscription that wait: `body` as it is sent, `count` of them."""

    stream: StreamState
    body: bytes
    count: int


@dataclass(eq=False)
class Outbox:
    """Rows and events that wait for one client, the oldest first. Events that do not fit are counted in `missed`."""

    missed: int = 0
    _rows: deque[Rows] = field(default_factory=deque)
    _bytes: int = 0
    _events: deque[str] = field(default_factory=deque)
    _filled: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def waiting(self) -> int:
        """Bytes of rows that wait."""
        return self._bytes

    def put(self, rows: Rows) -> None:
        """Rows to send; where too much waits the oldest are dropped, whosever they are."""
        self._rows.append(rows)
        self._bytes += len(rows.body)
        while self._bytes > MOST_BYTES and len(self._rows) > 1:
            oldest = self._rows.popleft()
            self._bytes -= len(oldest.body)
            oldest.stream.dropped += oldest.count
        self._filled.set()

    def tell(self, text: str) -> None:
        """An event to send."""
        if len(self._events) >= MOST_EVENTS:
            self._events.popleft()
            self.missed += 1
        self._events.append(text)
        self._filled.set()

    async def next(self) -> str | Rows:
        """What to send next, events first; waits until there is something."""
        while True:
            if self._events:
                return self._events.popleft()
            if self._rows:
                rows = self._rows.popleft()
                self._bytes -= len(rows.body)
                if not rows.stream.ended:
                    return rows
                continue
            self._filled.clear()
            await self._filled.wait()
