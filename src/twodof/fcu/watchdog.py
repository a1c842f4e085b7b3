"""Watchdog: stops the motors when the control loop hangs."""

from __future__ import annotations

import threading
from collections.abc import Callable

LOOK_S = 0.02
LOOKS = 5
"""Looks without a beat after which the loop hangs."""


class Watchdog:
    """A thread that calls `stop` when no `beat` came for `LOOKS` looks, `LOOK_S` apart: .1 s.

    It counts looks and not time: where the whole machine is busy the thread stands still as the loop does, and a loop
    that was not given the processor does not hang. `trips` counts. It begins with the first beat. What keeps the
    interpreter itself from running (native code that does not let go of it) it does not see: that is for the hardware.
    """

    def __init__(self, stop: Callable[[], None], look_s: float = LOOK_S) -> None:
        self.trips = 0
        self._stop = stop
        self._look_s = look_s
        self._beats = self._seen = 0
        self._silent = 0  # looks since the last beat was seen
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    def beat(self) -> None:
        """The loop runs."""
        self._beats += 1

    def look(self) -> None:
        """Whether a beat came since the last look; the thread does it every `look_s`."""
        beats = self._beats
        self._silent = self._silent + 1 if beats == self._seen and beats else 0
        self._seen = beats
        if self._silent == LOOKS:
            self.trips += 1
            self._stop()

    def close(self) -> None:
        """Ends the thread; a second time does nothing."""
        self._end.set()
        self._thread.join(5.0)

    def _watch(self) -> None:
        while not self._end.wait(self._look_s):
            self.look()
