"""The flight controller's server: its links, the control loop in real time or in lockstep, and a clean end."""

import asyncio
import gc
import time
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

from twodof.errors import LinkError, LinkLost
from twodof.fcu.control.loop import FlightController, TimeRestarted
from twodof.fcu.control.real_time import Pacer, Watchdog
from twodof.fcu.mavlink.service import Service
from twodof.link.connection import Connection, Received
from twodof.link.mavlink.dialect import AUTOPILOT
from twodof.link.mavlink.framing import looks_like_a_stop
from twodof.link.signing import Signing
from twodof.link.transport import open_transport
from twodof.signals import TICK_NS

RESPONSIVE_S = 0.004
"""Longest work of the loop in lockstep before other tasks run [s]."""

TURN_S = 0.0005
"""Longest work of a flooded link before other tasks run, above all the control loop [s]."""

REOPEN_S = 0.5
"""Time between attempts to open a lost link again [s]."""

WAIT_S = 60.0
"""Longest wait for a packet in one call [s]."""

IDLE_S = 1.0
"""Time without a tick in lockstep after which `idle` is called [s]."""

PEERS_TICKS = 25
"""Periods between searches for peers that have gone."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A peer on one of the links, in `Received.peer` and for `Server.send`."""

    connection: Connection
    there: Hashable


