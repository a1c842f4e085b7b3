"""Drone: AsyncDrone for scripts and notebooks, made of it at import; drone.pyi shows it to editors and to mypy."""

from __future__ import annotations

from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.files import AsyncFiles, AsyncLogs
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.sync_drone import SyncDrone
from twodof.gcs.sync_face import SyncFace, synchronous


@synchronous(AsyncFiles)
class DroneFiles(SyncFace):
    """Files on board: descriptions, logs, controllers. Calls raise Rejected, LinkLost and Timeout."""


@synchronous(AsyncLogs)
class DroneLogs(SyncFace):
    """The logs on board."""


@synchronous(AsyncDrone)
class Drone(SyncDrone):
    """A drone, real or virtual: `with Drone.connect(url) as drone:`; leaving disarms it and lets others command.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None:
        super().__init__(there, runner)
        self.logs = DroneLogs(there.logs, runner)
        self.files = DroneFiles(there.files, runner)
