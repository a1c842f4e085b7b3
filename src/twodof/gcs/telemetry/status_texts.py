"""What the drone says in words: STATUSTEXT, put together where a line came in pieces."""

import asyncio
from collections import deque
from typing import Any, NamedTuple

from twodof.gcs.mavlink.session import DroneSession
from twodof.signals import SEVERITIES

KEPT = 1000
MOST_PIECES = 20
_PIECE_BYTES = 50
_WARNING = SEVERITIES.index("warning")
PIECES_S = 0.2
"""How long the next piece of a line is waited for [s]: they are sent together."""


class StatusText(NamedTuple):
    """A line from the drone: `number` counts them, `severity` is syslog's in words."""

    number: int
    severity: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.text}"


class StatusTexts:
    """The last KEPT lines, the oldest first; each is an event of the session too."""

    def __init__(self, session: DroneSession) -> None:
        self.lines: deque[StatusText] = deque(maxlen=KEPT)
        self.count = 0
        self._pieces: dict[int, bytes] = {}
        self._number = self._severity = 0
        self._waiting: asyncio.TimerHandle | None = None
        self._loop = asyncio.get_running_loop()
        self._session = session
        session.on(self._take, "STATUSTEXT")

    def since(self, count: int) -> list[StatusText]:
        """Lines that came after the first `count`."""
        return [line for line in self.lines if line.number >= count]

    def reasons_since(self, count: int) -> list[StatusText]:
        """Those of them that may be the reason of a refusal: what is only told, such as another's change, is not."""
        return [line for line in self.since(count) if SEVERITIES.index(line.severity) <= _WARNING]

    def note(self, severity: str, text: str) -> None:
        """A line of our own about the drone, among its own."""
        line = StatusText(self.count, severity, text)
        self.lines.append(line)
        self.count += 1
        self._session.emit(line)

    def _take(self, got: Any) -> None:
        piece = bytes(got._text_raw).split(b"\0")[0]  # UTF-8, where pymavlink's own field has only what is ASCII
        if got.id != self._number or (got.id == 0 and got.chunk_seq == 0):
            self._end()
            self._number = got.id
        self._severity = got.severity
        if got.chunk_seq < MOST_PIECES:
            self._pieces[got.chunk_seq] = piece
        last = [place for place, one in self._pieces.items() if len(one) < _PIECE_BYTES]
        if last and len(self._pieces) == last[0] + 1:
            self._end()
        elif self._waiting is None:
            # PX4 counts its lines from 0, and ends none that fills its last piece, so both are waited for, a moment.
            self._waiting = self._loop.call_later(PIECES_S, self._end)

    def _end(self) -> None:
        """What came of a line is all of it."""
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None
        line, self._pieces = b"".join(self._pieces[at] for at in sorted(self._pieces)), {}
        if line:
            text = line.decode("utf-8", "replace")
            severity = SEVERITIES[self._severity] if self._severity < len(SEVERITIES) else "info"
            self.note(severity, "".join(c if c.isprintable() else " " for c in text).strip())
