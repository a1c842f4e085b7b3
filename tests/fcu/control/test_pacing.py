"""The pacer: no period is lost or counted twice, however long the loop was held up."""

from __future__ import annotations

import asyncio
import gc
import sys
import time
from itertools import cycle

import pytest

from twodof.fcu.control import real_time as pacing
from twodof.fcu.control.real_time import MOST_CATCH_UP, Pacer

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
