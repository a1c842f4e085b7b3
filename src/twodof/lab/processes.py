"""Processes beside the server's: a warm one for quick questions, and one for each job, which takes longer.

All of them run `_serve`, started by one fork server that has imported the laboratory. Work is a function of a module;
it returns plain data for JSON. The work of a job gets a function first by which it reports its progress.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import resource
import secrets
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

from twodof.errors import DiagramError, Rejected, Timeout, TwodofError
from twodof.lab.access import LabClient, Role
from twodof.lab.answers import NotThere, dumps

WARM = ("twodof.lab.diagram_work", "twodof.lab.flights", "twodof.lab.log_work", "scipy.linalg", "scipy.optimize")
"""Modules that the fork server imports before the first process begins: it then starts in milliseconds."""
MEMORY = 8 << 30
"""Address space of a workbench's process [bytes]: that of the largest diagram, and of what is imported."""
NICENESS = 10
AT_ONCE = 2
MOST_WAITING = 16
"""Questions to a workbench, and jobs, that may wait for their turn."""
MOST_OF_ONE, MOST_OF_WATCHERS = 6, 12
"""Jobs of one client that only watches, and of all such clients, so that clients that command find a place."""
MOST_KEPT = 50
LONGEST_S = 1800.0
LOOK_S = 0.05
END_S = 1.0
"""How long a process may take to end its compiler and itself."""
TOLD_EVERY_S = 0.05
_REAL_TIME = "__lab_in_real_time__"
Progress = Callable[[float, str], None]
Told = Callable[[float, str, bool], None]
State = Literal["running", "done", "failed", "cancelled"]
Work = TypeVar("Work", bound=Callable[..., object])


def in_real_time(work: Work) -> Work:
    """Declare that the work of a job keeps up with a drone: it begins at once, at full priority."""
    setattr(work, _REAL_TIME, True)
    return work


def _is_in_real_time(work: Callable[..., object]) -> bool:
    return bool(getattr(work, _REAL_TIME, False))


class _Kind(NamedTuple):
    """Kind of process: `background` ones are killed at their end; `nice` ones give way; `memory` bounds it."""

    background: bool
    nice: bool = False
    memory: int = 0


_BENCH = _Kind(background=False, memory=MEMORY)


_Request: TypeAlias = tuple[Callable[..., object], tuple[Any, ...], bool]
"""Work, its arguments, and whether it reports its progress."""


def _serve(talk: Connection, kind: _Kind, first: _Request) -> None:
    """Answer each request by ("done", JSON text) or ("failed", what, where, remedy).

    The first request comes when the process starts: only then its arguments may be events shared between processes.
    """
    # Ctrl-C in the terminal is for the server. A session of its own for a job would get as much as a drone's program.
    if kind.background:
        os.setpgid(0, 0)
    else:
        os.setsid()
        signal.signal(signal.SIGTERM, _end)
    if kind.nice:
        os.nice(NICENESS)
    if kind.memory:
        resource.setrlimit(resource.RLIMIT_AS, (kind.memory, kind.memory))
    last = 0.0

    def progress(fraction: float, text: str = "") -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= TOLD_EVERY_S or fraction >= 1.0:
            last = now
            talk.send(("progress", min(1.0, max(0.0, float(fraction))), str(text)[:500]))

    work, arguments, reports = first
    while True:
        try:
            talk.send(("done", dumps(work(progress, *arguments) if reports else work(*arguments))))
        except TwodofError as error:
            talk.send(("failed", error.what, error.where, error.remedy))
        except (MemoryError, RecursionError):
            talk.send(("failed", "the memory of this computer does not suffice", "", "ask for less"))
        except Exception as fault:  # noqa: BLE001  the next question may be a good one
            text = f"a fault of the program: {type(fault).__name__}: {fault}"[:1000]
            talk.send(("failed", text, "", "report it"))
        try:
            work, arguments, reports = talk.recv()
        except (EOFError, OSError):  # the server has ended
            return


def _end(number: int, frame: FrameType | None) -> None:
    sys.exit(0)


class _Failed(Exception):
    """Failure that the process of some work has told."""

    def __init__(self, what: str, where: str, remedy: str) -> None:
        super().__init__(what)
        self.what, self.where, self.remedy = what, where, remedy


