"""Lab: what one server holds: its drones, its jobs, and the events that its clients are told."""

from __future__ import annotations

from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Self

from twodof.errors import LogError, Rejected
from twodof.lab.drones.drones import LabDrones
from twodof.lab.jobs.jobs import Jobs
from twodof.lab.logbook.log_folder import LogShelf
from twodof.lab.logbook.summary_cache import SummaryCache
from twodof.lab.models.model_folder import ModelFolder
from twodof.lab.models.tuning_guard import TuningGuard
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry.audience import Audience
from twodof.lab.workbench.workbench import Workbench


class Lab:
    """The drones, jobs and clients of one server; for `async with`, which connects and, at the end, leaves them.

    `stops` end the flights of jobs, by the job's id; `rehearsed` are the diagrams whose flash was rehearsed, by theirs.
    """

    def __init__(self, settings: LabSettings) -> None:
        self.settings = settings
        self.audience = Audience()
        self.drones = LabDrones(settings, self.audience)
        self.jobs = Jobs(self.audience.tell)
        self.workbench = Workbench()
        self.models = ModelFolder(settings.folder / "models")
        self.guard = TuningGuard(self.models, self.workbench)
        self.stops: dict[str, Event] = {}
        self.logs = LogShelf(settings.folder, settings.logs)
        self.summaries = SummaryCache()
        self.log_bench = Workbench("log", LogError)
        self.rehearsed: dict[str, str] = {}

    def whole_log(self, name: str) -> Path:
        """Where a log is that can be read. Raises NotThere, and Rejected while it is being recorded."""
        path = self.logs.place(name).path
        if name in self.drones.recordings:
            raise Rejected("it is being recorded", name[:80], "disarm the drone first")
        return path

    async def __aenter__(self) -> Self:
        self.drones.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.jobs.close()
        await self.workbench.close()
        await self.log_bench.close()
        await self.drones.close()
