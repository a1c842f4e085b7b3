"""Real time: the timer that wakes the control loop each period, and the watchdog that stops the motors if it hangs."""

import asyncio
import ctypes
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from twodof.errors import LinkError

MOST_CATCH_UP = 25
"""Most periods that are made up for at once after a stall; further ones are missed."""


class Pacer:
    """Timer with due times `period_ns` [ns] apart, from the first `wait` on.

    On Linux it is a kernel timer, exact to a microsecond (asyncio's own timers are a millisecond late), else asyncio's.
    It does not depend on the wall clock.
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.missed = 0
        self.late_ns = 0
        self._begin = 0
        self._done = 0
        self._waiter: asyncio.Future[None] | None = None
        self._timer = -1  # none
        self._loop = asyncio.get_running_loop()
        if sys.platform == "linux":
            self._timer = _timer("create", time.CLOCK_MONOTONIC, _NONBLOCK | _CLOEXEC)
            self._loop.add_reader(self._timer, self._fired)

    async def wait(self) -> int:
        """Wait for the next due time; return the number of periods due: 1, or more after a stall.

        Periods beyond `MOST_CATCH_UP` are left out and counted in `missed`. `late_ns` is the delay [ns] of the first
        one that is due.
        """
        if not self._begin:
            self._begin = time.monotonic_ns()
            if self._timer >= 0:
                times = (divmod(at, 10**9) for at in (self.period_ns, self._begin + self.period_ns))
                setting = _Setting(*(_Time(*parts) for parts in times))
                _timer("settime", self._timer, _ABSOLUTE, ctypes.byref(setting), None)
        while (due := self._due()) <= 0:
            if self._timer < 0:
                at = self._begin + (self._done + 1) * self.period_ns
                await asyncio.sleep((at - time.monotonic_ns()) * 1e-9)
                continue
            self._waiter = self._loop.create_future()
            try:
                await self._waiter
            finally:
                self._waiter = None
        self.late_ns = time.monotonic_ns() - self._begin - (self._done + 1) * self.period_ns
        left_out = max(0, due - MOST_CATCH_UP)
        self.missed += left_out
        self._done += due
        return due - left_out

    def close(self) -> None:
        """Close the timer."""
        if self._timer >= 0:
            self._loop.remove_reader(self._timer)
            os.close(self._timer)
            self._timer = -1

    def _due(self) -> int:
        return (time.monotonic_ns() - self._begin) // self.period_ns - self._done

    def _fired(self) -> None:
        with suppress(BlockingIOError):
            os.read(self._timer, 8)
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)


class _Time(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Setting(ctypes.Structure):
    _fields_ = (("interval", _Time), ("value", _Time))


_NONBLOCK, _CLOEXEC, _ABSOLUTE = os.O_NONBLOCK, getattr(os, "O_CLOEXEC", 0), 1


def _timer(call: str, *given: object) -> int:
    """Call timerfd_create or timerfd_settime of the system."""
    made = int(getattr(ctypes.CDLL(None, use_errno=True), f"timerfd_{call}")(*given))
    if made < 0:
        what = f"the system gives no timer: timerfd_{call}: {os.strerror(ctypes.get_errno())}"
        raise LinkError(what, "timer of the control loop", "end other programs")
    return made


LOOK_S = 0.02
LOOKS = 5
"""Number of looks without a beat after which the loop counts as hung."""

# A loop that runs all the time loses a little of it to whoever looks.
_HANGS = LOOKS - 0.5


class ThreadTime:
    """Clock of the thread that creates it: the share of time for which that thread was not kept off the processor.

    On systems other than Linux the share is always 1.
    """

    def __init__(self) -> None:
        self._stat = Path(f"/proc/self/task/{threading.get_native_id()}/stat")
        self._clock = time.pthread_getcpuclockid(threading.get_ident()) if sys.platform == "linux" else None
        self._seen, self._ran = time.monotonic(), self._processor_time()

    def own(self) -> float:
        """Return the share, 0 to 1, of the time since the last call in which the thread ran or waited by its own will.

        It is 1 if the thread waits for something now, or has ended. If it is ready to run, only the time it ran counts.
        """
        now, ran = time.monotonic(), self._processor_time()
        passed, used = now - self._seen, ran - self._ran
        self._seen, self._ran = now, ran
        if not self._would_run():
            return 1.0
        return min(1.0, used / passed) if passed > 0.0 else 1.0

    def _processor_time(self) -> float:
        """Return the thread's processor time [s]; 0 once it has ended, or if that is unknown."""
        with suppress(OSError):
            return 0.0 if self._clock is None else time.clock_gettime(self._clock)
        return 0.0

    def _would_run(self) -> bool:
        """Return whether the thread runs or waits for a processor; False if that is unknown."""
        with suppress(OSError):
            # proc(5): the number, the name in parentheses, then the state.
            return self._clock is not None and self._stat.read_bytes().rpartition(b")")[2].split()[0] == b"R"
        return False


class Watchdog:
    """Watchdog thread that calls `stop` when no `beat` came for `LOOKS` looks, `LOOK_S` apart: .1 s.

    It counts looks instead of time: if the whole machine stands still, so does its thread. It begins with the first
    beat.

    With `patient` a look counts only by the share of time in which the loop ran or waited. A loop without a processor
    does not hang, and does a virtual rig no harm, since the rig's time is that of the loop.

    It cannot detect native code that never releases the interpreter: that is left to the hardware.
    """

    def __init__(self, stop: Callable[[], None], look_s: float = LOOK_S, patient: bool = False) -> None:
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
        """Note that the loop runs; called by the loop's thread only."""
        if self._patient and self._loop is None:
            self._loop = ThreadTime()
        self._beats += 1

    def look(self) -> None:
        """Check for a beat since the last look, and stop the motors without one; every `look_s`."""
        beats, own = self._beats, 1.0 if self._loop is None else self._loop.own()
        if beats != self._seen or not beats:
            self._seen, self._silent, self._tripped = beats, 0.0, False
            return
        self._silent += own
        if self._silent > _HANGS and not self._tripped:
            self._tripped = True
            self._stop()

    def close(self) -> None:
        """End the thread; a second call does nothing."""
        self._end.set()
        self._thread.join(5.0)

    def _watch(self) -> None:
        while not self._end.wait(self._look_s):
            self.look()
