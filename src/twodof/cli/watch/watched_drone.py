"""One drone that is watched: without the lease, looked for again when it is lost, its last seconds kept."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from twodof.cli.watch.signal_history import SignalHistory
from twodof.errors import Rejected, Timeout, TwodofError
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.clock import DroneRestarted
from twodof.gcs.drone_state import StatusText
from twodof.gcs.telemetry import TelemetrySample, columns_of
from twodof.link.mavlink.messages import batch_rows, channel_mask
from twodof.signals import ATTITUDE, POSITION, RATE, TICK_S

COLUMNS = (
    *("estimate.theta", "estimate.q", "estimate.x", "estimate.v", "command.M", "command.T"),
    *("setpoint.theta", "setpoint.q", "setpoint.x", "state.mode"),
)
CONNECT_S = 10.0
_LOOK_S = 0.2
_TEXTS = 50
_NEEDS_MODE = {"setpoint.q": RATE, "setpoint.theta": ATTITUDE, "setpoint.x": POSITION}
"""From which mode on a set-point is followed."""


class SaidLine(NamedTuple):
    """What the drone said, and when it was heard [s, as time.time]."""

    heard: float
    severity: str
    text: str


class WatchedDrone:
    """A drone at `url`; `history` has the last `seconds` of each of `COLUMNS`, `texts` its last lines.

    `lost` says why it is not heard, None while it is; `system` picks it where several are heard.
    """

    def __init__(self, url: str, system: int | None, key: Path | None, seconds: float) -> None:
        self.url, self.system, self._key = url, system, key
        self.history = {name: SignalHistory(seconds) for name in COLUMNS}
        self.texts: deque[SaidLine] = deque(maxlen=_TEXTS)
        self.drone: AsyncDrone | None = None
        """The last that was heard; closed where it is lost."""
        self.lost: TwodofError | None = None
        self.lost_at = 0.0
        self._anew = asyncio.Event()

    @property
    def heard(self) -> bool:
        """Whether it is heard now."""
        return self.drone is not None and self.lost is None

    @property
    def time(self) -> float:
        """The drone's time [s] of its newest estimate; NaN before the first."""
        return self.history["estimate.theta"].newest

    async def connect(self) -> None:
        """Find it, and begin to listen. Raises as AsyncDrone.connect."""
        drone = await AsyncDrone.connect(self.url, CONNECT_S, key=self._key, take_lease=False, drone=self.system)
        self.drone, self.system = drone, drone.session.system
        drone.session.on(self._said, StatusText)
        drone.session.on(self._restarted, DroneRestarted)
        self.lost = None

    async def watch(self) -> None:
        """Listen until cancelled; one that is lost is looked for again, as often as it takes."""
        while True:
            try:
                if not self.heard:
                    await self.connect()
                await self._listen()
            except TwodofError as error:
                self.miss(error)
            finally:
                await self.leave()
            await asyncio.sleep(_LOOK_S)

    async def _listen(self) -> None:
        """Take what comes in until it is lost; from one that began anew ask for it again. Raises LinkLost."""
        drone = self.drone
        assert drone is not None
        while True:
            self._anew.clear()
            if not drone.ours or not await self._listen_at_full_rate(drone):
                await self._listen_as_it_comes(drone)

    async def _listen_at_full_rate(self, drone: AsyncDrone) -> bool:
        """False where it refuses that."""
        try:
            async with drone.batches.to(self._batch, channel_mask(COLUMNS)):
                await self._until_anew(drone)
        except (Rejected, Timeout):
            return False
        return True

    async def _listen_as_it_comes(self, drone: AsyncDrone) -> None:
        ends = [drone.telemetry(name).on(self._taker(name)) for name in COLUMNS]
        try:
            await self._until_anew(drone)
        finally:
            for end in ends:
                end()

    async def _until_anew(self, drone: AsyncDrone) -> None:
        """Wait until it began anew. Raises LinkLost."""
        while not self._anew.is_set():
            drone.session.check(drone.session.now)
            with suppress(TimeoutError):
                await asyncio.wait_for(self._anew.wait(), _LOOK_S)

    def miss(self, error: TwodofError) -> None:
        """It is not heard, for this reason."""
        if self.lost is None:
            self.lost, self.lost_at = error, time.time()

    async def leave(self) -> None:
        """Close the link; nothing of what is known of it changes."""
        if self.drone is not None:
            with suppress(TwodofError):
                await self.drone.close()

    def _batch(self, got: Any) -> None:
        ticks, values = batch_rows(got)
        places, times = columns_of(got.channels), ticks * TICK_S
        if not len(ticks) or "state.mode" not in places:
            return
        mode = values[:, places["state.mode"]]
        for name in COLUMNS:
            if name not in places:
                continue
            column = values[:, places[name]].astype(float)
            if name in _NEEDS_MODE:
                column[~(mode >= _NEEDS_MODE[name])] = float("nan")
            self.history[name].add(times, column)

    def _taker(self, name: str) -> Any:
        def take(sample: TelemetrySample) -> None:
            if isinstance(sample.value, float):
                self.history[name].add(sample.time, sample.value)

        return take

    def _said(self, line: StatusText) -> None:
        self.texts.append(SaidLine(time.time(), line.severity, line.text))

    def _restarted(self, _: DroneRestarted) -> None:
        self._anew.set()
