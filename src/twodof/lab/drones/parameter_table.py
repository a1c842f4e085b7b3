"""Table of one drone's parameters, kept up to date by its messages."""

import asyncio
from collections.abc import Callable

from twodof.errors import Rejected, Timeout
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.parameters import ParameterEntry

LOOK_S = 0.1
SETTLES_S = 1.0
"""Pause after a change before the active controller is read again [s]."""


class ParameterTable:
    """Parameters and active controller of one drone; `changed` is called with the names of changed parameters."""

    def __init__(self, drone: AsyncDrone, changed: Callable[[list[str]], None]) -> None:
        self._drone, self._tell = drone, changed
        self._values: dict[str, float] = {}
        self._listed: frozenset[str] = frozenset()
        self._asking = asyncio.Lock()
        self._active: ActiveController | None = None
        self._stale_since: float | None = drone.session.now
        self._flown = drone.state.rig.diagram

    async def entries(self) -> list[ParameterEntry]:
        """Return all parameters with the drone's descriptions. Raises LinkLost, Timeout."""
        parameters = self._drone.parameters
        async with self._asking:
            if not self._listed or self._listed != parameters.known.keys():
                if self._drone.ours:
                    await parameters.describe()
                self._listed = frozenset(await parameters.all()) | parameters.known.keys()
            return [parameters.known[name] for name in sorted(self._listed)]

    async def active(self) -> ActiveController:
        """Return the active controller, read again if it may have changed. Raises LinkLost, Timeout."""
        self._look()
        if self._active is None or self._stale_since is not None:
            await self._read()
        return self._active or ActiveController(known=False)

    async def run(self) -> None:
        """Report changes, and read the active controller while disarmed. Raises LinkLost."""
        session = self._drone.session
        while True:
            session.check(session.now)
            self._look()
            since = self._stale_since
            if since is not None and session.now - since > SETTLES_S and not self._drone.state.armed:
                try:
                    await self._read()
                except (Rejected, Timeout):
                    self._stale_since = session.now
            await asyncio.sleep(LOOK_S)

    def _look(self) -> None:
        """Compare values and diagram with those of the look before."""
        diagram = self._drone.state.rig.diagram
        now = {name: entry.value for name, entry in self._drone.parameters.known.items()}
        changed = [name for name, value in now.items() if self._values.get(name, value) != value]
        self._values |= now
        if changed or diagram != self._flown:
            self._flown, self._stale_since = diagram, self._drone.session.now
        if changed:
            self._tell(sorted(changed))

    async def _read(self) -> None:
        async with self._asking:
            before = self._stale_since
            self._active = await self._drone.active_controller()
            if self._stale_since == before:  # nothing has changed meanwhile
                self._stale_since = None
