"""Virtual drones on this computer: flight controllers, companions and the page, supervised until they are ended."""

import asyncio
import errno
import os
import signal
import socket
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import dataclass, field
from typing import Any, Self

from twodof.errors import LinkError
from twodof.fleet.local_drone import FLIES, ControllerReport, LocalDrone, wait_until_heard
from twodof.fleet.virtual_drone import child_error, indented_lines
from twodof.link.signing import Key

MOST_RESTARTS = 3
"""Restarts allowed within `WITHIN_S`. After one more the whole fleet ends."""

WITHIN_S = 60.0
AGAIN_S = 0.5
"""Pause before a restart [s]."""

ANSWER_S = 60.0
"""Deadline for the first heartbeat [s]; the first process compiles the flight code and the rig."""

END_S = 10.0
"""Time a process has to end and write its logs [s]. It is killed afterwards."""

_LAST_LINES = 8


@dataclass
class ChildProcess:
    """Child process that runs `twodof ARGUMENTS` with this Python, and is reached at `url`.

    `listening` is set when the process reports that it listens; `output` keeps its last lines since then. `environment`
    is added to ours.
    """

    name: str
    arguments: Sequence[str]
    url: str
    drone: LocalDrone | None = None
    environment: Mapping[str, str] = field(default_factory=dict)
    process: asyncio.subprocess.Process | None = None
    ended: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_RESTARTS + 1))
    said: deque[str] = field(default_factory=lambda: deque(maxlen=_LAST_LINES))
    listening: asyncio.Event = field(default_factory=asyncio.Event)

    async def start(self) -> None:
        """Start the process. It ends with this one, which holds the other end of its standard input."""
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
            start_new_session=True,  # Ctrl-C reaches the parent alone, which ends its children in order
            env=os.environ | self.environment if self.environment else None,
        )

    async def wait(self) -> int:
        """Read the process's output until it ends; return its exit status."""
        if self.process is None or self.process.stdout is None:
            return 0
        while line := await self.process.stdout.readline():
            text = line.decode(errors="replace").rstrip()[:500]
            if text.startswith("listening on"):
                self.listening.set()
                self.said.clear()
            elif not text.startswith(FLIES):  # the report at the start is not the reason of an exit
                self.said.append(text)
        return await self.process.wait()

    async def may_restart(self, status: int, tell: Callable[[str], None], consequence: str) -> bool:
        """Report the end of the process by `tell`; return True after a pause, False if the process ended too often.

        `consequence` completes the report in that case: "the whole fleet ends".
        """
        self.ended.append(asyncio.get_running_loop().time())
        often = len(self.ended) > MOST_RESTARTS and self.ended[-1] - self.ended[0] < WITHIN_S
        # The last lines of a process that was killed from outside do not tell the reason.
        last = f"; last output:{indented_lines(self.said)}" if self.said and status != -signal.SIGKILL else ""
        what = f", too often: {consequence}" if often else " and is restarted"
        tell(f"{self.name} ended with status {status}{what}{last}")
        if not often:
            await asyncio.sleep(AGAIN_S)
        return not often

    async def end(self) -> None:
        """Terminate the process, and kill it after `END_S`."""
        process = self.process
        if process is None or process.returncode is not None:
            return
        process.terminate()
        try:
            await asyncio.wait_for(process.wait(), END_S)
        except TimeoutError:
            process.kill()
            with suppress(TimeoutError):  # a process of its own may hold its output
                await asyncio.wait_for(process.wait(), END_S)