class Server:
    """Server of `controller` as MAVLink system `system`, component 1, over any number of links.

    `services` get each message in their order, until one consumes it, and each step. A link never gives the place of
    the `pilot`, the client that commands, to another. A fault in a service ends `run` with its exception: motors off is
    the safe state, half a program is not. Use the server as a context manager: leaving it stops the motors and closes
    the links.
    """

    def __init__(
        self,
        controller: FlightController,
        system: int,
        signing: Signing | None = None,
        pilot: Callable[[], tuple[int, int] | None] = lambda: None,
    ) -> None:
        self.controller = controller
        self.system = system
        self.signing = signing
        self.services: list[Service] = []
        self.connections: list[Connection] = []
        self._dropped = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._failed: asyncio.Event = asyncio.Event()
        self._peers: dict[Peer, tuple[int, int]] = {}  # as whom it spoke last
        self._pilot = pilot
        self._time = asyncio.Lock()
        controller.bus.subscribe(TimeRestarted, self._restart_services)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def listen(self, url: str) -> str:
        """Open a link and return its URL, with the port that the system chose for port 0. Raises LinkError."""
        connection = await self._open(url)
        task = asyncio.create_task(self._serve(connection, url), name=f"link {url}")
        self._tasks.add(task)
        task.add_done_callback(lambda _: self._failed.set())
        return connection.transport.url

    def send(self, message: Any, peer: Hashable | None = None) -> None:
        """Send to one Peer, or to all; a message that a peer refuses, or that does not fit, is dropped and counted."""
        assert peer is None or isinstance(peer, Peer), f"{peer!r} is no peer of a server"
        for connection in self.connections if peer is None else (peer.connection,):
            try:
                connection.send(message, None if peer is None else peer.there)
            except LinkError:
                self._dropped += 1

    @property
    def lost(self) -> int:
        """Return the number of messages lost to full queues, closed links and values that do not fit their fields."""
        return self._dropped + sum(connection.transport.counts.dropped_out for connection in self.connections)

    async def run(self) -> None:
        """Run until cancelled. Raises the first exception of the control loop or a service."""
        time_passes = self._watch_time if self.controller.lockstep else self._run_real_time
        loop = asyncio.create_task(time_passes(), name="control loop")
        loop.add_done_callback(lambda _: self._failed.set())
        try:
            while True:
                await self._failed.wait()
                self._failed.clear()
                for task in (loop, *self._tasks):
                    if task.done():
                        task.result()
        finally:
            loop.cancel()
            await asyncio.gather(loop, return_exceptions=True)
            self.controller.hardware.stop()

    async def close(self) -> None:
        """Stop the motors and close the links; a second call does nothing."""
        self.controller.hardware.stop()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()
        for connection in self.connections:
            await connection.transport.close()
        self.connections.clear()
        if self.signing is not None:
            self.signing.close()

    async def _run_real_time(self) -> None:
        controller, pacer = self.controller, Pacer(TICK_NS)
        # What stands now is never garbage, and looking through it takes the collector half a control period.
        gc.freeze()
        watchdog = Watchdog(controller.stop, patient=controller.hardware.virtual)
        try:
            while True:
                due = await pacer.wait()
                controller.timing.began(pacer.late_ns)
                if pacer.missed > controller.timing.missed and not controller.hardware.virtual:
                    # The program stood still, its watchdog too, while the motors ran on and no timer of the flight
                    # code counted. A virtual rig stood still with it.
                    controller.stop()
                controller.timing.missed = pacer.missed
                for number in range(due):
                    if number:
                        await asyncio.sleep(0)  # what has come in the meantime acts now
                    self._step()
                    watchdog.beat()
        finally:
            watchdog.close()
            pacer.close()

    async def _watch_time(self) -> None:
        """Call `idle` of the services in lockstep while time stands still."""
        while True:
            tick = self.controller.tick
            await asyncio.sleep(IDLE_S)
            if self.controller.tick == tick:
                self._look_for_gone()
                for service in self.services:
                    service.idle()

    async def _run_granted(self) -> None:
        controller = self.controller
        async with self._time:
            end = time.monotonic() + RESPONSIVE_S
            while controller.tick < controller.granted:
                self._step()
                if time.monotonic() > end:
                    await asyncio.sleep(0)
                    end = time.monotonic() + RESPONSIVE_S

    def _restart_services(self, _: TimeRestarted) -> None:
        for service in self.services:
            service.restart()

    def _step(self) -> None:
        step = self.controller.step()
        for service in self.services:
            service.after(step)
        if step.tick % PEERS_TICKS == 0:
            self._look_for_gone()

    async def _open(self, url: str) -> Connection:
        connection = Connection(await open_transport(url), self.system, AUTOPILOT, self.signing)
        connection.transport.keeps = lambda there: self._is_pilots(Peer(connection, there))
        self.connections.append(connection)
        return connection

    def _is_pilots(self, peer: Peer) -> bool:
        pilot = self._pilot()
        return pilot is not None and self._peers.get(peer) == pilot

    async def _serve(self, connection: Connection, url: str) -> None:
        """Receive the messages of a link; a lost link is opened again until it is there."""
        while True:
            with suppress(LinkLost):
                while True:
                    received = await connection.receive(WAIT_S)
                    end = time.monotonic() + TURN_S
                    while received is not None:
                        await self._take(connection, received)
                        if time.monotonic() > end:
                            await asyncio.sleep(0)
                            end = time.monotonic() + TURN_S
                        received = connection.receive_now()
            self.connections.remove(connection)
            while connection.transport.closed:
                with suppress(LinkError):
                    connection = await self._open(url)
                    break
                await asyncio.sleep(REOPEN_S)

    async def _take(self, connection: Connection, received: Received) -> None:
        peer = Peer(connection, received.peer)
        if connection.transport.is_unplaced(received.peer):  # to welcome thousands of them would keep it from flying
            if not looks_like_a_stop(received.frame.raw):
                return
        else:
            self._peers[peer] = received.frame.system, received.frame.component
        received = received._replace(peer=peer)
        for service in self.services:
            if service.handle(received):
                break
        if self.controller.lockstep and self.controller.granted > self.controller.tick:
            # What this link says after a grant belongs to the ticks after those that it grants.
            await self._run_granted()

    def _look_for_gone(self) -> None:
        for peer in [*self._peers]:
            transport = peer.connection.transport
            if transport.closed or peer.there not in transport.peers:
                del self._peers[peer]
                for service in self.services:
                    service.gone(peer)
