"""The watchdog: it trips once when the loop hangs, never before the loop has begun. It counts looks, not time."""

import asyncio
import gc
import sys
import threading
import time
from collections.abc import Iterator
from inspect import signature
from itertools import cycle

import pytest

from tests.patience import PATIENCE_S
from twodof.fcu.control import real_time as pacing
from twodof.fcu.control.real_time import LOOK_S, LOOKS, MOST_CATCH_UP, Pacer, ThreadTime, Watchdog

NEVER_S = 1e6  # between looks of its own: the test looks


@pytest.fixture
def stops() -> list[int]:
    """The trips at which it stopped the motors."""
    return []


@pytest.fixture
def watchdog(stops: list[int]) -> Iterator[Watchdog]:
    """One that looks when the test does."""
    made = Watchdog(lambda: stops.append(len(stops) + 1), NEVER_S)
    yield made
    made.close()
    made.close()


def look(watchdog: Watchdog, times: int) -> None:
    for _ in range(times):
        watchdog.look()


def test_a_loop_that_has_not_begun_does_not_hang(watchdog: Watchdog, stops: list[int]) -> None:
    look(watchdog, 3 * LOOKS)
    assert stops == []


def test_it_trips_at_the_fifth_look_without_a_beat_once_and_again_after_they_came_back(
    watchdog: Watchdog, stops: list[int]
) -> None:
    for trip in (1, 2):
        for beats in (1, 7):
            for _ in range(beats):
                watchdog.beat()
            look(watchdog, LOOKS)  # the first sees the beat
            assert len(stops) == trip - 1
        watchdog.look()
        assert stops == [*range(1, trip + 1)]
        look(watchdog, 3 * LOOKS)
        assert stops == [*range(1, trip + 1)], "once"


def test_a_tenth_of_a_second() -> None:
    """docs/explanation/safety.md; a pause in which this thread stands too, to collect garbage say, is one look."""
    assert (LOOK_S, LOOKS) == (0.02, 5)
    assert signature(Watchdog).parameters["look_s"].default == LOOK_S


def test_its_own_thread_looks() -> None:
    before = set(threading.enumerate())
    stopped = threading.Event()
    watchdog = Watchdog(stopped.set, 0.001)
    watchdog.beat()
    assert all(thread.daemon for thread in threading.enumerate() if thread.name == "watchdog"), "it keeps no program up"
    assert stopped.wait(PATIENCE_S)
    watchdog.close()
    ours = [thread for thread in threading.enumerate() if thread.name == "watchdog" and thread not in before]
    assert ours == [], "closed, its thread has ended"


def test_one_on_a_real_rig_has_no_patience(
    monkeypatch: pytest.MonkeyPatch, watchdog: Watchdog, stops: list[int]
) -> None:
    """Its motors run on while others have the processor."""
    monkeypatch.setattr(ThreadTime, "own", lambda _: 0.0)
    watchdog.beat()
    look(watchdog, LOOKS + 1)
    assert stops == [1]


def test_a_patient_one_counts_looks_by_what_the_loop_had_of_their_time(
    monkeypatch: pytest.MonkeyPatch, stops: list[int]
) -> None:
    shares: list[float] = []
    monkeypatch.setattr(ThreadTime, "own", lambda _: shares.pop(0))
    watchdog = Watchdog(lambda: stops.append(len(stops) + 1), NEVER_S, patient=True)

    def looks(*values: float) -> int:
        watchdog.beat()
        shares[:] = [1.0, *values]  # the first look sees the beat
        look(watchdog, len(shares))
        return len(stops)

    assert looks(*[1.0] * (LOOKS - 1)) == 0
    assert looks(*[0.0] * 1000) == 0, "others have the processor"
    assert looks(*[0.97] * LOOKS) == 1, "it runs, but for what the watchdog itself takes, and gives no sign of life"
    assert looks(*[0.25] * 4 * (LOOKS - 1)) == 1
    assert looks(*[0.25] * 4 * LOOKS) == 2
    watchdog.close()


PERIOD_NS = 2_000_000


async def paced(stalls: dict[int, float], wakes: int) -> tuple[list[int], list[int], range]:
    """Due counts and missed counts at each wake, and how many periods may have passed; it sleeps after some wakes.

    What may have passed: those up to just before the last wait, and up to just after it, however long it took.
    """
    pacer = Pacer(PERIOD_NS)
    counts, missed, before, begins = [], [], 0, [time.monotonic_ns()]
    for number in range(wakes):
        before = time.monotonic_ns()
        wait = asyncio.ensure_future(pacer.wait())
        await asyncio.sleep(0)  # it begins with the first wait
        begins.append(time.monotonic_ns())
        counts.append(await wait)
        missed.append(pacer.missed)
        assert pacer.late_ns >= 0, "never early"
        time.sleep(stalls.get(number, 0.0))
    passed = range((before - begins[1]) // PERIOD_NS, (time.monotonic_ns() - begins[0]) // PERIOD_NS + 1)
    pacer.close()
    return counts, missed, passed


@pytest.mark.parametrize("timer", ["of the kernel", "of asyncio"])
def test_periods_that_have_passed_are_due_or_missed_and_none_twice(timer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if timer == "of asyncio":
        monkeypatch.setattr(pacing.sys, "platform", "other")
    elif sys.platform != "linux":
        pytest.skip("the kernel's timer is used on Linux only")
    counts, missed, passed = asyncio.run(paced({10: 0.02, 20: 0.12}, 40))
    assert sum(counts) + missed[-1] in passed
    assert counts[11] >= 10, "a short stall is made up for"
    assert missed[20] == missed[10] or max(counts[11:21]) == MOST_CATCH_UP
    assert counts[21] == MOST_CATCH_UP, "a long one not wholly"
    assert missed[21] - missed[20] >= 60 - MOST_CATCH_UP - 1


def test_a_clock_that_people_set_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    jumps = cycle([0.0, 1e9, -1e9])
    monkeypatch.setattr(time, "time", lambda: next(jumps))
    counts, missed, passed = asyncio.run(paced({}, 20))
    assert sum(counts) + missed[-1] in passed


def test_it_leaves_the_processor_alone_while_it_waits() -> None:
    gc.collect()  # what others left behind is not its
    before = time.thread_time_ns()
    _, _, passed = asyncio.run(paced({}, 100))
    # A loop that waits busily would take all of the time; this takes some tenths of a millisecond a wake at most.
    assert time.thread_time_ns() - before < 0.5 * passed[0] * PERIOD_NS
