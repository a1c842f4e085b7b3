"""Work beside the control loop: disk work in a thread of its own, and long lists sent in small portions."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from twodof.errors import LinkError, TwodofError

MOST_WAITING = 64
BUSY = "too many requests wait"

Work = Callable[[], Any]
Done = Callable[[Any], None]
Steps = Generator[Work, Any, None]
"""Work of a service in steps: what it yields is called in the worker's thread, and it goes on with the result."""


def read_block(path: Path, at: int, size: int) -> bytes:
    """Read at most `size` bytes of a file from `at`. Raises OSError."""
    with path.open("rb") as file:
        file.seek(at)
        return file.read(size)


class BackgroundWorker:
    """Worker thread that runs jobs in order; `poll` calls `done` with each result in the thread that polls.

    An OSError or TwodofError of a job is passed to `done` as its result. Any other exception is a fault of this
    program: `done` gets an OSError, so that the client is answered, and `poll` (with `inline`, `submit`) raises the
    exception. That ends the program with the motors off, like a fault of any service.

    With `inline` a job runs at once: in lockstep ticks may wait, as time does.
    """

    def __init__(self, inline: bool = False) -> None:
        self._inline = inline
        self._wanted: SimpleQueue[tuple[Future[object], Work]] = SimpleQueue()
        self._jobs: deque[tuple[Future[object], Done]] = deque()
        self._thread: threading.Thread | None = None

    def submit(self, work: Work, done: Done) -> bool:
        """Queue `work`; return False if too many jobs wait already."""
        job = Future[object]()
        if self._inline:
            _do(job, work)
            _hand_over(job, done)
            return True
        if len(self._jobs) >= MOST_WAITING:
            return False
        if self._thread is None:  # a pool's thread would hold up the program's end as long as the disk does not answer
            self._thread = threading.Thread(target=self._run, name="files", daemon=True)
            self._thread.start()
        self._jobs.append((job, done))
        self._wanted.put((job, work))
        return True

    def carry_out(self, steps: Steps, result: Any = None) -> None:
        """Run `steps` up to the next work, with the `result` of the last one; each error of a work is raised in them.

        A LinkError is raised in them if too many jobs wait.
        """
        try:
            work = steps.throw(result) if isinstance(result, Exception) else steps.send(result)
        except StopIteration:
            return
        if not self.submit(work, lambda found: self.carry_out(steps, found)):
            self.carry_out(steps, LinkError(BUSY, "files", "try again"))

    def poll(self) -> None:
        """Hand over finished work."""
        while self._jobs and self._jobs[0][0].done():
            _hand_over(*self._jobs.popleft())

    def _run(self) -> None:
        while True:
            _do(*self._wanted.get())


def _do(job: Future[object], work: Work) -> None:
    try:
        job.set_result(work())
    except Exception as fault:  # noqa: BLE001  it is raised where the result is handed over
        job.set_exception(fault)


def _hand_over(job: Future[object], done: Done) -> None:
    fault = job.exception()
    if fault is None or isinstance(fault, (OSError, TwodofError)):
        done(job.result() if fault is None else fault)
        return
    done(OSError(f"the program itself has a fault: {fault!r}"))
    raise fault


PORTION_S = 0.002


class PacedSender:
    """Sender of long series of messages in portions of at most `most` messages, which the clients share in turns.

    `send` is called with the client's key and a message. An iterator yields None while it waits for something. In real
    time `tick`, called after each control period, sends a portion; in lockstep the event loop does every 2 ms.
    """

    def __init__(self, send: Callable[[Any, Any], None], lockstep: bool, most: int) -> None:
        self.most = most
        self._send = send
        self._lockstep = lockstep
        self._running = False
        self._turn = 0
        self.messages: dict[Hashable, Iterator[Any]] = {}
        """What is left to be sent, by client."""

    def start(self, key: Hashable, messages: Iterator[Any]) -> None:
        """Send `messages` to a client, in place of earlier ones that are not sent yet; in lockstep begin now."""
        self.messages[key] = messages
        if self._lockstep and not self._running:
            self._by_clock()

    def stop(self, key: Hashable) -> bool:
        """Stop sending to a client; return whether messages were left."""
        return self.messages.pop(key, None) is not None

    def tick(self) -> None:
        """Send a portion after a control period; in lockstep do nothing."""
        if not self._lockstep:
            self.portion()

    def portion(self) -> bool:
        """Send a portion; return whether there is more."""
        keys = [*self.messages]
        self._turn += self.most
        for number in range(min(self.most, len(keys))):
            key = keys[(self._turn + number) % len(keys)]
            for _ in range(max(1, self.most // len(keys))):
                messages = self.messages.get(key)
                if messages is None:
                    break
                sent = next(messages, self)
                if sent is self and self.messages.get(key) is messages:
                    del self.messages[key]
                if sent is self or sent is None:
                    break
                self._send(key, sent)
        return bool(self.messages)

    def _by_clock(self) -> None:
        self._running = self.portion()
        if self._running:
            with suppress(RuntimeError):  # outside an event loop `start` is called for each portion
                asyncio.get_running_loop().call_later(PORTION_S, self._by_clock)
                return
            self._running = False
