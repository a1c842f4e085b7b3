"""A flight controller by script on one link, and waiting that ends: for tests of the companion as a whole."""

import asyncio
from collections.abc import Callable
from typing import Any, Self

from tests.patience import PATIENCE_S
from twodof.errors import LinkLost
from twodof.link.connection import Connection, Received
from twodof.link.mavlink.messages import message
from twodof.link.transport.base import Transport

PERIOD_S = 0.004


class End:
    """One end of a link, which keeps what it hears."""

    def __init__(self, transport: Transport, system: int, component: int) -> None:
        self.connection = Connection(transport, system, component)
        self.received: list[Received] = []
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """End, and the link with it."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        await self.connection.close()

    async def _run(self) -> None:
        raise NotImplementedError


class Vehicle(End):
    """Streams ATTITUDE at 250 Hz and a heartbeat at 1 Hz over `transport`, acknowledges commands, keeps what it hears.

    `silent` lets it fall silent and deaf; in `lockstep` it only answers. `steps` periods pass at once:
    where a test lets minutes pass, 125 cost it less.
    """

    def __init__(self, transport: Transport, lockstep: bool = False) -> None:
        super().__init__(transport, 1, 1)
        self.lockstep = lockstep
        self.silent = False
        self.steps = 1
        self.asked: dict[int, float] = {}
        self.tick = 0

    def heard(self, name: str, system: int | None = None) -> list[Any]:
        """The messages of a name that came, from a system if given."""
        return [
            one.message
            for one in self.received
            if one.message.get_type() == name and system in (None, one.frame.system)
        ]

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due += PERIOD_S * self.steps
            while (got := await self.connection.receive(max(0.0, due - loop.time()))) is not None:
                if not self.silent:
                    self._take(got)
            if self.silent or self.lockstep:
                continue
            self._step()

    def _step(self) -> None:
        try:
            self.connection.send(message("ATTITUDE", time_boot_ms=4 * self.tick, yawspeed=1.0))
            if self.tick % 250 < self.steps:
                self.connection.send(message("HEARTBEAT", type=2, autopilot=12))
        except LinkLost:
            return
        self.tick += self.steps

    def _take(self, got: Received) -> None:
        self.received.append(got)
        one = got.message
        to = {"target_system": got.frame.system, "target_component": got.frame.component}
        if one.get_type() == "COMMAND_LONG":
            if one.command == 511:
                self.asked[int(one.param1)] = one.param2
            self.connection.send(message("COMMAND_ACK", command=one.command, **to), got.peer)
        elif one.get_type() == "TWODOF_GRANT":
            self.connection.send(message("TWODOF_TICK", tick=one.until, until=one.until, number=one.number), got.peer)


async def until(true: Callable[[], bool], seconds: float = PATIENCE_S) -> None:
    """Wait until something is true; a test that waits longer than that has failed."""
    async with asyncio.timeout(seconds):
        while not true():
            await asyncio.sleep(0.002)


class Listener(End):
    """A client that keeps what it hears, and speaks once a second unless told to be silent."""

    def __init__(self, transport: Transport, system: int = 250, component: int = 190, beats: bool = True) -> None:
        super().__init__(transport, system, component)
        self.beats = beats

    def heard(self, name: str, component: int | None = None) -> list[Any]:
        """The messages of a name that came, from a component if given."""
        return [
            one.message
            for one in self.received
            if one.message.get_type() == name and component in (None, one.frame.component)
        ]

    def command(self, number: int, *params: float, component: int = 1) -> None:
        """Send a command to system 1."""
        fields = {f"param{place}": value for place, value in enumerate(params, 1)}
        there = {"target_system": 1, "target_component": component}
        self.connection.send(message("COMMAND_LONG", command=number, **there, **fields))

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            if self.beats and loop.time() >= due:
                self.connection.send(message("HEARTBEAT", type=6, autopilot=8))
                due += 1.0
            got = await self.connection.receive(max(0.01, due - loop.time()) if self.beats else 1.0)
            if got is not None:
                self.received.append(got)
