"""Pilot of a drone for all clients together, and the recorder of its flights."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from datetime import datetime
from pathlib import Path

from twodof.errors import LinkLost, LogError, Rejected, Timeout
from twodof.flightlog import numbered
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.recording import Recording, record
from twodof.lab.answers import full_disk, without_folders

LEASE_S = 4.0
"""Longest wait for the lease of a client that is gone."""
LOOK_S = 0.25
LEVEL_S = 3.0
"""Time without a client that may command, after which the drone is levelled; a page loads again in less."""
LEAVE_S = 10.0
"""Time without such a client, after which the drone is disarmed and the lease given up."""


class Pilot:
    """Pilot that takes the lease with the first command, and gives it up if no client is left.

    `commanding` returns the number of clients that may command; `say` sends a line about the drone to all clients.
    """

    def __init__(self, drone: AsyncDrone, commanding: Callable[[], int], say: Callable[[str, str], None]) -> None:
        self._drone, self._commanding, self._say = drone, commanding, say
        self._leasing = asyncio.Lock()
        self._asked = drone.session.now

    @asynccontextmanager
    async def commanded(self) -> AsyncIterator[AsyncDrone]:
        """Take the lease, if this server lacks it, and yield the drone. Raises Rejected, LinkLost, Timeout."""
        drone = self._drone
        self._asked = drone.session.now
        async with self._leasing:
            if drone.ours and not (drone.lease.wanted and drone.lease.ours):
                await drone.lease.take(LEASE_S)
            drone.commanding = True
        yield drone

    async def give_up(self) -> None:
        """Give the lease up. Raises Rejected while the drone is armed under it, LinkLost, Timeout."""
        drone = self._drone
        if drone.lease.ours and drone.state.armed:
            raise Rejected("the drone is armed", f"drone {drone.session.system}", "disarm it first")
        async with self._leasing:
            drone.setpoints.stop()
            await drone.lease.give_up(LEASE_S)
            drone.commanding = False

    async def watch(self) -> None:
        """Level the drone, then disarm it and give the lease up, if no client is left. Raises LinkLost."""
        session, levelled = self._drone.session, False
        while True:
            await asyncio.sleep(LOOK_S)
            session.check(session.now)
            if self._commanding():
                self._asked = session.now
            alone = session.now - self._asked
            if alone < LEVEL_S or not self._drone.lease.wanted:
                levelled = False
                continue
            with suppress(Rejected, Timeout):  # it is tried again at the next look
                if not levelled and self._drone.state.armed:
                    await self._level()
                levelled = True
                if alone >= LEAVE_S:
                    await self._leave()

    async def _level(self) -> None:
        drone = self._drone
        what = f"every page that may command is gone or stands still for {LEVEL_S:g} s: the drone is levelled"
        self._say("warning", what)
        try:
            await drone.stop_excitation()
            await drone.level_hold()
        finally:
            drone.stop_setpoints()  # its failsafe levels it then

    async def _leave(self) -> None:
        drone = self._drone
        if drone.state.armed:
            what = f"every page that may command is gone or stands still for {LEAVE_S:g} s: the drone is disarmed"
            self._say("warning", what)
            with suppress(LinkLost):
                await drone.disarm()
        await self.give_up()


RECORDER_LOOK_S = 0.02
AFTER_S = 1.0
"""Time after disarming that belongs to the flight [s]: the drone comes to rest."""
AGAIN_S = 5.0


class FlightRecorder:
    """Recorder of the flights of `drone` into `folder`.

    `flying` returns the active controller. `recorded` is called with the name of each finished file, `failed` with the
    reason why there is none. No recording starts while `rests` returns True. `name` is the file being written, ""
    between flights.
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
        """Record flight after flight until cancelled. Raises LinkLost."""
        session, failing = self._drone.session, False
        while True:
            failing &= self._drone.state.armed
            await self._until(armed=True)
            while self._rests() and self._drone.state.armed:
                session.check(session.now)
                await asyncio.sleep(RECORDER_LOOK_S)
            if not self._drone.state.armed:
                continue
            try:
                await self._record(failing)
            except (LogError, OSError, Rejected, Timeout) as error:
                if not failing:
                    why = without_folders(str(getattr(error, "what", error)))
                    remedy = ": make room on the server's disk" if full_disk(error) else ""
                    self._failed(f"this flight is not being recorded: {why}. It is tried every {AGAIN_S:g} s{remedy}")
                failing = True
                await asyncio.sleep(AGAIN_S)
            else:
                failing = False

    async def _record(self, failing: bool) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        began = datetime.now().astimezone()
        system = self._drone.session.system
        path = numbered(self._folder / f"{began:%Y-%m-%d-%H-%M-%S}-drone-{system}.mcap")
        told = {"recorded": {"by": "lab", "began": began.isoformat(timespec="milliseconds")}}
        begun: Recording | None = None
        if not failing:  # then it is named once samples are on the disk
            self.name = path.name  # before the file exists, so that nobody reads a file in writing
        try:
            async with record(self._drone, path, None, told, self._flying, overwrite=False) as recording:
                begun = recording
                await self._until(armed=False, recording=recording)
                with suppress(TimeoutError):
                    async with asyncio.timeout(AFTER_S):
                        await self._until(armed=True)
        finally:
            if begun is not None and not begun.acknowledged.samples:  # a log without a sample cannot be read
                path.unlink(missing_ok=True)
            self.name = ""
            if path.exists():
                self._recorded(path.name)

    async def _until(self, armed: bool, recording: Recording | None = None) -> None:
        """Wait for arming or disarming. Raises LinkLost; RecordingError once the disk has ended `recording`."""
        session = self._drone.session
        while self._drone.state.armed != armed:
            if recording is not None:
                if recording.failure is not None:
                    raise recording.failure
                if recording.acknowledged.samples:
                    self.name = recording.path.name
            session.check(session.now)
            await asyncio.sleep(RECORDER_LOOK_S)
