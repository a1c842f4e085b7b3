"""The time of a thread, as another sees it: it waits, or it runs."""

import hashlib
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from tests.patience import PATIENCE_S, patiently
from twodof.fcu.control.real_time import ThreadTime

if sys.platform != "linux":
    pytest.skip("what a thread waits for is asked of Linux", allow_module_level=True)


MUCH = bytes(1 << 25)


@contextmanager
def thread(work: Callable[[threading.Event], object]) -> Iterator[ThreadTime]:
    """A thread that does `work` until the end of the block."""
    end, made, begun = threading.Event(), list[ThreadTime](), threading.Event()

    def run() -> None:
        made.append(ThreadTime())
        begun.set()
        while not end.is_set():
            work(end)

    running = threading.Thread(target=run)
    running.start()
    try:
        assert begun.wait(PATIENCE_S)
        yield made[0]
    finally:
        end.set()
        running.join(PATIENCE_S)


def looks(seen: ThreadTime, times: int) -> list[float]:
    """Its share in each of so many milliseconds or so."""
    return [seen.own() for _, _ in zip(range(times), patiently(), strict=False)]


def computes(_: threading.Event) -> None:
    """Long, and without the interpreter's lock: the test's own thread runs at the same time."""
    hashlib.sha256(MUCH).digest()


def test_a_thread_that_waits_has_all_of_its_time() -> None:
    with thread(lambda end: end.wait(PATIENCE_S)) as seen:
        for _ in patiently():  # until it has come to wait
            if looks(seen, 20) == [1.0] * 20:
                break


def test_one_that_computes_has_what_it_runs() -> None:
    with thread(computes) as seen:
        for _ in patiently():  # until others leave it half of some millisecond
            if seen.own() > 0.5:
                break
