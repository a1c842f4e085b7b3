"""FlightRecorder: every flight of a drone, from arming to disarming, into a file of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from twodof.errors import LogError, Rejected, Timeout
from twodof.flightlog import numbered
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.recording import Recording, record

LOOK_S = 0.02
AFTER_S = 1.0
"""What comes after disarming belongs to the flight [s]: how it comes to rest."""
AGAIN_S = 5.0


class FlightRecorder:
    """Records the flights of `drone` into `folder`.

    `flying` tells what flies, at once where it is known. `recorded` is told the name of each file that is whole,
    `failed` why there is none. While `rests` says so nothing is begun. `name` is that of the file which is written
    now, "" between flights.
    """

    def __init__(
        self,
        drone: AsyncDrone,
        folder: Path,
        flying: Callable[[], Awaitable[ActiveController]],
        recorded: Callable[[str], None],
        failed: Callable[[str], None],
        rests: Callable[[], bool] = lambda: False,
    ) -> None:
        self.name = ""
        self._drone, self._folder, self._flying = drone, folder, flying
        self._recorded, self._failed, self._rests = recorded, failed, rests

    async def run(self) -> None:
        """Record flight after flight until it is cancelled. Raises LinkLost where the drone is lost."""
        session = self._drone.session
        while True:
            await self._until(armed=True)
            while self._rests() and self._drone.state.armed:
                session.check(session.now)
                await asyncio.sleep(LOOK_S)
            if not self._drone.state.armed:
                continue
            try:
                await self._record()
            except (LogError, OSError, Rejected, Timeout) as error:
                self._failed(f"this flight is not recorded: {error}")
                await asyncio.sleep(AGAIN_S)

    async def _record(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        began = datetime.now().astimezone()
        system = self._drone.session.system
        path = numbered(self._folder / f"{began:%Y-%m-%d-%H-%M-%S}-drone-{system}.mcap")
        told = {"recorded": {"by": "lab", "began": began.isoformat(timespec="milliseconds")}}
        begun: Recording | None = None
        self.name = path.name  # before the file is there: whoever finds it then knows that it cannot be read yet
        try:
            async with record(self._drone, path, None, told, self._flying, overwrite=False) as recording:
                begun = recording
                await self._until(armed=False)
                with suppress(TimeoutError):
                    async with asyncio.timeout(AFTER_S):
                        await self._until(armed=True)
        finally:
            if begun is not None and not begun.samples:  # a log without a sample cannot be read
                path.unlink(missing_ok=True)
            self.name = ""
            if path.exists():
                self._recorded(path.name)

    async def _until(self, armed: bool) -> None:
        session = self._drone.session
        while self._drone.state.armed != armed:
            session.check(session.now)
            await asyncio.sleep(LOOK_S)
