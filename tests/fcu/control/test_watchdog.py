"""The watchdog: it trips once when the loop hangs, never before the loop has begun. It counts looks, not time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from inspect import signature

import pytest

from tests.patience import PATIENCE_S
from twodof.fcu.control.real_time import LOOK_S, LOOKS, ThreadTime, Watchdog

NEVER_S = 1e6  # between looks of its own: the test looks


@pytest.fixture
def stops() -> list[int]:
    """The trips at which it stopped the motors."""
    return []


@pytest.fixture
def watchdog(stops: list[int]) -> Iterator[Watchdog]:
    """One that looks when the test does."""
    made = Watchdog(lambda: stops.append(made.trips), NEVER_S)
    yield made
    made.close()
    made.close()


def look(watchdog: Watchdog, times: int) -> None:
    for _ in range(times):
        watchdog.look()


def test_a_loop_that_has_not_begun_does_not_hang(watchdog: Watchdog, stops: list[int]) -> None:
    look(watchdog, 3 * LOOKS)
    assert (watchdog.trips, stops) == (0, [])


def test_it_trips_at_the_fifth_look_without_a_beat_once_and_again_after_they_came_back(
    watchdog: Watchdog, stops: list[int]
) -> None:
    for trip in (1, 2):
        for beats in (1, 7):
            for _ in range(beats):
                watchdog.beat()
            look(watchdog, LOOKS)  # the first sees the beat
            assert watchdog.trips == trip - 1
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
    assert watchdog.trips == 1
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
    watchdog = Watchdog(lambda: stops.append(watchdog.trips), NEVER_S, patient=True)

    def looks(*values: float) -> int:
        watchdog.beat()
        shares[:] = [1.0, *values]  # the first look sees the beat
        look(watchdog, len(shares))
        return watchdog.trips

    assert looks(*[1.0] * (LOOKS - 1)) == 0
    assert looks(*[0.0] * 1000) == 0, "others have the processor"
    assert looks(*[0.97] * LOOKS) == 1, "it runs, but for what the watchdog itself takes, and gives no sign of life"
    assert looks(*[0.25] * 4 * (LOOKS - 1)) == 1
    assert looks(*[0.25] * 4 * LOOKS) == 2
    watchdog.close()
