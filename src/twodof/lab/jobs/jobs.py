"""Jobs: computations in processes of their own. They leave the server free, can be watched, and can be cancelled."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import secrets
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from twodof.errors import Rejected, TwodofError
from twodof.lab.access.lab_client import LabClient
from twodof.lab.access.role import Role
from twodof.lab.finite_json import dumps
from twodof.lab.jobs import worker
from twodof.lab.jobs.job import Job
from twodof.lab.refusals import NotThere

AT_ONCE = 2
MOST_WAITING = 16
MOST_OF_ONE, MOST_OF_WATCHERS = 6, 12
"""Jobs of one client that only watches, and of all such clients, that run or wait: who commands finds a place."""
MOST_KEPT = 50
LONGEST_S = 1800.0
LOOK_S = 0.05
Told = Callable[[float, str, bool], None]


class Jobs:
    """The jobs of one server: `AT_ONCE` run, the others wait for their turn, the last `MOST_KEPT` are remembered.

    `tell` is told of every change, as the event `job`.
    """

    def __init__(self, tell: Callable[[Mapping[str, Any]], None]) -> None:
        self._tell = tell
        self._jobs: dict[str, Job] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._clients: dict[str, LabClient] = {}
        self._turns = asyncio.Semaphore(AT_ONCE)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["twodof.lab.jobs.warm"])

    @property
    def all(self) -> list[Job]:
        """Those that are remembered, the oldest first."""
        return [*self._jobs.values()]

    def __getitem__(self, name: str) -> Job:
        """A job by its id. Raises NotThere."""
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
        if not worker.keeps_up(work):
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
        if worker.keeps_up(work):  # who flies does not wait for who computes, a viewer perhaps
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
        here, there = self._context.Pipe(duplex=False)
        process = self._context.Process(target=worker.run, args=(there, work, arguments), daemon=True)
        try:
            await asyncio.to_thread(process.start)  # the fork server takes a second to start
            there.close()
            job.text = ""
            async with asyncio.timeout(LONGEST_S):
                await self._listen(job, here)
        except TimeoutError:
            _fail(job, f"it took longer than {LONGEST_S:g} s", "ask for less")
        finally:
            if process.pid is not None:
                process.kill()
                await asyncio.to_thread(process.join, 5.0)
            here.close()

    async def _listen(self, job: Job, here: Connection) -> None:
        """Take in what its process tells, until it ends."""
        while not job.over:
            try:
                while await asyncio.to_thread(here.poll, LOOK_S):
                    self._told(job, here.recv())
                    if job.over:
                        return
            except (EOFError, ConnectionError):
                _fail(job, "its process ended in mid-work: it may have run out of memory", "ask for less")

    def _told(self, job: Job, said: tuple[Any, ...]) -> None:
        kind, *rest = said
        if kind == "progress":
            job.fraction, job.text = rest
            self._tell({"event": "job", "job": job.told(with_result=False)})
        elif kind == "done":
            job.result, job.fraction, job.text, job.state = json.loads(rest[0]), 1.0, "", "done"
        else:
            what, where, remedy = rest
            job.error, job.state = {"what": what, "where": where, "remedy": remedy}, "failed"


def _fail(job: Job, what: str, remedy: str) -> None:
    job.state, job.error = "failed", {"what": what, "where": f"job {job.kind}", "remedy": remedy}
