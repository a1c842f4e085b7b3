"""Laboratory of one server: its drones, its processes, its logs and its clients."""

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Self

from fastapi import Depends
from fastapi.requests import HTTPConnection

from twodof.blocks.schema.json_form import MAX_BYTES as DIAGRAM_BYTES
from twodof.errors import LogError, Rejected, TwodofError
from twodof.excitation import Doublet
from twodof.experiment.prediction import predicted
from twodof.flight.gains import DEFAULT
from twodof.lab.access import Role
from twodof.lab.drones.lab_drone import LabDrones
from twodof.lab.flights import drawn
from twodof.lab.folders import LogShelf, NamedFiles
from twodof.lab.models import ModelFolder, TuningGuard
from twodof.lab.processes import MOST_WAITING, Jobs, Workbench
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_rows import Audience
from twodof.lab.turns import Turns
from twodof.signals import HOVER

WARM_UP_S = 600.0
PATIENCE_S = 5.0
"""Longest wait of a preview for the warm-up [s]."""


class LabServer:
    """Drones, jobs and clients of one server; `async with` connects to the drones and leaves them.

    `summaries` are those of logs, by path, time of the last change [ns] and size [byte].
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
        self.logs = LogShelf(settings.folder, settings.logs)
        self.summaries: dict[tuple[str, int, int], dict[str, Any]] = {}
        self.log_bench = Workbench("log", LogError, 30.0)
        self.exports = {role: Turns(2, MOST_WAITING, "export") for role in Role}
        self._warming: asyncio.Task[None] | None = None

    def whole_log(self, name: str, ours: bool = False) -> Path:
        """Return the place of a log; if `ours`, one that may be changed.

        Raises NotThere, and Rejected for a log in another folder, and while it is being recorded.
        """
        path = self.logs.ours(name) if ours else self.logs.place(name)
        if name in self.drones.recordings:
            raise Rejected("the log is being recorded", name[:80], "disarm the drone first")
        return path

    async def __aenter__(self) -> Self:
        self.drones.start()
        if self.settings.warm_up:
            self._warming = asyncio.create_task(self._warm_up())
        return self

    async def _warm_up(self) -> None:
        with suppress(TwodofError):  # a preview then says why
            played = Doublet(0.1, 1.0, unit="rad").to_dict()
            await self.log_bench.do(drawn, played, 2, seconds=WARM_UP_S)
            await self.workbench.do(predicted, played, "theta", "lab", HOVER, 0.0, False, DEFAULT, seconds=WARM_UP_S)

    async def is_warm(self) -> bool:
        """Return True if the virtual rig is compiled for previews; wait for it up to `PATIENCE_S`."""
        if self._warming is not None:
            await asyncio.wait([self._warming], timeout=PATIENCE_S)
        return self._warming is None or self._warming.done()

    async def __aexit__(self, *_: object) -> None:
        if self._warming is not None:
            self._warming.cancel()
        await self.jobs.close()
        await self.guard.close()
        await self.workbench.close()
        await self.log_bench.close()
        await self.drones.close()


async def current_lab(connection: HTTPConnection) -> LabServer:
    """Return the laboratory of the server that serves this request."""
    lab = connection.app.state.lab
    assert isinstance(lab, LabServer)
    return lab


CurrentLab = Annotated[LabServer, Depends(current_lab)]
