"""An event loop whose clock jumps to the next thing due instead of waiting: a link's minutes in milliseconds."""

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any

from twodof.errors import TwodofError

# What waits longer than this in virtual time with nothing else due hangs.
HORIZON_S = 3600.0


class _Jumping(selectors.DefaultSelector):
    """Never waits: where nothing is ready, time passes."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the ready selectors; if there is none, the clock moves by `timeout`."""
        ready = super().select(0)
        if not ready:
            if timeout is None or self.now > HORIZON_S:
                raise TimeoutError("nothing is ready and nothing is due: this would hang")
            self.now += max(timeout, 0.0)
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop on virtual time [s], from 0."""

    def __init__(self) -> None:
        self._jumping = _Jumping()
        super().__init__(self._jumping)
        self._clock_resolution = 1e-9

    def time(self) -> float:
        """Virtual time [s]."""
        return self._jumping.now

    def stand_still(self, seconds: float) -> None:
        """Time [s] goes by in which nothing here runs, as in a process that is stopped."""
        self._jumping.now += seconds

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> Any:
        """Call it here and now: in another thread real time would pass, and the clock here would run away from it."""
        future = self.create_future()
        try:
            future.set_result(func(*args))
        except (OSError, TwodofError) as error:
            future.set_exception(error)
        return future


def run_virtual(work: Coroutine[Any, Any, Any]) -> Any:
    """Run `work` in a fresh loop on virtual time and return its result."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(work)


def on_virtual_time(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run an async test in a fresh loop on virtual time."""

    @wraps(test)
    def run(*given: Any, **named: Any) -> None:
        run_virtual(test(*given, **named))

    return run
