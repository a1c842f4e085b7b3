"""Virtual drones in lockstep for tests: in a process of their own, or in a thread, where a test can spoil them."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from typing import Any

from bench.stack.programs import Running, running
from tests.patience import PATIENCE_S
from twodof.sim.virtual_drone import VirtualDrone


@contextmanager
def drone_process(folder: Path, rig: str, *options: str) -> Iterator[tuple[Running, str]]:
    """`twodof fcu` with `options` that keeps its state in `folder`, and its URL."""
    arguments = ("fcu", "--rig", rig, "--listen", "tcpin://127.0.0.1:0", "--state", str(folder), *options)
    with running(*arguments, urls=1, folder=folder) as program:
        yield program, program.urls[0].replace("tcpin", "tcp")


@contextmanager
def drone_thread(spoil: Callable[[VirtualDrone], None] = lambda drone: None, **options: Any) -> Iterator[str]:
    """The URL of a VirtualDrone that runs in a thread; `spoil` is called with it before it runs."""
    ready: Queue[str] = Queue()
    ended = threading.Event()

    async def serve() -> None:
        drone = VirtualDrone(**({"lockstep": True} | options))
        spoil(drone)
        async with drone:
            ready.put(await drone.listen("tcpin://127.0.0.1:0"))
            while not ended.is_set():
                await asyncio.sleep(0.02)

    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(lambda: asyncio.run(serve()))
        running.add_done_callback(lambda _: ready.put(""))
        try:
            url = ready.get(timeout=PATIENCE_S)
            if url:
                yield url.replace("tcpin", "tcp")
        finally:
            ended.set()
            running.result(PATIENCE_S)
