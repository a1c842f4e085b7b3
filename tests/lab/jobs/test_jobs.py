"""Jobs run beside the server, say how far they are, end when they are told to, and fail without harming it."""

import asyncio
import functools
import os
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import pytest

from tests.patience import PATIENCE_S
from tests.processes import alive
from twodof.errors import IdentificationError, Rejected
from twodof.lab.access import CLIENT, LabClient, Role
from twodof.lab.answers import NotThere
from twodof.lab.processes import AT_ONCE, MOST_KEPT, MOST_OF_ONE, MOST_OF_WATCHERS, MOST_WAITING, Job, Jobs, Progress

pytestmark = pytest.mark.slow

OURS = CLIENT.get()


def counts(progress: Progress, number: int) -> dict[str, object]:
    """Counts to `number`; returns what JSON has no form of, too."""
    for k in range(number):
        progress(k / number, f"step {k}")
        time.sleep(0.06)
    return {"counted": number, "nan": float("nan"), "niceness": os.nice(0)}


def refuses(progress: Progress) -> None:
    """Fails as the library does."""
    raise IdentificationError("too few samples", "the log", "fly longer")


def breaks(progress: Progress) -> None:
    """Fails as a program does that has a fault."""
    raise ZeroDivisionError("by zero")


def dies(progress: Progress) -> None:
    """Ends without a word, as one that ran out of memory."""
    os._exit(9)


def sleeps(progress: Progress) -> None:
    """Goes on for ever; tells its process."""
    progress(1.0, str(os.getpid()))
    time.sleep(1e6)


def flies(progress: Progress) -> tuple[int, bool]:
    """Keeps up with a drone; tells its niceness, and whether it has a session's share of a busy computer."""
    return os.nice(0), os.getsid(0) == os.getpid()


def with_jobs(work: Callable[[Jobs, list[Mapping[str, Any]]], Awaitable[None]]) -> None:
    """Run `work` with jobs, and the events that they tell."""

    async def run() -> None:
        told: list[Mapping[str, Any]] = []
        jobs = Jobs(told.append)
        try:
            async with asyncio.timeout(PATIENCE_S):
                await work(jobs, told)
        finally:
            await jobs.close()

    asyncio.run(run())


def started(jobs: Jobs, work: Callable[[Progress], object], client: LabClient) -> Job:
    """Start work for a client."""
    CLIENT.set(client)
    try:
        return jobs.start(work.__name__, work)
    finally:
        CLIENT.set(OURS)


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.005)


def test_a_job_tells_how_far_it_is_and_gives_its_result() -> None:
    async def work(jobs: Jobs, told: list[Mapping[str, Any]]) -> None:
        job = jobs.start("count", counts, 5)
        assert job.to_json()["state"] == "running"
        await until(lambda: job.over)
        assert job.result == {"counted": 5, "nan": None, "niceness": min(19, os.nice(0) + 10)}
        await until(lambda: told[-1]["job"]["state"] == "done")
        fractions = [event["job"]["fraction"] for event in told]
        assert fractions == sorted(fractions)
        assert {"step 1", "step 4"} <= {event["job"]["text"] for event in told}
        assert all("result" not in event["job"] for event in told)
        assert jobs[job.id] is job

    with_jobs(work)


@pytest.mark.parametrize(
    ("fails", "what", "remedy"),
    [
        (refuses, "too few samples", "fly longer"),
        (breaks, "a fault of the program: ZeroDivisionError: by zero", "report it"),
        (dies, "the process ended in mid-work: it may have run out of memory", "ask for less"),
    ],
)
def test_a_job_that_fails_says_why_and_the_next_one_runs(
    fails: Callable[[Progress], None], what: str, remedy: str
) -> None:
    async def work(jobs: Jobs, _: list[Mapping[str, Any]]) -> None:
        job, after = jobs.start("fail", fails), jobs.start("count", counts, 0)
        await until(lambda: job.over and after.over)
        assert job.state == "failed"
        assert job.error is not None
        assert (job.error["what"], job.error["remedy"]) == (what, remedy)
        assert after.state == "done"

    with_jobs(work)


