"""A disk that stands still when a test wants it to."""

import os
import threading
from collections.abc import Iterator

import pytest

from tests.patience import PATIENCE_S


class SlowDisk:
    """fsync waits while it stands still; `standing` says that somebody waits."""

    def __init__(self) -> None:
        self.standing, self._going, self._sync = threading.Event(), threading.Event(), os.fsync
        self._going.set()

    def sync(self, descriptor: int) -> None:
        """In place of os.fsync."""
        if not self._going.is_set():
            self.standing.set()
            assert self._going.wait(PATIENCE_S)
        self._sync(descriptor)

    def stop(self) -> None:
        """From now on it stands still."""
        self._going.clear()

    def go(self) -> None:
        """What waits goes on."""
        self._going.set()


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowDisk]:
    made = SlowDisk()
    monkeypatch.setattr(os, "fsync", made.sync)
    yield made
    made.go()
