"""Programs that run until somebody ends them: Ctrl-C and SIGTERM are how they end, not a failure."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Coroutine
from contextlib import suppress


async def until_told(work: Coroutine[object, object, int | None]) -> int | None:
    """What `work` returns; None if SIGINT or SIGTERM ended it, of which it learns by being cancelled."""
    task = asyncio.ensure_future(work)

    def told() -> None:
        if not task.cancelling():  # a second Ctrl-C does not disturb how it ends
            task.cancel()

    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, told)
    with suppress(asyncio.CancelledError):
        return await task
    return None
