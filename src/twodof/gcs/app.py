"""Runner of a user's program: `python -m twodof.gcs.app FILE --url URL`, FILE with `async def main(drone)`.

On board the companion starts it (`twodof companion run FILE`), as component 192 of the drone's own system. The program
has the lease while it runs, and its end disarms the drone. Exit status: 0 the program ended or got SIGTERM, 1 it
raised, 2 FILE is not such a program.
"""

import argparse
import asyncio
import inspect
import runpy
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import cast

from twodof.errors import TwodofError
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.mavlink.dialect import APP, GROUND_STATION

FINE, RAISED, NO_APP = 0, 1, 2

Main = Callable[[AsyncDrone], Awaitable[object]]


def load(file: Path) -> Main:
    """Return the coroutine function `main` of a program. Raises TwodofError if there is none."""
    try:
        found = runpy.run_path(str(file), run_name="twodof_app").get("main")
    except OSError as error:
        raise TwodofError(f"cannot be read: {error.strerror}", remedy="check the name and the rights") from error
    if not inspect.iscoroutinefunction(found):
        raise TwodofError("has no `async def main(drone)`", remedy="define it: it is called with the connected drone")
    return cast(Main, found)


async def fly(main: Main, url: str, timeout: float, system: int | None, key: Path | None) -> None:
    """Connect to the drone, run `main`, and leave the drone disarmed; SIGTERM and SIGINT cancel `main`.

    `system` None is the drone's own MAVLink system id.
    """
    task = asyncio.current_task()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        if task is not None:
            loop.add_signal_handler(number, task.cancel)
    component = APP if system is None else GROUND_STATION
    async with await AsyncDrone.connect(url, timeout, system, key, component=component) as drone:
        await main(drone)


def run(arguments: Sequence[str]) -> int:
    """Run one command line, write an error to stderr, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m twodof.gcs.app", description="Run a program with a drone.")
    parser.add_argument("file", type=Path, metavar="FILE", help="with `async def main(drone)`")
    parser.add_argument("--url", required=True, help="where the drone is, or its companion")
    parser.add_argument("--timeout", type=float, default=30.0, help="how long to look for the drone [s]")
    parser.add_argument("--system", type=int, help="MAVLink system id of the program [default: the drone's own]")
    parser.add_argument("--key", type=Path, help="file of a signing key")
    given = parser.parse_args(list(arguments))
    try:
        main = load(given.file)
    except (TwodofError, SyntaxError, ImportError) as error:
        sys.stderr.write(f"error: {given.file}: {error}\n")
        return NO_APP
    try:
        asyncio.run(fly(main, given.url, given.timeout, given.system, given.key))
    except asyncio.CancelledError:
        return FINE
    except TwodofError as error:
        sys.stderr.write(f"error: {error}\n")
        return RAISED
    return FINE


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
