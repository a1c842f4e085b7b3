"""Processes beside the server's: warm ones for quick questions, and one for each job, which takes longer.

All of them run `_serve`, started by one fork server that has imported the laboratory. Work is a function of a module;
it returns plain data for JSON. The work of a job gets a function first by which it reports its progress.
"""

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
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, TypeVar

from twodof.errors import DiagramError, Rejected, Timeout, TwodofError
from twodof.lab.access import CLIENT, LabClient, Role
from twodof.lab.answers import DiskFull, NotThere, dumps, full_disk, refusal_of
from twodof.lab.turns import Turns

WARM = ("twodof.lab.diagram_work", "twodof.lab.flights", "twodof.lab.log_work", "scipy.linalg", "scipy.optimize")
"""Modules that the fork server imports before the first process begins: it then starts in milliseconds."""
MEMORY = 8 << 30
"""Address space of a workbench's process [byte]: enough for the largest diagram and the imported modules."""
NICENESS = 10
AT_ONCE = MappingProxyType({Role.COMMAND: 2, Role.WATCH: 1})
"""Jobs of a role that run at the same time."""
MOST_WAITING = 16
"""Most requests of a role to a workbench, and most jobs of commanding clients, that wait for their turn."""
MOST_OF_ONE, MOST_OF_WATCHERS = 6, 12
"""Most jobs of one client that only watches, and of all such clients."""
MOST_KEPT = 50
"""Jobs of a role that are remembered."""
LONGEST_S = 1800.0
LOOK_S = 0.05
END_S = 1.0
"""Time that a process has to end its compiler and itself [s]."""
TOLD_EVERY_S = 0.05
LONG = 16_000
"""Characters of a result that is read in a thread: the rest of it comes later than its first bytes."""
Progress = Callable[[float, str], None]
Told = Callable[[float, str, bool], None]
Answer = TypeVar("Answer")
State = Literal["running", "done", "failed", "cancelled"]
_Request: TypeAlias = tuple[Callable[..., object], tuple[Any, ...], bool]
"""Work, its arguments, and whether it reports its progress."""


def _serve(talk: Connection, background: bool, nice: bool, first: _Request) -> None:
    """Answer each request by ("done", JSON text) or ("failed", True for a full disk, what, where, remedy).

    The first request comes when the process starts: only then its arguments may be events shared between processes.
    """
    # Ctrl-C in the terminal is for the server. A session of its own gets as much as a drone's program: a flight needs
    # it, and a job that computes must not have it.
    if background and nice:
        os.setpgid(0, 0)
    else:
        os.setsid()
        if nice:
            with suppress(OSError):  # Linux can count niceness within a session only, and that of sessions here
                Path("/proc/self/autogroup").write_text(str(NICENESS))
    if not background:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.nice(NICENESS * nice)
    with open(os.devnull, "w") as nothing:  # noqa: PTH123  the server's parent waits for the end of its output
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
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
            done = dumps(work(progress, *arguments) if reports else work(*arguments))
            if len(done) > LONG:
                talk.send(("long",))
            talk.send(("done", done))
        except (MemoryError, RecursionError):
            talk.send(("failed", False, "the memory of this computer does not suffice", "", "ask for less"))
        except Exception as fault:  # noqa: BLE001  the next question may be a good one
            full = full_disk(fault)
            text = f"a fault of the program: {type(fault).__name__}: {fault}"[:1000]
            own = fault if isinstance(fault, TwodofError) else TwodofError(text, "", "report it")
            error = full or own
            talk.send(("failed", full is not None, error.what, error.where, error.remedy))
        try:
            work, arguments, reports = talk.recv()
        except (EOFError, OSError):  # the server has ended
            return


