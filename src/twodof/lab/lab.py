"""Laboratory of one server: its drones, its processes, its logs and its clients."""

from __future__ import annotations

from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated, Any, Self

from fastapi import Depends
from fastapi.requests import HTTPConnection

from twodof.blocks.schema.json_form import MAX_BYTES as DIAGRAM_BYTES
from twodof.errors import LogError, Rejected
from twodof.lab.drones.lab_drone import LabDrones
from twodof.lab.folders import LogShelf, NamedFiles
from twodof.lab.models import ModelFolder, TuningGuard
from twodof.lab.processes import Jobs, Workbench
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_rows import Audience


class Lab:
    """Drones, jobs and clients of one server; `async with` connects to the drones and leaves them.

    `stops` are the events that end flights, `rehearsed` the diagrams of rehearsals, both by the job's id. `summaries`
    are those of logs, by path, time of the last change [ns] and size [byte].
    """

    def __init__(self, settings: LabSettings) -> None:
        self.settings = settings
        self.audience = Audience()
        self.drones = LabDrones(settings, self.audience)
        self.jobs = Jobs(self.audience.tell)
        self.workbench = Workbench()
        self.models = ModelFolder(settings.folder / "models")
        self.diagrams = NamedFiles(settings.folder / "diagrams", ".json", "diagram", 1000, DIAGRAM_BYTES)
        self.snapshots = NamedFiles(settings.folder / "snapshots", ".params", "snapshot", 500)
        self.guard = TuningGuard(self.models, self.workbench)
        self.stops: dict[str, Event] = {}
        self.logs = LogShelf(settings.folder, settings.logs)
        self.summaries: dict[tuple[str, int, int], dict[str, Any]] = {}
        self.log_bench = Workbench("log", LogError)
        self.rehearsed: dict[str, str] = {}

    def whole_log(self, name: str) -> Path:
        """Return the place of a readable log. Raises NotThere, and Rejected while it is being recorded."""
        path = self.logs.place(name)
        if name in self.drones.recordings:
            raise Rejected("the log is being recorded", name[:80], "disarm the drone first")
        return path

    async def __aenter__(self) -> Self:
        self.drones.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.jobs.close()
        await self.workbench.close()
        await self.log_bench.close()
        await self.drones.close()


def current_lab(connection: HTTPConnection) -> Lab:
    """Return the laboratory of the server that serves this request."""
    lab = connection.app.state.lab
    assert isinstance(lab, Lab)
    return lab


CurrentLab = Annotated[Lab, Depends(current_lab)]
