"""What the drone says in words: STATUSTEXT, put together where a line came in pieces."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from twodof.gcs.session import Session

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
KEPT = 1000
MOST_PIECES = 20
_PIECE_BYTES = 50


class Text(NamedTuple):
    """A line from the drone: `number` counts them, `severity` is syslog's in words."""

    number: int
    severity: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.text}"


class Texts:
    """The last KEPT lines, the oldest first."""

    def __init__(self, session: Session) -> None:
        self.lines: deque[Text] = deque(maxlen=KEPT)
        self.count = 0
        self.listeners: list[Callable[[Text], None]] = []
        self._pieces: dict[int, str] = {}
        self._number = 0
        session.on(self._take, "STATUSTEXT")

    @contextmanager
    def listening(self, listener: Callable[[Text], None]) -> Iterator[None]:
        """Tell `listener` of each line meanwhile."""
        self.listeners.append(listener)
        try:
            yield
        finally:
            self.listeners.remove(listener)

    def since(self, count: int) -> list[Text]:
        """Lines that came after the first `count`."""
        return [line for line in self.lines if line.number >= count]

    def note(self, severity: str, text: str) -> None:
        """A line of our own about the drone, among its own."""
        line = Text(self.count, severity, text)
        self.lines.append(line)
        self.count += 1
        for listener in [*self.listeners]:
            listener(line)

    def _take(self, got: Any) -> None:
        text = got.text if isinstance(got.text, str) else bytes(got.text).decode("utf-8", "replace")
        if got.id:
            if got.id != self._number:
                self._number, self._pieces = got.id, {}
            if got.chunk_seq < MOST_PIECES:
                self._pieces[got.chunk_seq] = text
            if len(text) == _PIECE_BYTES:
                return
            text, self._pieces = "".join(self._pieces[at] for at in sorted(self._pieces)), {}
        severity = SEVERITIES[got.severity] if got.severity < len(SEVERITIES) else "info"
        self.note(severity, "".join(c if c.isprintable() else " " for c in text).strip())
