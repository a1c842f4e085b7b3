"""The watchdog: it trips when the loop hangs, once, and not before the loop has begun."""

from __future__ import annotations

import threading
import time

from twodof.fcu.watchdog import LOOKS, Watchdog

LOOK_S = 0.002
PATIENCE_S = 20.0


def test_it_trips_once_when_the_beats_end_and_again_after_they_came_back() -> None:
    stopped = threading.Semaphore(0)
    watchdog = Watchdog(stopped.release, LOOK_S)
    time.sleep(LOOK_S * LOOKS * 5)
    assert watchdog.trips == 0, "nothing has begun yet"
    watchdog.beat()
    assert stopped.acquire(timeout=PATIENCE_S)
    time.sleep(LOOK_S * LOOKS * 5)
    assert watchdog.trips == 1
    watchdog.beat()
    assert stopped.acquire(timeout=PATIENCE_S)
    assert watchdog.trips == 2
    watchdog.close()
    watchdog.close()


def test_it_is_silent_while_beats_come() -> None:
    stopped = threading.Semaphore(0)
    watchdog = Watchdog(stopped.release, 0.05)  # beats come far more often than it looks
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        watchdog.beat()
        time.sleep(0.001)
    watchdog.close()
    assert watchdog.trips == 0
