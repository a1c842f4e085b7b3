"""Virtual drones on this computer: flight controllers, companions and the page, supervised until they are ended."""

import asyncio
import errno
import os
import signal
import socket
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager, closing
from dataclasses import dataclass, field
from typing import Any, Self

from twodof.errors import LinkError
from twodof.fleet.children import child_error, indented_lines, lower_priority
from twodof.fleet.local_drone import FLIES, ControllerReport, LocalDrone, wait_until_heard
from twodof.link.signing import Key

MOST_RESTARTS = 3
"""A program that ends more often than this within `WITHIN_S` is not restarted again: all end."""

WITHIN_S = 60.0
AGAIN_S = 0.5
"""Before a program is started again [s]."""

ANSWER_S = 60.0
"""How long a program may take until it is heard [s]: the first one compiles the flight code and the rig."""

END_S = 10.0
"""What programs have to end when they are asked to [s], with logs to write; then they are killed."""

_LAST_LINES = 8


@dataclass
class ChildProcess:
    """One program of a drone, or the page's, reached at `url`: its command line is `twodof ...` by this very Python.

    `listening` is set once it has said that it does, and `said` is what it last said since. `environment` is added to
    ours. With a `niceness` above 0 the drones' programs go before it.
    """

    name: str
    arguments: Sequence[str]
    url: str
    drone: LocalDrone | None = None
    environment: Mapping[str, str] = field(default_factory=dict)
    niceness: int = 0
    process: asyncio.subprocess.Process | None = None
    ended: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_RESTARTS + 1))
    said: deque[str] = field(default_factory=lambda: deque(maxlen=_LAST_LINES))
    listening: asyncio.Event = field(default_factory=asyncio.Event)

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
            env=os.environ | self.environment if self.environment else None,
        )
        if self.niceness:
            lower_priority(self.process.pid, self.niceness)

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


class LocalFleet:
    """`drones`, whose flight controllers are started with the options `given` of `twodof fcu`; for `async with`.

    A program that ends is started again after `AGAIN_S`, `MOST_RESTARTS` times within `WITHIN_S`; after that all are to
    end. `tell` is called with a line for people at each such event. `reports` say what each drone, by index, flies.
    """

    def __init__(
        self, drones: Sequence[LocalDrone], given: Sequence[str], key: Key | None, tell: Callable[[str], None]
    ) -> None:
        self.reports: dict[int, ControllerReport] = {}
        self._key = key
        self._tell = tell
        self._children: list[ChildProcess] = []
        for drone in drones:
            fcu, companion = ["fcu", *drone.options, *drone.own, *given], ["companion", *drone.options]
            self._children += [
                ChildProcess(f"flight controller {drone.system}", fcu, drone.fcu, drone),
                ChildProcess(f"companion {drone.system}", companion, drone.companion, drone),
            ]

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.gather(*(child.end() for child in reversed(self._children)))

    async def start(self) -> None:
        """Starts all, and waits until all answer. Raises LinkError for the first that does not."""
        async with _tasks(*map(self._begin, self._children)) as starting:
            await asyncio.gather(*starting)

    async def run(self) -> None:
        """Keeps all running; returns once one cannot be kept."""
        async with _tasks(*map(self._keep, self._children)) as keeping:
            await _first(keeping)

    async def _begin(self, child: ChildProcess) -> None:
        await child.start()
        async with _tasks(self._answers(child), child.wait()) as (answering, ending):
            if await _first([answering, ending]) is ending:
                raise child_error(list(child.said), child.name, ending.result())

    async def _answers(self, child: ChildProcess) -> None:
        await child.listening.wait()  # else it might be another one at the same port that is heard
        assert child.drone is not None
        found = await wait_until_heard(child.url, child.drone.system, ANSWER_S, self._key)
        if child.url == child.drone.fcu:
            self.reports[child.drone.index] = found
            # Fresh once: one that is started again flies what was sent to it meanwhile.
            child.arguments = [one for one in child.arguments if one != "--fresh"]

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


@asynccontextmanager
async def _tasks(*work: Coroutine[Any, Any, Any]) -> AsyncIterator[list[asyncio.Task[Any]]]:
    """The work as tasks, which have ended when the block has."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _first(tasks: Sequence[asyncio.Task[Any]]) -> asyncio.Task[Any]:
    """The first of `tasks` that ended, in their order. Raises its error."""
    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    first = next(task for task in tasks if task.done())
    first.result()
    return first


NICENESS = 5
"""What flies goes before what shows it."""
PAGE_ANSWER_S = 40.0
"""How long the server may take until it listens [s]."""


class LocalPage:
    """The server of the page for the drones at `urls`, at `port`; for `async with`.

    One that ends is started again, with the same port and tokens, so that the links stay. Where it cannot be kept
    running that is told, and the drones go on without it. `options` are further ones of `twodof lab`, and `environment`
    carries the tokens.
    """

    def __init__(
        self,
        urls: Sequence[str],
        port: int,
        options: Sequence[str],
        environment: Mapping[str, str],
        tell: Callable[[str], None],
    ) -> None:
        connect = [word for url in urls for word in ("--connect", url)]
        arguments = ["lab", "--port", str(port), *connect, *options]
        self._child = ChildProcess(
            "the page's server", arguments, f"http://127.0.0.1:{port}", None, environment, NICENESS
        )
        self._tell = tell
        self._keeping: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._keeping = asyncio.create_task(self._keep())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
            await asyncio.gather(self._keeping, return_exceptions=True)
        await self._child.end()

    async def listens(self) -> bool:
        """Whether it listens, waited for until it does, has failed or takes too long."""
        assert self._keeping is not None
        listening = asyncio.create_task(self._child.listening.wait())
        await asyncio.wait([listening, self._keeping], timeout=PAGE_ANSWER_S, return_when=asyncio.FIRST_COMPLETED)
        listening.cancel()
        return self._child.listening.is_set()

    async def _keep(self) -> None:
        child, clock = self._child, asyncio.get_running_loop()
        while True:
            await child.start()
            status = await child.wait()
            child.ended.append(clock.time())
            first = not child.listening.is_set()
            if first:  # it would fail again
                self._tell(f"there is no page: {child_error(list(child.said), child.name, status)}")
                return
            if len(child.ended) > MOST_RESTARTS and child.ended[-1] - child.ended[0] < WITHIN_S:
                self._tell(f"{child.name} ended with status {status}; too often, the drones go on without a page")
                return
            last = f"; it last said:{indented_lines(child.said)}" if child.said else ""
            self._tell(f"{child.name} ended with status {status}; it is started again{last}")
            await asyncio.sleep(AGAIN_S)


def page_port(wanted: int, host: str) -> int:
    """The port `wanted` of the address `host`, or a free one where somebody has it.

    Raises LinkError where nobody can listen there, told before drones are started for it.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in (wanted, 0):
        with closing(socket.socket(family)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
                probe.listen(1)
            except OSError as refusal:
                if refusal.errno == errno.EADDRINUSE:
                    continue
                what = f"cannot listen: {refusal.strerror or refusal}"
                remedy = "give --host an address of this computer, 127.0.0.1 or 0.0.0.0, and a --page-port from 1024 on"
                raise LinkError(what, f"http://{host}:{port}", remedy) from refusal
            return int(probe.getsockname()[1])
    return wanted
