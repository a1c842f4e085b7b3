"""LabDrones: every drone that the server is connected to, or tries to be, by its number."""

from __future__ import annotations

import asyncio
from typing import Any

from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.refusals import NotThere
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry.audience import Audience
from twodof.link.transport import ports

MOST = 8
CLOSE_S = 8.0
"""What leaving all drones may take: each is disarmed if it was ours."""


class LabDrones:
    """The drones at the URLs of the settings; none given: those that run on this computer, as they come."""

    def __init__(self, settings: LabSettings, audience: Audience) -> None:
        places = [f"udp://127.0.0.1:{ports.COMPANION_ONBOARD + index}" for index in range(MOST)]
        self._always = bool(settings.connect)
        self._drones = [LabDrone(url, settings, audience) for url in settings.connect or places]
        self._tasks: list[asyncio.Task[None]] = []

    def __getitem__(self, number: int) -> LabDrone:
        """The drone of that MAVLink system. Raises NotThere."""
        for one in self._drones:
            if one.number == number:
                return one
        known = [str(one.number) for one in self._drones if one.number]
        raise NotThere("there is no such drone", f"drone {number}", f"there are: {', '.join(known) or 'none yet'}")

    @property
    def all(self) -> list[LabDrone]:
        """Those that were heard."""
        return sorted((one for one in self._drones if one.number), key=lambda one: one.number)

    @property
    def states(self) -> list[dict[str, Any]]:
        """How they stand."""
        return [one.state for one in self.all]

    @property
    def recordings(self) -> frozenset[str]:
        """Names of the logs that are being recorded: they cannot be read yet."""
        return frozenset(str(state.get("recording") or "") for state in self.states) - {""}

    def start(self) -> None:
        """Begin to connect."""
        self._tasks = [asyncio.create_task(one.run()) for one in self._drones]

    async def close(self) -> None:
        """Leave all: those that were ours stand disarmed."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_S)
