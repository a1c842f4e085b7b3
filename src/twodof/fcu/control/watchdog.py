"""Watchdog: stops the motors when the control loop hangs."""

from __future__ import annotations

import threading
from collections.abc import Callable

from twodof.fcu.control.thread_time import ThreadTime

LOOK_S = 0.02
LOOKS = 5
"""Looks without a beat after which the loop hangs."""

# A loop that runs all the time loses a little of it to whoever looks.
_HANGS = LOOKS - 0.5


class Watchdog:
    """A thread that calls `stop` when no `beat` came for `LOOKS` looks, `LOOK_S` apart: .1 s.

    It counts looks and not time: where the whole machine stands still, its thread does as the loop does. With `patient`
    a look counts by the part of its time in which the loop ran, or waited for something: a loop that others keep from
    the processor does not hang, and a virtual rig, whose time is the loop's, is not harmed by it. `trips` counts. It
    begins with the first beat. What keeps the interpreter itself from running (native code that does not let go of it)
    it does not see: that is for the hardware.
    """

    def __init__(self, stop: Callable[[], None], look_s: float = LOOK_S, patient: bool = False) -> None:
        self.trips = 0
        self._stop = stop
        self._look_s = look_s
        self._patient = patient
        self._loop: ThreadTime | None = None
        self._beats = self._seen = 0
        self._silent = 0.0  # looks since the last beat was seen
        self._tripped = False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    def beat(self) -> None:
        """The loop runs. Always called by one thread, the loop's."""
        if self._patient and self._loop is None:
            self._loop = ThreadTime()
        self._beats += 1

    def look(self) -> None:
        """Whether a beat came since the last look; the thread does it every `look_s`."""
        beats, own = self._beats, 1.0 if self._loop is None else self._loop.own()
        if beats != self._seen or not beats:
            self._seen, self._silent, self._tripped = beats, 0.0, False
            return
        self._silent += own
        if self._silent > _HANGS and not self._tripped:
            self._tripped = True
            self.trips += 1
            self._stop()

    def close(self) -> None:
        """Ends the thread; a second time does nothing."""
        self._end.set()
        self._thread.join(5.0)

    def _watch(self) -> None:
        while not self._end.wait(self._look_s):
            self.look()
