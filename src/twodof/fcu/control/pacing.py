"""Pacing: wakes the control loop at each control period of real time, by the monotonic clock."""

import asyncio
import ctypes
import os
import sys
import time
from contextlib import suppress

from twodof.errors import LinkError

MOST_CATCH_UP = 25
"""Periods that are made up for at once after a stall; what is beyond them is missed."""


class Pacer:
    """Due times `period_ns` apart from the first `wait` on.

    On Linux a timer of the kernel that wakes to the microsecond (asyncio's own timers wake a millisecond late), else
    asyncio's. A wall clock that jumps changes nothing.
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.missed = 0
        self.late_ns = 0
        self._begin = 0
        self._done = 0
        self._waiter: asyncio.Future[None] | None = None
        self._timer: int | None = None
        self._loop = asyncio.get_running_loop()
        if sys.platform == "linux":
            self._timer = _timer("create", time.CLOCK_MONOTONIC, _NONBLOCK | _CLOEXEC)
            self._loop.add_reader(self._timer, self._fired)

    async def wait(self) -> int:
        """Waits for the next due time, and says how many periods are due now: 1, or more after a stall.

        Periods beyond `MOST_CATCH_UP` are counted in `missed` and left out. `late_ns` is by how much the first of
        those that are due is late.
        """
        if not self._begin:
            self._begin = time.monotonic_ns()
            if self._timer is not None:
                times = (divmod(at, 10**9) for at in (self.period_ns, self._begin + self.period_ns))
                setting = _Setting(*(_Time(*parts) for parts in times))
                _timer("settime", self._timer, _ABSOLUTE, ctypes.byref(setting), None)
        due = self._due()
        while due <= 0:
            self._waiter = self._loop.create_future()
            handle = None
            if self._timer is None:
                at = self._begin + (self._done + 1) * self.period_ns
                handle = self._loop.call_later((at - time.monotonic_ns()) * 1e-9, self._wake)
            try:
                await self._waiter
            finally:
                self._waiter = None
                if handle is not None:
                    handle.cancel()
            due = self._due()
        self.late_ns = time.monotonic_ns() - self._begin - (self._done + 1) * self.period_ns
        left_out = max(0, due - MOST_CATCH_UP)
        self.missed += left_out
        self._done += due
        return due - left_out

    def close(self) -> None:
        """Gives the timer back."""
        if self._timer is not None:
            self._loop.remove_reader(self._timer)
            os.close(self._timer)
            self._timer = None

    def _due(self) -> int:
        return (time.monotonic_ns() - self._begin) // self.period_ns - self._done

    def _fired(self) -> None:
        if self._timer is not None:
            with suppress(BlockingIOError):
                os.read(self._timer, 8)
        self._wake()

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)


class _Time(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Setting(ctypes.Structure):
    _fields_ = (("interval", _Time), ("value", _Time))


_NONBLOCK, _CLOEXEC, _ABSOLUTE = os.O_NONBLOCK, getattr(os, "O_CLOEXEC", 0), 1


def _timer(call: str, *given: object) -> int:
    """Calls timerfd_create or timerfd_settime of the system."""
    made = int(getattr(ctypes.CDLL(None, use_errno=True), f"timerfd_{call}")(*given))
    if made < 0:
        what = f"the system gives no timer: timerfd_{call}: {os.strerror(ctypes.get_errno())}"
        raise LinkError(what, "pacing", "end other programs")
    return made
