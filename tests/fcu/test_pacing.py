"""The pacer: no period is lost or counted twice, however long the loop was held up."""

from __future__ import annotations

import asyncio
import sys
import time

import pytest

from twodof.fcu import pacing
from twodof.fcu.pacing import MOST_CATCH_UP, Pacer

PERIOD_NS = 2_000_000


async def paced(stalls: dict[int, float], wakes: int) -> tuple[list[int], list[int], Pacer, float]:
    """Due counts and missed counts at each wake, the pacer and the time [s] it took; it sleeps after some wakes."""
    pacer = Pacer(PERIOD_NS)
    counts, missed = [], []
    began = time.monotonic()
    for number in range(wakes):
        counts.append(await pacer.wait())
        missed.append(pacer.missed)
        assert pacer.late_ns >= 0, "never early"
        time.sleep(stalls.get(number, 0.0))
    took = time.monotonic() - began
    pacer.close()
    return counts, missed, pacer, took


@pytest.mark.parametrize("timer", ["of the kernel", "of asyncio"])
def test_periods_that_have_passed_are_due_or_missed_and_none_twice(timer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if timer == "of asyncio":
        monkeypatch.setattr(pacing.sys, "platform", "other")
    elif sys.platform != "linux":
        pytest.skip("the kernel's timer is used on Linux only")
    counts, missed, pacer, took = asyncio.run(paced({10: 0.02, 20: 0.12}, 40))
    periods = took * 1e9 / PERIOD_NS
    # What is left of the last period has not passed; the clock is read a moment before and after.
    assert periods - 2 < sum(counts) + pacer.missed <= periods + 1
    assert counts[11] >= 10, "a short stall is made up for"
    assert missed[20] == missed[10] or max(counts[:20]) == MOST_CATCH_UP
    assert counts[21] == MOST_CATCH_UP, "a long one not wholly"
    assert missed[21] - missed[20] >= 60 - MOST_CATCH_UP - 1


def test_a_clock_that_people_set_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    jumps = iter([0.0, 1e9, -1e9] * 100)
    monkeypatch.setattr(time, "time", lambda: next(jumps))
    counts, _, pacer, took = asyncio.run(paced({}, 20))
    assert sum(counts) + pacer.missed <= took * 1e9 / PERIOD_NS + 1


def test_it_leaves_the_processor_alone_while_it_waits() -> None:
    before = time.process_time()
    _, _, _, took = asyncio.run(paced({}, 100))
    # A loop that waits busily would take all of the time; this takes some tenths of a millisecond a wake at most.
    assert time.process_time() - before < 0.5 * took