class _WorkProcess:
    """Process for `run`, started with the first work, and again with the next work after `close`.

    Failures are raised as `failure`, about `where`. A `background` process is killed at its end; `nice` gives it a low
    priority.
    """

    def __init__(self, where: str, failure: type[TwodofError], background: bool, nice: bool = False) -> None:
        self._where, self._failure, self._background, self._nice = where, failure, background, nice
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
        """Return the result of `work(*arguments)`. End the process unless it has answered.

        Raises `failure` for an error of the work or if the process ends, Timeout after `seconds`, Rejected once `gone`
        returns True because the client has left.
        """
        answered = False
        try:
            async with asyncio.timeout(seconds):
                talk = await self._ask((work, arguments, progress is not None))
                while True:
                    while not await _readable(talk):
                        if gone is not None and await gone():
                            raise Rejected("the client has left", "", "send the request again")
                    kind, *rest = talk.recv()
                    if kind == "long":
                        kind, *rest = await asyncio.to_thread(talk.recv)
                    if kind != "progress":
                        break
                    if progress is not None:
                        progress(*rest)
            answered = True
        except TimeoutError:
            raise Timeout(f"the work took longer than {seconds:g} s", self._where, "ask for less") from None
        except (EOFError, OSError):
            what = "the process ended in mid-work: it may have run out of memory"
            raise self._failure(what, self._where, "ask for less") from None
        finally:
            if not answered:
                with suppress(BaseException):
                    await asyncio.shield(self.close())
        if kind == "done":
            return json.loads(rest[0])
        full, what, where, remedy = rest
        raise (DiskFull if full else self._failure)(what, where or self._where, remedy)

    async def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        talk, self._talk = self._talk, None
        if talk is not None:
            talk.close()
        if process is None or process.pid is None:
            return
        if not self._background:
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
        given = (there, self._background, self._nice, request)
        self._process, self._talk = self._context.Process(target=_serve, args=given, daemon=True), here
        await asyncio.to_thread(self._process.start)  # the fork server takes a second to start
        there.close()
        return here


async def _readable(talk: Connection) -> bool:
    """Wait until there is something to read, or for LOOK_S; return True if there is."""
    loop, ready = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(talk.fileno(), ready.set)
    try:
        async with asyncio.timeout(LOOK_S):
            return await ready.wait()
    except TimeoutError:
        return talk.poll()
    finally:
        loop.remove_reader(talk.fileno())


class Workbench:
    """Warm processes, one for each role, that carry out requests about diagrams or logs one at a time.

    `subject` names their subject in errors, `failure` is the class of the errors. A request that takes too long, or
    whose client has left, ends its process; the next request starts a new one. A request may take `seconds`.
    """

    def __init__(
        self, subject: str = "diagram", failure: type[TwodofError] = DiagramError, seconds: float = 10.0
    ) -> None:
        self._seconds = seconds
        self._processes = {
            role: _WorkProcess(subject, failure, background=False, nice=role is Role.WATCH) for role in Role
        }
        self._turns = {role: Turns(1, MOST_WAITING - 1, subject) for role in Role}

    async def do(
        self,
        work: Callable[..., Answer],
        *arguments: Any,
        seconds: float | None = None,
        gone: Callable[[], Awaitable[bool]] | None = None,
    ) -> Answer:
        """Return the result of `work(*arguments)`, in its turn, as JSON values.

        The work is cancelled once `gone` returns True because the client has left. Raises the errors of `work` as
        `failure`, Timeout after `seconds`, Rejected if too many requests wait or the client has left.
        """
        role, person = CLIENT.get()
        async with self._turns[role].turn(person):
            answer: Answer = await self._processes[role].run(work, arguments, seconds or self._seconds, gone=gone)
            return answer

    async def close(self) -> None:
        """End the processes."""
        for process in self._processes.values():
            await process.close()


@dataclass
class Job:
    """Progress of a job: `fraction` 0 to 1, `text`, and at its end its `result` or `error`.

    `last_s` is the time that the last successful job of its kind took [s], None if there was none. `bound` is True
    while the job cannot be cancelled. `client` is the client that started it, if it may only watch. `stop` is the event
    that ends a flight, `about` a key of what a rehearsal was asked.
    """

    id: str
    kind: str
    state: State = "running"
    fraction: float = 0.0
    text: str = "waits for its turn"
    last_s: float | None = None
    result: Any = None
    error: dict[str, str] | None = None
    bound: bool = False
    client: LabClient | None = None
    task: asyncio.Task[None] = field(init=False)
    stop: Event | None = None
    about: str = ""

    @property
    def over(self) -> bool:
        """True after the job's end."""
        return self.state != "running"

    def to_json(self, with_result: bool = True) -> dict[str, Any]:
        """Return the job as clients get it, as plain data."""
        names = ("id", "kind", "state", "fraction", "text", "last_s", "error", "bound", *["result"] * with_result)
        return {name: getattr(self, name) for name in names}


