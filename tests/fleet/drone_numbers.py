"""Numbers of drones for tests of `twodof up`: their ports are fixed, and tests, and people, run side by side."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.patience import patiently
from twodof.fleet.local_drone import MOST_DRONES, port_in_use


@contextmanager
def free_numbers(count: int) -> Iterator[int]:
    """The first of `count` numbers whose ports are free now, and whose locks are ours until the end of the block."""
    for _ in patiently():
        # From the end: a person begins with 0.
        for first in range(MOST_DRONES - count, -1, -1):
            numbers = range(first, first + count)
            with ExitStack() as locks:
                if all(locks.enter_context(_lock(number)) for number in numbers) and not any(map(port_in_use, numbers)):
                    yield first
                    return


@contextmanager
def _lock(number: int) -> Iterator[bool]:
    """Yield whether the lock is ours."""
    file = Path(tempfile.gettempdir()) / f"twodof-tests-{os.getuid()}-drone-{number}.lock"
    with file.open("w") as held:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
