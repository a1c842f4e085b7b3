"""Pilot: commands one drone for all clients together, and lets it down where nobody is there who may command."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.async_drone import AsyncDrone

LEASE_S = 4.0
"""A lease of somebody who is gone ends within it."""
LOOK_S = 0.25
LEVEL_S = 3.0
"""So long after the last client that may command has left, or stands still, it is levelled.

A page that is loaded again takes less.
"""
LEAVE_S = 10.0
"""So long after, it is disarmed, and others may command it."""


class Pilot:
    """Takes the lease with the first command and keeps it until it is given up, or nobody is there.

    `commanding` says how many clients are there that may command, `say` tells all clients a line about the drone.
    """

    def __init__(self, drone: AsyncDrone, commanding: Callable[[], int], say: Callable[[str, str], None]) -> None:
        self._drone, self._commanding, self._say = drone, commanding, say
        self._leasing = asyncio.Lock()
        self._asked = drone.session.now

    @asynccontextmanager
    async def commanded(self) -> AsyncIterator[AsyncDrone]:
        """The drone with the lease ours, taken where it is not. Raises Rejected where another keeps it, LinkLost."""
        drone = self._drone
        self._asked = drone.session.now
        async with self._leasing:
            if drone.ours and not (drone.lease.wanted and drone.lease.ours):
                await drone.lease.take(LEASE_S)
            drone.commanding = True
        yield drone

    async def give_up(self) -> None:
        """Let others command. Raises Rejected while it is armed and ours, LinkLost, Timeout."""
        drone = self._drone
        if drone.lease.ours and drone.state.armed:
            raise Rejected("it is armed", f"drone {drone.session.system}", "disarm it first")
        async with self._leasing:
            drone.setpoints.stop()
            await drone.lease.give_up(LEASE_S)
            drone.commanding = False

    async def watch(self) -> None:
        """Level it, disarm it and let others command where nobody is there who flies it. Raises LinkLost."""
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
        self._say("warning", f"every page that may command is gone or stands still for {LEVEL_S:g} s: it is levelled")
        try:
            await drone.stop_excitation()
            await drone.level_hold()
        finally:
            drone.stop_setpoints()  # its failsafe levels it then

    async def _leave(self) -> None:
        drone = self._drone
        if drone.state.armed:
            self._say(
                "warning", f"every page that may command is gone or stands still for {LEAVE_S:g} s: it is disarmed"
            )
            with suppress(LinkLost):
                await drone.disarm()
        await self.give_up()
