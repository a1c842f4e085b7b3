"""The watchdog: it trips when the loop hangs, once, and not before the loop has begun."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from tests.patience import PATIENCE_S
from twodof.fcu import watchdog as module
from twodof.fcu.watchdog import LOOKS, Watchdog


class Looking(threading.Event):
    """The event that ends the watchdog's thread, and between whose waits it looks: it waits until the test says so."""

    def __init__(self) -> None:
        super().__init__()
        self._may, self._has = threading.Semaphore(0), threading.Semaphore(0)

    def wait(self, timeout: float | None = None) -> bool:
        """Not before `look` or `set`."""
        self._has.release()
        assert self._may.acquire(timeout=PATIENCE_S)
        return self.is_set()

    def set(self) -> None:
        """The end."""
        super().set()
        self._may.release()

    def look(self, times: int) -> None:
        """Let it look so often; when this returns it has."""
        for _ in range(times):
            assert self._has.acquire(timeout=PATIENCE_S)
            self._may.release()
        assert self._has.acquire(timeout=PATIENCE_S)
        self._has.release()


@pytest.fixture
def looking(monkeypatch: pytest.MonkeyPatch) -> Iterator[Looking]:
    made = Looking()
    monkeypatch.setattr(module, "threading", SimpleNamespace(Event=lambda: made, Thread=threading.Thread))
    yield made
    assert made.is_set()


def test_it_trips_once_when_the_beats_end_and_again_after_they_came_back(looking: Looking) -> None:
    stops: list[int] = []
    watchdog = Watchdog(lambda: stops.append(watchdog.trips))
    looking.look(5 * LOOKS)
    assert watchdog.trips == 0, "nothing has begun yet"
    watchdog.beat()
    looking.look(1 + LOOKS - 1)  # the first sees the beat
    assert watchdog.trips == 0
    looking.look(1)
    assert watchdog.trips == 1
    looking.look(5 * LOOKS)
    assert watchdog.trips == 1
    watchdog.beat()
    looking.look(1 + LOOKS)
    assert watchdog.trips == 2
    watchdog.close()
    watchdog.close()
    assert stops == [1, 2]


def test_it_is_silent_while_beats_come(looking: Looking) -> None:
    watchdog = Watchdog(lambda: None)
    for _ in range(100):
        watchdog.beat()
        looking.look(LOOKS)  # the last but one of those that are too many
    watchdog.close()
    assert watchdog.trips == 0


def test_its_thread_looks_by_itself_and_ends_with_it() -> None:
    stopped = threading.Semaphore(0)
    watchdog = Watchdog(stopped.release, 0.002)
    watchdog.beat()
    assert stopped.acquire(timeout=PATIENCE_S)
    watchdog.close()
    assert not watchdog._thread.is_alive()
