"""The flight controller's shell: links in and out, the control loop in real time or as it is granted, a clean end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Self

from twodof.errors import LinkError, LinkLost
from twodof.fcu.loop import PERIOD_NS, FlightController
from twodof.fcu.pacing import Pacer
from twodof.fcu.service import Service
from twodof.fcu.watchdog import Watchdog
from twodof.link.connection import Connection, Received
from twodof.link.opening import open_transport
from twodof.link.signing import Signing
from twodof.link.url import parse

AUTOPILOT = 1
"""MAVLink component of the flight controller."""

RESPONSIVE_S = 0.004
"""In lockstep the loop lets others run after so much work [s]."""

REOPEN_S = 0.5
"""Between attempts to open a link again that was lost."""

PEERS_TICKS = 25
"""Periods between looks at who has gone."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A peer of one of the links: what `Received.peer` holds and `Server.send` takes."""

    connection: Connection
    there: Hashable


class Server:
    """Speaks for `controller` as MAVLink system `system`, component 1, over any number of links.

    `services` get each message in their order, until one takes it, and each step. Use it as a context manager: leaving
    it stops the motors and closes the links.
    """

    def __init__(self, controller: FlightController, system: int, signing: Signing | None = None) -> None:
        self.controller = controller
        self.system = system
        self.signing = signing
        self.services: list[Service] = []
        self.ignored = 0
        self.dropped = 0
        self.connections: list[Connection] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._peers: set[Peer] = set()
        self._granted = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self._watchdog: Watchdog | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def listen(self, url: str) -> str:
        """Opens a link and returns its URL, with the port that the system chose for port 0. Raises LinkError."""
        connection = await self._open(url)
        task = asyncio.create_task(self._serve(connection, url), name=f"link {url}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        address, port = parse(url), getattr(connection.transport, "port", 0)
        return str(replace(address, port=port) if address.listens and port else address)

    def send(self, message: Any, peer: Hashable | None = None) -> None:
        """Sends to one peer, or to all; what a peer does not take, or is malformed, is dropped and counted."""
        targets: Iterable[tuple[Connection, Hashable | None]]
        if peer is None:
            targets = [(connection, None) for connection in self.connections]
        elif isinstance(peer, Peer):
            targets = [(peer.connection, peer.there)]
        else:
            self.dropped += 1
            return
        for connection, there in targets:
            try:
                connection.send(message, there)
            except LinkError:
                self.dropped += 1

    @property
    def lost(self) -> int:
        """Messages that did not go out: queues were full, links gone, values that fit no field."""
        return self.dropped + sum(connection.transport.counts.dropped_out for connection in self.connections)

    def alive(self, peer: Hashable) -> bool:
        """Whether a peer is still connected."""
        return isinstance(peer, Peer) and peer.there in peer.connection.transport.peers

    async def run(self) -> None:
        """Runs the control loop until it is cancelled."""
        if self.controller.lockstep:
            await self._run_lockstep()
        else:
            await self._run_real_time()

    async def close(self) -> None:
        """Motors off, links closed; a second time does nothing."""
        if self._watchdog is not None:
            self._watchdog.close()
            self._watchdog = None
        self.controller.hardware.stop()
        tasks = [*self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for connection in self.connections:
            await connection.transport.close()
        self.connections.clear()
        if self.signing is not None:
            self.signing.close()

    async def _run_real_time(self) -> None:
        controller, pacer = self.controller, Pacer(PERIOD_NS)
        self._watchdog = watchdog = Watchdog(controller.stop)
        try:
            while True:
                due = await pacer.wait()
                controller.timing.began(pacer.late_ns)
                controller.timing.missed = pacer.missed
                for number in range(due):
                    if number:
                        await asyncio.sleep(0)  # what has come in the meantime acts now
                    self._step()
                watchdog.beat()
        finally:
            watchdog.close()
            pacer.close()

    async def _run_lockstep(self) -> None:
        controller = self.controller
        while True:
            await self._granted.wait()
            self._granted.clear()
            end = time.monotonic() + RESPONSIVE_S
            while controller.tick < controller.granted:
                self._step()
                if time.monotonic() > end:
                    await asyncio.sleep(0)
                    end = time.monotonic() + RESPONSIVE_S
            self._idle.set()

    def _step(self) -> None:
        step = self.controller.step()
        for service in self.services:
            service.after(step)
        if step.tick % PEERS_TICKS == 0:
            self._look_for_gone()

    async def _open(self, url: str) -> Connection:
        transport = await open_transport(url)
        connection = Connection(transport, self.system, AUTOPILOT, self.signing)
        self.connections.append(connection)
        return connection

    async def _serve(self, connection: Connection, url: str) -> None:
        """Takes in what comes over a link; one that was lost is opened again until it is there."""
        while True:
            with suppress(LinkLost):
                while True:
                    received = await connection.receive(1.0)
                    if received is not None:
                        await self._take(connection, received)
            self.connections.remove(connection)
            while True:
                with suppress(LinkError):
                    connection = await self._open(url)
                    break
                await asyncio.sleep(REOPEN_S)

    async def _take(self, connection: Connection, received: Received) -> None:
        peer = Peer(connection, received.peer)
        self._peers.add(peer)
        received = received._replace(peer=peer)
        for service in self.services:
            if service.handle(received):
                break
        else:
            self.ignored += 1
        controller = self.controller
        if controller.lockstep and controller.granted > controller.tick:
            # What this link says after a grant belongs to the ticks after those that it grants.
            self._idle.clear()
            self._granted.set()
            await self._idle.wait()

    def _look_for_gone(self) -> None:
        for peer in [peer for peer in self._peers if not self.alive(peer)]:
            self._peers.discard(peer)
            for service in self.services:
                gone: Callable[[Hashable], None] | None = getattr(service, "gone", None)
                if gone is not None:
                    gone(peer)
