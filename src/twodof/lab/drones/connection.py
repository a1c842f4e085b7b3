"""Connection to a drone: its telemetry, its reports, its parameters and its pilot while it lasts."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Mapping
from contextlib import AsyncExitStack, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twodof.errors import Rejected, Timeout
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.telemetry import columns_of
from twodof.lab.drones.drone_report import report
from twodof.lab.drones.parameter_table import ParameterTable
from twodof.lab.drones.pilot import FlightRecorder, Pilot
from twodof.lab.telemetry_rows import ONBOARD, PLACES, Feeds, TickRows
from twodof.link.mavlink.dialect import RATES
from twodof.link.mavlink.messages import batch_rows, channel_mask


async def until_one_ends(work: Iterable[Coroutine[Any, Any, Any]]) -> None:
    """Run all; when one ends the others are cancelled and waited for. Raises what that one raised."""
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
"""Rows that come within this time [s] are sent together: a screen shows no more pictures."""
LOOK_S = 0.05
LINGER_S = 3.0
"""So long it is sent on after nobody wants it: a page that is loaded again asks for the same."""
_ALL = channel_mask(ONBOARD)


class TelemetrySource:
    """Rows of one connected drone for `feeds`; its `work` goes on until it is cancelled or the drone is lost."""

    def __init__(self, drone: AsyncDrone, feeds: Feeds) -> None:
        self._drone, self._feeds = drone, feeds
        self._rows = TickRows()
        self._flushing: asyncio.TimerHandle | None = None

    def work(self) -> list[Coroutine[Any, Any, None]]:
        """What is to be run side by side: it subscribes while somebody wants rows. Each raises LinkLost."""
        return [
            self._subscribed(self._onboard, lambda: self._feeds.wanted),
            self._subscribed(self._truth, lambda: self._feeds.truth_wanted),
        ]

    async def _onboard(self, stack: AsyncExitStack) -> None:
        await stack.enter_async_context(self._drone.batches.to(self._take_batch, _ALL))

    async def _truth(self, stack: AsyncExitStack) -> None:
        if self._drone.state.rig.virtual:  # nobody knows that of a real one
            await stack.enter_async_context(self._drone.rig_truth.to(self._take_truth))

    async def _subscribed(self, subscribe: Callable[[AsyncExitStack], Any], wanted: Callable[[], bool]) -> None:
        while True:
            while not wanted():
                await self._look()
            with suppress(Timeout, Rejected):  # it is asked again while it is wanted
                async with AsyncExitStack() as stack:
                    await subscribe(stack)
                    await self._unwanted(wanted)

    async def _unwanted(self, wanted: Callable[[], bool]) -> None:
        """Until it is not wanted for a while."""
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
    """Places in COLUMNS of a batch's columns."""
    columns = columns_of(mask)
    return np.array([PLACES[name] for name in sorted(columns, key=columns.__getitem__)], dtype=np.intp)


REPORT_S = 0.1
REPORT_ANYWAY_S = 1.0
TIME, TIME_HZ = "ATTITUDE", 20.0
"""The message that tells its time, so often."""
FAST_HZ = 10.0
"""What comes as often as this by default, and is of no use here."""
_PASSES = frozenset({"time"})
"""What passes by itself: a state in which nothing else differs is told once a second only."""


class Hearer(Protocol):
    """Who is told what happens, and says how many are there that may command."""

    feeds: Feeds

    @property
    def commanding(self) -> int:
        """How many clients are connected that may command."""
        ...

    @property
    def lent(self) -> bool:
        """Whether who flies it records by itself."""
        ...

    def tell_state(self, state: Mapping[str, Any]) -> None:
        """The drone stands so now."""

    def say(self, severity: str, text: str) -> None:
        """A line about it."""

    def tell_parameters(self, names: list[str]) -> None:
        """These parameters changed."""

    def tell_log(self, name: str) -> None:
        """A flight was recorded."""


class DroneConnection:
    """The parts that attend to a connected drone; `run` goes on until it is lost.

    `asked` is the set-point that clients gave last, as they gave it.
    """

    def __init__(self, drone: AsyncDrone, hearer: Hearer, folder: Path) -> None:
        self.drone = drone
        self.asked: dict[str, Any] | None = None
        self.pilot = Pilot(drone, lambda: hearer.commanding, hearer.say)
        self.parameters = ParameterTable(drone, hearer.tell_parameters)
        self.recorder = FlightRecorder(
            drone,
            folder / "flights",
            self.parameters.active,
            hearer.tell_log,
            lambda why: hearer.say("error", why),
            lambda: hearer.lent,
        )
        self._hearer = hearer

    async def run(self) -> None:
        """Attend to it. Raises LinkLost at the end of that."""
        await self._ask_for_less()
        work = [self._report(), self.pilot.watch()]
        if self.drone.ours:
            work.append(self.parameters.run())
            if not self.drone.session.lockstep:
                work += TelemetrySource(self.drone, self._hearer.feeds).work()
                work.append(self.recorder.run())
        await until_one_ends(work)

    async def _ask_for_less(self) -> None:
        """Of streams at high rates none but that of its time: what clients want comes in batches."""
        if not self.drone.ours or self.drone.session.lockstep:
            return
        self.drone.telemetry.stop()
        with suppress(Rejected, Timeout):  # it costs more then, and harms nothing
            for row in RATES:
                if row.onboard is not None and row.onboard >= FAST_HZ:
                    await self.drone.stream(row.name, TIME_HZ if row.name == TIME else -1.0)
            await self.drone.stream("TWODOF_TOF", -1.0)

    def report(self) -> dict[str, Any]:
        """How it stands, for clients."""
        drone = self.drone
        if drone.setpoints.current is None:
            self.asked = None
        playback = drone.exciter.playback
        plays = playback is not None and playback.state in ("waiting", "playing")
        return report(drone) | {
            "setpoint": self.asked,
            "excitation": {"start_tick": playback.start_tick, "end_tick": playback.end_tick}
            if plays and playback is not None
            else None,
            "recording": self.recorder.name,
            "experiment": self._hearer.lent,
        }

    async def _report(self) -> None:
        """Tell how it stands when that changes, and once a second."""
        told: dict[str, Any] = {}
        session = self.drone.session
        due = 0.0
        while True:
            session.check(session.now)
            state = self.report()
            steady = {key: value for key, value in state.items() if key not in _PASSES}
            if steady != told or session.now >= due:
                told, due = steady, session.now + REPORT_ANYWAY_S
                self._hearer.tell_state(state)
            await asyncio.sleep(REPORT_S)
