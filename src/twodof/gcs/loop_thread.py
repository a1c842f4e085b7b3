"""Event loop in a thread of its own, for scripts without asyncio; it never keeps a process from ending."""

import asyncio
import atexit
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar
from weakref import WeakMethod

from twodof.errors import LinkLost, TwodofError

T = TypeVar("T")
# A loop that does not answer within this time is stuck, and is left behind.
CLOSING_S = 5.0


class LoopThread:
    """Thread with an event loop that runs coroutines and returns their results; `where` is for errors."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._loop = asyncio.new_event_loop()
        self._leave: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._serve, name=f"drone {where}", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """True while the thread accepts work."""
        return self._thread.is_alive() and not self._loop.is_closed()

    def run(self, work: Coroutine[Any, Any, T], finish: bool = False) -> T:
        """Run `work` and return its result; Ctrl-C cancels it, unless it must `finish`. Raises LinkLost once closed."""
        if not self.alive or threading.current_thread() is self._thread:
            work.close()
            if self.alive:
                raise RuntimeError("a callback cannot wait for the drone: set a variable that the script looks at")
            raise LinkLost("the drone was closed", self._where, "connect again")
        ended = threading.Event()
        tasks: list[asyncio.Task[T]] = []

        def begin() -> None:
            if not tasks:
                tasks.append(self._loop.create_task(work))
                tasks[0].add_done_callback(lambda _: ended.set())

        def cancel() -> None:
            if tasks:
                tasks[0].cancel()
            else:
                work.close()
                ended.set()

        try:
            self._loop.call_soon_threadsafe(begin)
            while not ended.wait(CLOSING_S):
                if not self.alive:
                    break
        except BaseException:
            # Ctrl-C may come before, while or after the work is handed over. Work that must finish is begun if it was
            # not; other work is cancelled, and may clean up.
            with suppress(RuntimeError):  # it was closed meanwhile
                self._loop.call_soon_threadsafe(begin if finish else cancel)
            ended.wait(CLOSING_S)
            raise
        try:
            if ended.is_set():
                return tasks[0].result()
        except asyncio.CancelledError:
            pass
        raise LinkLost("the drone was closed during the call", self._where, "connect again")

    def call(self, work: Callable[[], T]) -> T:
        """Call the plain function `work` in the thread and return its result."""

        async def called() -> T:
            return work()

        return self.run(called())

    def at_exit(self, leave: Callable[[], None]) -> None:
        """Call the method `leave` when the interpreter ends, unless it was closed before."""
        method = WeakMethod(leave)

        def left() -> None:
            found = method()
            if found is not None:
                with suppress(TwodofError):  # no caller is left
                    found()

        self._leave = left
        atexit.register(left)

    def leave_behind(self, leave: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Start `leave`, which ends the thread, and return at once: no variable holds the drone any more."""

        async def left() -> None:
            try:
                with suppress(TwodofError):  # no caller is left
                    await leave()
            finally:
                self._loop.stop()

        if self.alive:
            atexit.unregister(self._leave)
            atexit.register(self._end)  # an interpreter that ends meanwhile waits for it
            asyncio.run_coroutine_threadsafe(left(), self._loop)

    def _end(self) -> None:
        self._thread.join(CLOSING_S)

    def close(self) -> None:
        """Cancel running work and end the thread; a second time does nothing."""
        atexit.unregister(self._leave)
        if self.alive:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(CLOSING_S)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._until_stopped()
            left = asyncio.all_tasks(self._loop)
            for task in left:
                task.cancel()
            if left:
                self._loop.run_until_complete(asyncio.wait(left, timeout=CLOSING_S / 2))
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        finally:
            self._loop.close()
            atexit.unregister(self._end)

    def _until_stopped(self) -> None:
        while True:
            try:
                self._loop.run_forever()
                return
            except (SystemExit, KeyboardInterrupt) as wish:
                # They end the loop: callers would wait for ever, and the drone would stay armed.
                said = "a callback wanted to end the program: let it set something that the script sees"
                self._loop.call_exception_handler({"message": said, "exception": wish})
