"""A disk that stands still when a test wants it to."""

import os
import threading
from collections.abc import Iterator

import pytest

from tests.patience import PATIENCE_S


class SlowDisk:
    """Disk whose fsync waits while it stands still; `standing` is set while a thread waits."""

    def __init__(self) -> None:
        self.standing, self._going, self._sync = threading.Event(), threading.Event(), os.fsync
        self._going.set()

    def sync(self, descriptor: int) -> None:
        """Replace os.fsync."""
        if not self._going.is_set():
            self.standing.set()
            assert self._going.wait(PATIENCE_S)
        self._sync(descriptor)

    def stop(self) -> None:
        """Let the disk stand still."""
        self._going.clear()

    def go(self) -> None:
        """Let waiting threads go on."""
        self._going.set()


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowDisk]:
    made = SlowDisk()
    monkeypatch.setattr(os, "fsync", made.sync)
    yield made
    made.go()