class LocalFleet:
    """Drones on this computer, as an async context manager. `given` are options of `twodof fcu` for each of them.

    A process that ends is restarted after `AGAIN_S`, at most `MOST_RESTARTS` times within `WITHIN_S`. `tell` is called
    with one line for people at each such event. `reports` has the active controller of each drone, by index.
    """

    def __init__(
        self, drones: Sequence[LocalDrone], given: Sequence[str], key: Key | None, tell: Callable[[str], None]
    ) -> None:
        self.reports: dict[int, ControllerReport] = {}
        self._key = key
        self._tell = tell
        self._children: list[ChildProcess] = []
        for drone in drones:
            fcu, companion = ["fcu", *drone.options, *drone.controller_options, *given], ["companion", *drone.options]
            self._children += [
                ChildProcess(f"flight controller {drone.system}", fcu, drone.fcu, drone),
                ChildProcess(f"companion {drone.system}", companion, drone.companion, drone),
            ]

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.gather(*(child.end() for child in reversed(self._children)))

    async def start(self) -> None:
        """Start every process and wait for its heartbeat. Raises LinkError for the first process without one."""
        async with _tasks(*map(self._begin, self._children)) as starting:
            await asyncio.gather(*starting)

    async def run(self) -> None:
        """Restart processes that end; return when one ended too often."""
        async with _tasks(*map(self._keep, self._children)) as keeping:
            await _first(keeping)

    async def _begin(self, child: ChildProcess) -> None:
        await child.start()
        async with _tasks(self._answers(child), child.wait()) as (answering, ending):
            if await _first([answering, ending]) is ending:
                raise child_error(list(child.said), child.name, ending.result())

    async def _answers(self, child: ChildProcess) -> None:
        await child.listening.wait()  # before that, another program may answer at the same port
        assert child.drone is not None
        found = await wait_until_heard(child.url, child.drone.system, ANSWER_S, self._key)
        if child.url == child.drone.fcu:
            self.reports[child.drone.index] = found
            # --fresh counts once: a restarted drone keeps the controllers that were sent to it.
            child.arguments = [one for one in child.arguments if one != "--fresh"]

    async def _keep(self, child: ChildProcess) -> None:
        while await child.may_restart(await child.wait(), self._tell, "the whole fleet ends"):
            try:
                await self._begin(child)
            except LinkError as error:
                self._tell(str(error))
                await child.end()
            else:
                self._tell(f"{child.name} answers again")


@asynccontextmanager
async def _tasks(*work: Coroutine[Any, Any, Any]) -> AsyncIterator[list[asyncio.Task[Any]]]:
    """Run `work` as tasks; cancel the unfinished ones at the end of the block."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _first(tasks: Sequence[asyncio.Task[Any]]) -> asyncio.Task[Any]:
    """Return the first of `tasks` that ended, in their order. Raises its error."""
    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    first = next(task for task in tasks if task.done())
    first.result()
    return first


PAGE_ANSWER_S = 40.0
"""Deadline for the server to listen [s]."""


class LocalPage:
    """Server of the page for the drones at `urls`, at `port`, as an async context manager.

    A server that ends is restarted with the same port and tokens, so that links stay valid. After too many restarts
    `tell` reports it, and the drones go on without a page. `options` are passed to `twodof lab`; `environment` carries
    the tokens.
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
        self._child = ChildProcess("the page's server", arguments, f"http://127.0.0.1:{port}", None, environment)
        self._tell_all, self._secrets = tell, [secret for secret in environment.values() if secret]
        self._keeping: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._keeping = asyncio.create_task(self._keep())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
            await asyncio.gather(self._keeping, return_exceptions=True)
        await self._child.end()

    def _tell(self, line: str) -> None:
        """Report a line without the tokens that the server printed in its links."""
        for secret in self._secrets:
            line = line.replace(secret, "...")
        self._tell_all(line)

    async def listens(self) -> bool:
        """Wait until the server listens, fails or takes too long. Return True if it listens."""
        assert self._keeping is not None
        listening = asyncio.create_task(self._child.listening.wait())
        await asyncio.wait([listening, self._keeping], timeout=PAGE_ANSWER_S, return_when=asyncio.FIRST_COMPLETED)
        listening.cancel()
        return self._child.listening.is_set()

    async def _keep(self) -> None:
        child, goes_on = self._child, True
        while goes_on:
            await child.start()
            status = await child.wait()
            if not child.listening.is_set():  # a restart would fail in the same way
                self._tell(f"the page did not start: {child_error(list(child.said), child.name, status)}")
                return
            goes_on = await child.may_restart(status, self._tell, "the drones go on without a page")


def page_port(wanted: int, host: str) -> int:
    """Return `wanted` if that port of `host` is free, else a free port.

    Raises LinkError if the address cannot be listened on, before any drone is started.
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
