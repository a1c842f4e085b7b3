"""Source of one drone's telemetry rows for the feeds of web sockets."""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from contextlib import AsyncExitStack, suppress
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import Rejected, Timeout
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.telemetry import columns_of
from twodof.lab.telemetry_rows import ONBOARD, PLACES, Feeds, TickRows
from twodof.link.mavlink.messages import batch_rows, channel_mask


async def until_one_ends(work: Iterable[Coroutine[Any, Any, Any]]) -> None:
    """Run all coroutines until one ends; cancel the others and wait for them. Raises the error of that one."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


TOGETHER_S = 0.016
"""Rows within this time [s] are sent together: a screen shows no more than 60 pictures a second."""
LOOK_S = 0.05
LINGER_S = 3.0
"""Longest pause without a reader before the subscription ends [s]: a page that is loaded again needs the same."""
_ALL = channel_mask(ONBOARD)


class TelemetrySource:
    """Source of one connected drone's rows for `feeds`."""

    def __init__(self, drone: AsyncDrone, feeds: Feeds) -> None:
        self._drone, self._feeds = drone, feeds
        self._rows = TickRows()
        self._flushing: asyncio.TimerHandle | None = None
        drone.session.on(lambda got: self._rows.action(got.since, got.action), "TWODOF_SAFETY")

    def work(self) -> list[Coroutine[Any, Any, None]]:
        """Return coroutines to run side by side, which subscribe while a feed wants rows. Each raises LinkLost."""
        return [
            self._subscribed(self._onboard, lambda: self._feeds.wanted),
            self._subscribed(self._truth, lambda: self._feeds.truth_wanted),
        ]

    async def _onboard(self, stack: AsyncExitStack) -> None:
        await stack.enter_async_context(self._drone.batches.to(self._take_batch, _ALL))

    async def _truth(self, stack: AsyncExitStack) -> None:
        if self._drone.state.rig.virtual:  # the truth of a real drone is unknown
            await stack.enter_async_context(self._drone.rig_truth.to(self._take_truth))

    async def _subscribed(self, subscribe: Callable[[AsyncExitStack], Any], wanted: Callable[[], bool]) -> None:
        while True:
            while not wanted():
                await self._look()
            with suppress(Timeout, Rejected):  # the loop subscribes again
                async with AsyncExitStack() as stack:
                    await subscribe(stack)
                    await self._unwanted(wanted)

    async def _unwanted(self, wanted: Callable[[], bool]) -> None:
        """Wait until no feed wants rows for LINGER_S."""
        session = self._drone.session
        since = session.now
        while session.now - since < LINGER_S:
            if wanted():
                since = session.now
            await self._look()

    async def _look(self) -> None:
        session = self._drone.session
        session.check(session.now)
        await asyncio.sleep(LOOK_S)

    def _take_batch(self, got: Any) -> None:
        ticks, values = batch_rows(got)
        if len(ticks):
            self._rows.onboard(ticks, values, _places(got.channels))
            self._soon()

    def _take_truth(self, got: Any) -> None:
        self._rows.truth(got.step, (got.theta, got.q, got.x, got.v))
        self._soon()

    def _soon(self) -> None:
        if self._flushing is None:
            self._flushing = asyncio.get_running_loop().call_later(TOGETHER_S, self._flush)

    def _flush(self) -> None:
        self._flushing = None
        taken = self._rows.take()
        if taken is not None:
            self._feeds.give(*taken)


@lru_cache(maxsize=64)
def _places(mask: int) -> NDArray[np.intp]:
    """Return the indices in COLUMNS of the columns of a batch with the channels `mask`."""
    columns = columns_of(mask)
    return np.array([PLACES[name] for name in sorted(columns, key=columns.__getitem__)], dtype=np.intp)