class Jobs:
    """Jobs of one server: each role has its turns, in which people take turns, and its last `MOST_KEPT` jobs.

    `tell` is called with the event `job` at every change.
    """

    def __init__(self, tell: Callable[[Mapping[str, Any]], None]) -> None:
        self._tell_all = tell
        self._jobs, self._took = dict[str, Job](), dict[str, float]()
        places = [(role, quick, 1 if quick else AT_ONCE[role]) for role in Role for quick in (True, False)]
        self._turns = {(role, quick): Turns(n, n + MOST_WAITING, "jobs") for role, quick, n in places}
        self._warm = {role: _WorkProcess("diagram", TwodofError, background=True, nice=True) for role in Role}

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

    def start(self, kind: str, work: Callable[..., object], *args: Any, live: bool = False, quick: bool = False) -> Job:
        """Run `work(progress, *args)` in a process of its own; return its job at once.

        `work` is a function of a module, its arguments can be pickled, and it returns plain data for JSON. It calls
        `progress(fraction, text)` as it goes on. `live` work has to keep up with a drone: it begins at once, at full
        priority. `quick` work waits for quick work only and shares a process with it, so that caches stay. Raises
        Rejected if too many jobs wait, or if the client only watches and has too many.
        """
        role, person = client = CLIENT.get()
        watcher = client if role is Role.WATCH else None
        if not live:
            self._check_share(watcher)

        async def run(job: Job) -> None:
            # What flies does not wait for what computes, for a viewer perhaps.
            async with nullcontext() if live else self._turns[role, quick].turn(person if watcher else ""):
                job.text, began = "", time.monotonic()
                own = _WorkProcess(f"job {kind}", TwodofError, background=True, nice=not live)
                process = self._warm[role] if quick else own
                try:
                    job.result = await process.run(work, args, LONGEST_S, lambda *told: self._tell(job, *told))
                    job.state, self._took[kind] = "done", time.monotonic() - began  # also if a cancel comes at its end
                finally:
                    await own.close()

        return self._begin(Job(secrets.token_hex(8), kind, client=watcher), run)

    def watch(self, kind: str, work: Callable[[Told], Awaitable[Any]]) -> Job:
        """Run `work(told)`, work of the server itself such as talking to a drone; return its job at once.

        The work calls `told(fraction, text, bound)` as it goes on, and returns plain data. While it is `bound`,
        `cancel` is refused.
        """

        async def run(job: Job) -> None:
            job.result = json.loads(dumps(await work(lambda *told: self._tell(job, *told))))
            job.state = "done"

        return self._begin(Job(secrets.token_hex(8), kind), run)

    def _begin(self, job: Job, run: Callable[[Job], Awaitable[None]]) -> Job:
        self._jobs[job.id], job.last_s = job, self._took.get(job.kind)
        kept = [one for one in self.all if (one.client is None) == (job.client is None)]
        for old in [one for one in kept if one.over][: max(0, len(kept) - MOST_KEPT)]:
            del self._jobs[old.id]
        job.task = asyncio.create_task(self._run(job, run))
        return job

    async def cancel(self, name: str) -> Job:
        """End a job and its process, unless it is over already. Raises NotThere, Rejected while the job is bound."""
        job = self[name]
        if job.bound and not job.over:
            raise Rejected(f"the job cannot be ended now: {job.text}", f"job {job.kind}", "wait for its end")
        await self._end(job)
        return job

    async def close(self) -> None:
        """End all jobs, bound or not."""
        for job in self.all:
            await self._end(job)
        for process in self._warm.values():
            await process.close()

    async def _end(self, job: Job) -> None:
        if not job.task.done():
            job.task.cancel()
            with suppress(asyncio.CancelledError):
                await job.task
            if not job.over:  # it was cancelled before it had begun to wait for its turn
                job.state, job.text = "cancelled", ""

    def _check_share(self, watcher: LabClient | None) -> None:
        running = [job.client for job in self.all if not job.over and (job.client is None) == (watcher is None)]
        if len(running) >= (AT_ONCE[Role.COMMAND] + MOST_WAITING if watcher is None else MOST_OF_WATCHERS):
            people = "" if watcher is None else " of watching clients"
            raise Rejected(f"too many jobs{people} run or wait already", "jobs", "wait for one, or cancel one")
        if watcher is not None and running.count(watcher) >= MOST_OF_ONE:
            raise Rejected(f"{MOST_OF_ONE} jobs of yours run or wait already", "jobs", "wait for one")

    async def _run(self, job: Job, run: Callable[[Job], Awaitable[None]]) -> None:
        try:
            await run(job)
            job.fraction, job.text = 1.0, ""
        except TwodofError as error:
            job.error, job.state = refusal_of(error), "failed"
        except asyncio.CancelledError:
            if not job.over:
                job.state, job.text = "cancelled", ""
            raise
        except Exception as fault:  # noqa: BLE001  whatever it was, the job has failed and says so
            what = f"its process could not be run: {fault}"
            job.error, job.state = {"what": what, "where": f"job {job.kind}", "remedy": "report it"}, "failed"
        finally:
            self._tell(job, job.fraction, job.text)

    def _tell(self, job: Job, fraction: float, text: str, bound: bool = False) -> None:
        job.fraction, job.text, job.bound = fraction, text, bound
        self._tell_all({"event": "job", "job": job.to_json(with_result=False)})
