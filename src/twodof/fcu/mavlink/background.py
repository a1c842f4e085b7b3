"""Work that touches the disk, done by a thread of its own, so that the control loop never waits for it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from typing import NamedTuple, Self

from twodof.errors import TwodofError

MOST_WAITING = 64

Work = Callable[[], object]
Done = Callable[[object], None]


class _Tried:
    """Keeps what was raised inside, so that it can be raised in another thread; but not what ends a program."""

    def __init__(self) -> None:
        self.fault: Exception | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, raised: object, _trace: object) -> bool:
        self.fault = raised if isinstance(raised, Exception) else None
        return self.fault is not None


class _Fault(NamedTuple):
    """What work raised that it must not."""

    exception: Exception


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
        self._finished: deque[tuple[Done, object]] = deque()
        self._waiting = 0
        self._thread: threading.Thread | None = None

    def submit(self, work: Work, done: Done) -> bool:
        """Has `work` done; False, and nothing is done, where too much waits already."""
        if self._inline:
            _hand_over(done, _result(work))
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
            _hand_over(done, result)

    def _run(self) -> None:
        while True:
            work, done = self._wanted.get()
            self._finished.append((done, _result(work)))


def _result(work: Work) -> object:
    result: object = None
    with _Tried() as tried:
        result = work()
    if tried.fault is None or isinstance(tried.fault, (OSError, TwodofError)):
        return result if tried.fault is None else tried.fault
    return _Fault(tried.fault)


def _hand_over(done: Done, result: object) -> None:
    if not isinstance(result, _Fault):
        done(result)
        return
    done(OSError(f"the program itself has a fault: {result.exception!r}"))
    raise result.exception
