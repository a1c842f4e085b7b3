"""What a thread did with the time that passed: it ran, it waited for something, or it lacked a processor."""

from __future__ import annotations

import sys
import threading
import time
from contextlib import suppress
from pathlib import Path


class ThreadTime:
    """The thread that makes it, as seen from any other. On Linux; elsewhere nothing counts as lacking a processor."""

    def __init__(self) -> None:
        self._stat = Path(f"/proc/self/task/{threading.get_native_id()}/stat")
        self._clock = time.pthread_getcpuclockid(threading.get_ident()) if sys.platform == "linux" else None
        self._seen, self._ran = time.monotonic(), self._processor_time()

    def own(self) -> float:
        """The part, 0 to 1, of the time since the last call that was the thread's own.

        All of it where the thread waits for something now, or has ended; where it would run, only what it ran.
        """
        now, ran = time.monotonic(), self._processor_time()
        passed, used = now - self._seen, ran - self._ran
        self._seen, self._ran = now, ran
        if not self._would_run():
            return 1.0
        return min(1.0, used / passed) if passed > 0.0 else 1.0

    def _processor_time(self) -> float:
        """What it has used so far [s]; 0 once it has ended, or where that is not known."""
        with suppress(OSError):
            return 0.0 if self._clock is None else time.clock_gettime(self._clock)
        return 0.0

    def _would_run(self) -> bool:
        """Whether it runs, or only lacks a processor; False where that is not known."""
        with suppress(OSError):
            # proc(5): the number, the name in parentheses, then the state.
            return self._clock is not None and self._stat.read_bytes().rpartition(b")")[2].split()[0] == b"R"
        return False
