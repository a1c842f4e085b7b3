"""Work beside the control loop: on the disk by a thread of its own, and much sending in small portions."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import TypeVar

from twodof.errors import TwodofError

MOST_WAITING = 64

Work = Callable[[], object]
Done = Callable[[object], None]


def read_block(path: Path, at: int, size: int) -> bytes:
    """Read at most `size` bytes of a file from `at`. Raises OSError."""
    with path.open("rb") as file:
        file.seek(at)
        return file.read(size)


class _Attempt:
    """Work done once: what it returned, or raised, for another thread to take; but not what ends a program."""

    def __init__(self, work: Work, done: Done) -> None:
        self._done = done
        self._result: object = None
        self._fault: Exception | None = None
        with self:
            self._result = work()

    def __enter__(self) -> None:
        """Begin the attempt."""

    def __exit__(self, _kind: object, raised: object, _trace: object) -> bool:
        self._fault = raised if isinstance(raised, Exception) else None
        return self._fault is not None

    def hand_over(self) -> None:
        fault = self._fault
        if fault is None or isinstance(fault, (OSError, TwodofError)):
            self._done(self._result if fault is None else fault)
            return
        self._done(OSError(f"the program itself has a fault: {fault!r}"))
        raise fault


class BackgroundWorker:
    """Does work in order and hands each result to `done` in `poll`, in the thread that polls.

    A result that is an OSError or a TwodofError is one that the work raised. Any other exception is a fault of this
    program. Then `done` gets an OSError, so that the client is answered, and `poll` (with `inline`, `submit`) raises
    the exception. That ends the program with the motors off, like a fault of any service.

    With `inline` the work is done at once: in lockstep nobody waits for the clock, and ticks may stand still.
    """

    def __init__(self, inline: bool = False) -> None:
        self._inline = inline
        self._wanted: SimpleQueue[tuple[Work, Done]] = SimpleQueue()
        self._finished: deque[_Attempt] = deque()
        self._waiting = 0
        self._thread: threading.Thread | None = None

    def submit(self, work: Work, done: Done) -> bool:
        """Queue `work`; return False where too much waits already."""
        if self._inline:
            _Attempt(work, done).hand_over()
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
        """Hand over finished work."""
        while self._finished:
            self._waiting -= 1
            self._finished.popleft().hand_over()

    def _run(self) -> None:
        while True:
            self._finished.append(_Attempt(*self._wanted.get()))


PORTION_S = 0.002

T = TypeVar("T")


def shares(most: int, wanting: Sequence[T], turn: int) -> list[tuple[T, int]]:
    """Divide a portion of `most` messages among those that want to send; where they are more, they take turns."""
    count = len(wanting)
    if count <= most:
        return [(one, most // count) for one in wanting]
    return [(wanting[(turn + k) % count], 1) for k in range(most)]


class PacedSender:
    """Calls `portion` until it returns False: nothing more to send.

    In real time `tick`, called after each control period, does; in lockstep the event loop every two milliseconds.
    """

    def __init__(self, portion: Callable[[], bool], lockstep: bool) -> None:
        self._portion = portion
        self._lockstep = lockstep
        self._busy = False

    def start(self) -> None:
        """Begin to send; in lockstep the first portion goes now."""
        if self._lockstep:
            if not self._busy:
                self._by_clock()
        else:
            self._busy = True

    def tick(self) -> None:
        """Send a portion, as a control period has ended."""
        if self._busy and not self._lockstep:
            self._busy = self._portion()

    def _by_clock(self) -> None:
        self._busy = self._portion()
        if self._busy:
            with suppress(RuntimeError):  # outside an event loop `start` is called for each portion
                asyncio.get_running_loop().call_later(PORTION_S, self._by_clock)
                return
            self._busy = False