class _WorkProcess:
    """Process for `run`, started with the first work, and again with the next work after `close`."""

    def __init__(self, kind: _Kind) -> None:
        self._kind = kind
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([*WARM])
        self._process: BaseProcess | None = None
        self._talk: Connection | None = None

    async def run(
        self,
        work: Callable[..., object],
        arguments: tuple[Any, ...],
        seconds: float,
        progress: Progress | None = None,
        gone: Callable[[], Awaitable[bool]] | None = None,
    ) -> Any:
        """Return the result of some work. Raises _Failed, TimeoutError, EOFError where the process has ended.

        Raises Rejected where `gone` says that nobody waits for it. The process is ended unless it has answered.
        """
        answered = False
        try:
            async with asyncio.timeout(seconds):
                talk = await self._ask((work, arguments, progress is not None))
                while True:
                    while not await asyncio.to_thread(talk.poll, LOOK_S):
                        if gone is not None and await gone():
                            raise Rejected("the client has left", "", "ask again")
                    kind, *rest = talk.recv()
                    if kind != "progress":
                        break
                    if progress is not None:
                        progress(*rest)
            answered = True
        except OSError as reason:
            if isinstance(reason, TimeoutError):
                raise
            raise EOFError from reason
        finally:
            if not answered:
                with suppress(BaseException):
                    await asyncio.shield(self.close())
        if kind != "done":
            raise _Failed(*rest)
        return json.loads(rest[0])

    async def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        talk, self._talk = self._talk, None
        if talk is not None:
            talk.close()
        if process is None or process.pid is None:
            return
        if not self._kind.background:
            process.terminate()
            await asyncio.to_thread(process.join, END_S)
        process.kill()
        await asyncio.to_thread(process.join, 5.0)

    async def _ask(self, request: _Request) -> Connection:
        if self._process is not None and self._talk is not None and self._process.is_alive():
            self._talk.send(request)
            return self._talk
        await self.close()
        here, there = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(there, self._kind, request), daemon=True)
        self._process, self._talk = process, here
        await asyncio.to_thread(process.start)  # the fork server takes a second to start
        there.close()
        return here


class Workbench:
    """Warm process that answers questions about diagrams or logs one at a time, each within its time.

    `subject` is what the questions are about, and `failure` the error for a wrong one. A question that takes too long,
    or whose client has left, ends the process; the next question gets a new one.
    """

    def __init__(self, subject: str = "diagram", failure: type[TwodofError] = DiagramError) -> None:
        self._subject, self._failure = subject, failure
        self._process = _WorkProcess(_BENCH)
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def do(
        self,
        work: Callable[..., object],
        *arguments: Any,
        seconds: float,
        gone: Callable[[], Awaitable[bool]] | None = None,
    ) -> Any:
        """Return the result of `work(*arguments)`, in its turn.

        `gone` says that the client has left: then it is cancelled. Raises the errors of `work` as `failure`, Timeout
        after `seconds`, Rejected where too many wait, and for a client that has left.
        """
        if self._waiting >= MOST_WAITING:
            raise Rejected("too many wait for the workbench", self._subject, "try again in a moment")
        self._waiting += 1
        try:
            async with self._turn:
                return await self._process.run(work, arguments, seconds, gone=gone)
        except _Failed as failure:
            raise self._failure(failure.what, failure.where or self._subject, failure.remedy) from None
        except TimeoutError:
            raise Timeout(f"it took longer than {seconds:g} s", self._subject, "make it smaller") from None
        except EOFError:
            raise self._failure("the process that reads it has ended", self._subject, "make it smaller") from None
        finally:
            self._waiting -= 1

    async def close(self) -> None:
        """End the process."""
        await self._process.close()


@dataclass
class Job:
    """Progress of a job: `fraction` 0 to 1, `text`, and at its end its `result` or `error`.

    `bound` is True while the job cannot be ended.
    """

    id: str
    kind: str
    state: State = "running"
    fraction: float = 0.0
    text: str = ""
    result: Any = None
    error: dict[str, str] | None = None
    bound: bool = False

    @property
    def over(self) -> bool:
        """True after the job's end."""
        return self.state != "running"

    def told(self, with_result: bool = True) -> dict[str, Any]:
        """Return the job as clients get it."""
        rows = {key: value for key, value in vars(self).items() if not key.startswith("_")}
        return rows if with_result else {key: value for key, value in rows.items() if key != "result"}


