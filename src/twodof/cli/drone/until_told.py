"""Programs that run until somebody ends them: Ctrl-C and SIGTERM are how they end, not a failure."""

import asyncio
import signal
from collections.abc import Coroutine

from twodof.errors import LinkError
from twodof.fleet.local_ports import with_port_owner


async def until_told(work: Coroutine[object, object, int | None]) -> int | None:
    """What `work` returns; None if SIGINT or SIGTERM ended it, of which it learns by being cancelled.

    Raises what it raises; where a port was in use, with who has it.
    """
    task = asyncio.ensure_future(work)

    def told() -> None:
        if not task.cancelling():  # a second Ctrl-C does not disturb how it ends
            task.cancel()

    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, told)
    try:
        return await task
    except asyncio.CancelledError:
        return None
    except LinkError as error:
        raise with_port_owner(error) from error
