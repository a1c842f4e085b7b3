"""Work that touches the disk, done by a thread of its own, so that the control loop never waits for it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue

from twodof.errors import TwodofError

MOST_WAITING = 64

Work = Callable[[], object]
Done = Callable[[object], None]


class Background:
    """Does work in order and hands each result to `done` in `poll`, in the thread that polls.

    A result that is an OSError or a TwodofError is one that the work raised. With `inline` the work is done at once: in
    lockstep nobody waits for the clock, and ticks may stand still.
    """

    def __init__(self, inline: bool = False) -> None:
        self._inline = inline
        self._wanted: SimpleQueue[tuple[Work, Done]] = SimpleQueue()
        self._finished: deque[tuple[Done, object]] = deque()
        self._waiting = 0
        self._thread: threading.Thread | None = None

    def submit(self, work: Work, done: Done) -> bool:
        """Has `work` done; False, and nothing is done, where too much waits already."""
        if self._inline:
            done(_result(work))
            return True
        if self._waiting >= MOST_WAITING:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="files", daemon=True)
            self._thread.start()
        self._waiting += 1
        self._wanted.put((work, done))
        return True

    def poll(self) -> None:
        """Hands over what is finished."""
        while self._finished:
            done, result = self._finished.popleft()
            self._waiting -= 1
            done(result)

    def _run(self) -> None:
        while True:
            work, done = self._wanted.get()
            self._finished.append((done, _result(work)))


def _result(work: Work) -> object:
    try:
        return work()
    except (OSError, TwodofError) as fault:
        return fault