class Jobs:
    """Jobs of one server: `AT_ONCE` run, the others wait for their turn, the last `MOST_KEPT` are remembered.

    `tell` gets the event `job` at every change.
    """

    def __init__(self, tell: Callable[[Mapping[str, Any]], None]) -> None:
        self._tell = tell
        self._jobs: dict[str, Job] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._clients: dict[str, LabClient] = {}
        self._turns = asyncio.Semaphore(AT_ONCE)

    @property
    def all(self) -> list[Job]:
        """Remembered jobs, the oldest first."""
        return [*self._jobs.values()]

    def __getitem__(self, name: str) -> Job:
        """Return a job by its id. Raises NotThere."""
        job = self._jobs.get(name)
        if job is None:
            raise NotThere("there is no such job, or it ended long ago", f"job {name[:40]}", "start it again")
        return job

    def start(self, kind: str, work: Callable[..., object], *arguments: Any, client: LabClient | None = None) -> Job:
        """Run `work(progress, *arguments)` in a process of its own; returns at once.

        `work` is a function of a module, its arguments can be pickled, what it returns is plain data for JSON; it
        calls `progress(fraction, text)` as it goes on. What was declared `in_real_time` begins at once. Raises Rejected
        where too many wait already, or where a `client` that only watches has its share.
        """
        if not _is_in_real_time(work):
            self._check_share(client)
        return self._begin(kind, lambda job: self._in_turn(job, work, arguments), client)

    def watch(self, kind: str, work: Callable[[Told], Awaitable[Any]]) -> Job:
        """Follow what the server does itself, such as talking to a drone: `work(told)`; returns at once.

        It calls `told(fraction, text, bound)` as it goes on, and returns plain data. From when on it is `bound`,
        `cancel` refuses.
        """

        async def follow(job: Job) -> None:
            def told(fraction: float, text: str, bound: bool) -> None:
                job.fraction, job.text, job.bound = fraction, text, bound
                self._tell({"event": "job", "job": job.told(with_result=False)})

            result = await work(told)
            job.result, job.fraction, job.text, job.state = json.loads(dumps(result)), 1.0, "", "done"

        return self._begin(kind, follow)

    def _begin(self, kind: str, run: Callable[[Job], Awaitable[None]], client: LabClient | None = None) -> Job:
        job = Job(secrets.token_hex(8), kind, text="waits for its turn")
        self._jobs[job.id] = job
        if client is not None:
            self._clients[job.id] = client
        for old in [one.id for one in self._jobs.values() if one.over][: max(0, len(self._jobs) - MOST_KEPT)]:
            del self._jobs[old]
            self._clients.pop(old, None)
        task = asyncio.create_task(self._run(job, run))
        self._tasks[job.id] = task
        task.add_done_callback(lambda _: self._tasks.pop(job.id, None))
        return job

    def when_over(self, name: str, done: Callable[[Job], None]) -> None:
        """Have `done` called with a job once it is over. Raises NotThere."""
        job, task = self[name], self._tasks.get(name)
        if task is None:
            done(job)
        else:
            task.add_done_callback(lambda _: done(job))

    async def cancel(self, name: str) -> Job:
        """End a job, its process with it; one that is over stays as it is. Raises NotThere, Rejected if it is bound."""
        job = self[name]
        if job.bound and not job.over:
            raise Rejected(f"it cannot be ended now: {job.text}", f"job {job.kind}", "wait for its end")
        await self._end(job)
        return job

    async def close(self) -> None:
        """End all, bound or not."""
        for name in [*self._tasks]:
            await self._end(self[name])

    async def _end(self, job: Job) -> None:
        task = self._tasks.get(job.id)
        if task is not None:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            if not job.over:  # it was cancelled before it had begun to wait for its turn
                job.state, job.text = "cancelled", ""

    def _check_share(self, client: LabClient | None) -> None:
        running = [job.id for job in self._jobs.values() if not job.over]
        if len(running) >= AT_ONCE + MOST_WAITING:
            raise Rejected("too many jobs wait already", "jobs", "wait for one, or cancel one")
        if client is None or client.role is not Role.WATCH:
            return
        theirs = [one for name in running if (one := self._clients.get(name)) is not None and one.role is Role.WATCH]
        if theirs.count(client) >= MOST_OF_ONE:
            raise Rejected(f"{MOST_OF_ONE} jobs of yours run or wait already", "jobs", "wait for one")
        if len(theirs) >= MOST_OF_WATCHERS:
            raise Rejected("too many jobs of those who watch wait already", "jobs", "wait for one")

    async def _in_turn(self, job: Job, work: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        if _is_in_real_time(work):  # who flies does not wait for who computes, a viewer perhaps
            await self._work(job, work, arguments)
        else:
            async with self._turns:
                await self._work(job, work, arguments)

    async def _run(self, job: Job, run: Callable[[Job], Awaitable[None]]) -> None:
        try:
            await run(job)
        except TwodofError as error:
            job.error, job.state = {"what": error.what, "where": error.where, "remedy": error.remedy}, "failed"
        except asyncio.CancelledError:
            if not job.over:
                job.state, job.text = "cancelled", ""
            raise
        except Exception as fault:  # noqa: BLE001  whatever it was, the job has failed and says so
            _fail(job, f"its process could not be run: {fault}", "report it")
        finally:
            self._tell({"event": "job", "job": job.told(with_result=False)})

    async def _work(self, job: Job, work: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        process = _WorkProcess(_Kind(background=True, nice=not _is_in_real_time(work)))
        job.text = ""

        def progress(fraction: float, text: str) -> None:
            job.fraction, job.text = fraction, text
            self._tell({"event": "job", "job": job.told(with_result=False)})

        try:
            result = await process.run(work, arguments, LONGEST_S, progress)
            job.result, job.fraction, job.text, job.state = result, 1.0, "", "done"
        except _Failed as failure:
            _fail(job, failure.what, failure.remedy, failure.where)
        except TimeoutError:
            _fail(job, f"it took longer than {LONGEST_S:g} s", "ask for less")
        except EOFError:
            _fail(job, "its process ended in mid-work: it may have run out of memory", "ask for less")
        finally:
            await process.close()


def _fail(job: Job, what: str, remedy: str, where: str = "") -> None:
    job.state, job.error = "failed", {"what": what, "where": where or f"job {job.kind}", "remedy": remedy}
