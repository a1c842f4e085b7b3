"""Programs of ours as child processes: started, waited for, restarted by a stated rule, ended within a deadline."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

from twodof.errors import LinkError
from twodof.fleet.active_controller import FLIES
from twodof.fleet.child_output import child_error, indented_lines

MOST_RESTARTS = 3
"""A program that ends more often than this within `WITHIN_S` is not restarted again: all end."""

WITHIN_S = 60.0
AGAIN_S = 0.5
"""Before a program is started again [s]."""

END_S = 10.0
"""What programs have to end when they are asked to [s], with logs to write; then they are killed."""

_LAST_LINES = 8


@dataclass
class ChildProcess:
    """One program: its name, and its command line (`twodof ...` by this very Python).

    `listening` is set once it has said that it does, and `said` is what it last said since.
    """

    name: str
    arguments: Sequence[str]
    process: asyncio.subprocess.Process | None = None
    ended: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_RESTARTS + 1))
    said: deque[str] = field(default_factory=lambda: deque(maxlen=_LAST_LINES))
    listening: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def running(self) -> bool:
        """Whether it runs."""
        return self.process is not None and self.process.returncode is None

    async def start(self) -> None:
        """Starts it. Its standard input is a pipe from here, what it says is kept in `said`."""
        self.said.clear()
        self.listening.clear()
        self.process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "twodof.fleet.child",
            *self.arguments,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            limit=1 << 20,
            start_new_session=True,  # Ctrl-C in the terminal is for us, who end them in order
        )

    async def wait(self) -> int:
        """Its exit status, once it has ended. Until then it takes in what the process says."""
        if self.process is None or self.process.stdout is None:
            return 0
        while line := await self.process.stdout.readline():
            text = line.decode(errors="replace").rstrip()[:500]
            if text.startswith("listening on"):
                self.listening.set()
                self.said.clear()
            elif not text.startswith(FLIES):  # what it says at its start is no reason for its end
                self.said.append(text)
        return await self.process.wait()

    async def end(self) -> None:
        """Asks it to end, and kills it if it still runs after `END_S`."""
        process = self.process
        if process is None or process.returncode is not None:
            return
        process.terminate()
        try:
            await asyncio.wait_for(process.wait(), END_S)
        except TimeoutError:
            process.kill()
            await process.wait()


class ProcessSupervisor:
    """Programs that run until one cannot be kept running, or `end` is called.

    A program that ends is started again after `AGAIN_S`, `MOST_RESTARTS` times within `WITHIN_S`; after that all are to
    end. `tell` is called with a line for people at each such event; `answers` waits until a program that was started
    does its work, and raises LinkError if it does not.
    """

    def __init__(
        self,
        children: Sequence[ChildProcess],
        tell: Callable[[str], None],
        answers: Callable[[ChildProcess], Awaitable[None]],
    ) -> None:
        self.children = list(children)
        self._tell = tell
        self._answers = answers

    async def start(self) -> None:
        """Starts all, and waits until all answer. Raises LinkError for the first that does not."""
        starting = [asyncio.ensure_future(self._begin(child)) for child in self.children]
        try:
            await asyncio.gather(*starting)
        finally:
            for task in starting:
                task.cancel()
            await asyncio.gather(*starting, return_exceptions=True)

    async def _begin(self, child: ChildProcess) -> None:
        await child.start()
        waiting = asyncio.ensure_future(self._answers(child))
        ending = asyncio.ensure_future(child.wait())
        try:
            await asyncio.wait((waiting, ending), return_when=asyncio.FIRST_COMPLETED)
            if waiting.done():
                waiting.result()
            else:
                raise child_error(list(child.said), child.name, ending.result())
        finally:
            waiting.cancel()
            ending.cancel()
            await asyncio.gather(waiting, ending, return_exceptions=True)

    async def run(self) -> ChildProcess:
        """Keeps all running; returns the one that could not be."""
        watchers = {asyncio.ensure_future(self._keep(child)): child for child in self.children}
        try:
            done, _ = await asyncio.wait(watchers, return_when=asyncio.FIRST_COMPLETED)
            first = done.pop()
            first.result()
            return watchers[first]
        finally:
            for watcher in watchers:
                watcher.cancel()
            await asyncio.gather(*watchers, return_exceptions=True)

    async def _keep(self, child: ChildProcess) -> None:
        clock = asyncio.get_running_loop()
        while True:
            status = await child.wait()
            child.ended.append(clock.time())
            # Who was killed from outside said nothing of it.
            last = f"; it last said:{indented_lines(child.said)}" if child.said and status != -signal.SIGKILL else ""
            often = len(child.ended) > MOST_RESTARTS and child.ended[-1] - child.ended[0] < WITHIN_S
            if often:
                self._tell(f"{child.name} ended with status {status}; too often, all end{last}")
                return
            self._tell(f"{child.name} ended with status {status}; it is started again{last}")
            await asyncio.sleep(AGAIN_S)
            try:
                await self._begin(child)
            except LinkError as error:
                self._tell(str(error))
                await child.end()
            else:
                self._tell(f"{child.name} answers again")

    async def end(self) -> None:
        """Ends all within `END_S`; a second time does nothing."""
        await asyncio.gather(*(child.end() for child in reversed(self.children)))
