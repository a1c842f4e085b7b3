"""Table of one drone's parameters, kept up to date by its messages."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from twodof.errors import Rejected, Timeout
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.parameters import MOST, ParameterEntry, entry_of

LOOK_S = 0.1
SETTLES_S = 1.0
"""Pause after a change before the active controller is read again [s]."""
HASH = "_HASH_CHECK"


class ParameterTable:
    """Parameters and active controller of one drone; `changed` is called with the names of changed parameters."""

    def __init__(self, drone: AsyncDrone, changed: Callable[[list[str]], None]) -> None:
        self._drone, self._tell = drone, changed
        self._values: dict[str, float] = {}
        self._changed: set[str] = set()
        self._listed: frozenset[str] = frozenset()
        self._asking = asyncio.Lock()
        self._active: ActiveController | None = None
        self._stale_since: float | None = drone.session.now
        self._flown = drone.state.rig.diagram
        drone.session.on(self._told, "PARAM_VALUE")

    async def entries(self) -> list[ParameterEntry]:
        """Return all parameters with the drone's descriptions. Raises LinkLost, Timeout."""
        parameters = self._drone.parameters
        async with self._asking:
            if not self._listed or not self._listed <= parameters.known.keys():
                if self._drone.ours:
                    await parameters.describe()
                self._listed = frozenset(await parameters.all())
            return [parameters.known[name] for name in sorted(self._listed)]

    async def active(self) -> ActiveController:
        """Return the active controller, read again if it may have changed. Raises LinkLost, Timeout."""
        if self._active is None or self._stale_since is not None:
            await self._read()
        return self._active or ActiveController(known=False)

    async def run(self) -> None:
        """Report changes, and read the active controller while disarmed. Raises LinkLost."""
        session, state = self._drone.session, self._drone.state
        while True:
            session.check(session.now)
            state = self._drone.state
            if self._changed:
                names, self._changed = sorted(self._changed), set()
                self._tell(names)
            if state.rig.diagram != self._flown:
                self._flown, self._stale_since = state.rig.diagram, session.now
            since = self._stale_since
            if since is not None and session.now - since > SETTLES_S and not state.armed:
                try:
                    await self._read()
                except (Rejected, Timeout):
                    self._stale_since = session.now
            await asyncio.sleep(LOOK_S)

    async def _read(self) -> None:
        async with self._asking:
            before = self._stale_since
            self._active = await self._drone.active_controller()
            if self._stale_since == before:  # nothing has changed meanwhile
                self._stale_since = None

    def _told(self, got: object) -> None:
        entry = entry_of(got)
        before = self._values.get(entry.name)
        if entry.name == HASH or (before is None and len(self._values) >= MOST):
            return
        self._values[entry.name] = entry.value
        if before is not None and before != entry.value:
            self._changed.add(entry.name)
            self._stale_since = self._drone.session.now