def test_watchers_have_a_share_of_the_jobs() -> None:
    async def work(jobs: Jobs, _: list[Mapping[str, Any]]) -> None:
        watchers = [LabClient(Role.WATCH, f"10.0.0.{k}") for k in range(3)]
        first = [started(jobs, sleeps, watchers[0]) for _ in range(MOST_OF_ONE)]
        with pytest.raises(Rejected, match=f"{MOST_OF_ONE} jobs of yours"):
            started(jobs, sleeps, watchers[0])
        for _ in range(MOST_OF_WATCHERS - MOST_OF_ONE):
            started(jobs, sleeps, watchers[1])
        with pytest.raises(Rejected, match="of watching clients"):
            started(jobs, sleeps, watchers[2])
        started(jobs, sleeps, LabClient(Role.COMMAND, "10.0.0.0"))
        await jobs.cancel(first[-1].id)
        started(jobs, sleeps, watchers[0])

    with_jobs(work)


def test_watchers_jobs_delay_and_forget_no_others() -> None:
    async def work(jobs: Jobs, _: list[Mapping[str, Any]]) -> None:
        watchers = [LabClient(Role.WATCH, f"10.0.0.{k}") for k in range(2)]
        for watcher in watchers:
            for _ in range(MOST_OF_ONE):
                last = started(jobs, sleeps, watcher)
        ours = jobs.start("count", counts, 0)
        await until(lambda: ours.over)
        for _ in range(2 * MOST_KEPT):
            await jobs.cancel(last.id)
            last = started(jobs, sleeps, watchers[1])
        assert jobs[ours.id].result["counted"] == 0

    with_jobs(work)


def test_a_job_that_is_cancelled_ends_with_its_process() -> None:
    async def work(jobs: Jobs, _: list[Mapping[str, Any]]) -> None:
        job = jobs.start("sleep", sleeps)
        await until(lambda: job.text.isdigit())
        process = int(job.text)
        assert alive(process)
        assert (await jobs.cancel(job.id)).state == "cancelled"
        await until(lambda: not alive(process))
        with pytest.raises(NotThere):
            await jobs.cancel("another")

    with_jobs(work)


@functools.cache
def computed_once() -> int:
    """Return the time of the first call in this process."""
    return time.monotonic_ns()


def remembers(progress: Progress) -> int:
    """Returns what a cache of its process holds."""
    return computed_once()


def test_quick_jobs_wait_for_no_slow_ones_and_keep_their_caches() -> None:
    async def work(jobs: Jobs, _: list[Mapping[str, Any]]) -> None:
        for _ in range(AT_ONCE[Role.COMMAND]):
            jobs.start("sleep", sleeps)
        first, second = (jobs.start("quick", remembers, quick=True) for _ in range(2))
        await until(lambda: first.over and second.over)
        assert first.result == second.result is not None
        stuck = jobs.start("quick", sleeps, quick=True)
        assert stuck.last_s is not None
        assert 0.0 < stuck.last_s < PATIENCE_S
        await until(lambda: stuck.text.isdigit())
        await jobs.cancel(stuck.id)
        after = jobs.start("quick", remembers, quick=True)
        await until(lambda: after.over)
        assert after.result not in {None, first.result}

    with_jobs(work)


def test_jobs_wait_for_their_turn_up_to_a_bound() -> None:
    async def work(jobs: Jobs, _: list[Mapping[str, Any]]) -> None:
        at_once = AT_ONCE[Role.COMMAND]
        started: list[Job] = [jobs.start("sleep", sleeps) for _ in range(at_once + MOST_WAITING)]
        with pytest.raises(Rejected, match="too many jobs"):
            jobs.start("sleep", sleeps)
        await until(lambda: all(job.text.isdigit() for job in started[:at_once]))
        assert {job.text for job in started[at_once:]} == {"waits for its turn"}
        flight = jobs.start("flight", flies, live=True)  # what flies waits for none of them
        await until(lambda: flight.over)
        assert flight.result == [os.nice(0), True]
        assert (await jobs.cancel(started[-1].id)).state == "cancelled"  # before its turn
        await jobs.cancel(started[0].id)
        await until(lambda: started[at_once].text.isdigit())

    with_jobs(work)
