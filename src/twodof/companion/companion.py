"""The companion: links to the flight controller and to clients, joined by a router."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Self

from twodof.companion.component import CompanionComponent, ComputerStatus, Traffic
from twodof.companion.links import ClientLink, VehicleLink
from twodof.companion.links import Serve as Serve
from twodof.companion.router import Router
from twodof.companion.uplink_queue import BITS_A_BYTE, NETWORK_FRAME, NETWORK_RATE, UplinkQueue
from twodof.errors import LinkError
from twodof.link.signing import Signing
from twodof.link.transport.url import parse

LOOK_S = 0.1
BEAT_S = 1.0


class Companion:
    """Router between the flight controller at `vehicle` (a URL) and clients at `serve`; a context manager.

    `system` is the vehicle's system id (1 to 255). With `signing` its own messages are signed, and only frames that are
    signed with that key pass or have any effect. Without it signed frames pass untouched. `line_rate` [byte/s] bounds
    what is sent to the flight controller. Its default is what a serial line's baud rate carries, and 1 Mbyte/s over a
    network; in memory nothing is bounded. `tell` is called each minute with a line for people while the flight
    controller is not reached, and when it is heard again.

    Raises LinkError if a client link cannot be opened; the flight controller may come later.
    """

    def __init__(
        self,
        vehicle: str,
        serve: Sequence[Serve],
        system: int = 1,
        signing: Signing | None = None,
        line_rate: float | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        address = parse(vehicle)
        overhead = 0 if address.kind == "serial" else NETWORK_FRAME
        if line_rate is None and address.kind not in ("mem", "memin"):
            line_rate = address.baud / BITS_A_BYTE if address.kind == "serial" else NETWORK_RATE
        self.vehicle = vehicle
        self.serve = tuple(serve)
        self.line = UplinkQueue(line_rate, overhead)
        self.ports: list[ClientLink] = []
        self._signing = signing
        self._system = system
        self._tell = tell
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        self.router = Router(self._system, self.line, loop.time, self._signing)
        self.component = CompanionComponent(self.router, ComputerStatus(self._traffic, loop.time))
        self._vehicle = VehicleLink(self.vehicle, self.router, self.component, self._tell)
        try:
            for one in self.serve:
                port = ClientLink(one, self._vehicle, self.component)
                await port.open()
                self.ports.append(port)
        except LinkError:
            await self.close()
            raise
        works = [self._look(), self._beat(), *(link.keep() for link in (self._vehicle, *self.ports))]
        self._tasks = [loop.create_task(work) for work in works]
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close all links."""
        for task in self._tasks:
            task.cancel()
        ended = await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks = []
        for port in self.ports:
            await port.transport.close()
        await self._vehicle.close()
        if self._signing is not None:
            self._signing.close()
        for end in ended:
            if isinstance(end, Exception):
                raise end

    async def run(self) -> None:
        """Route frames until cancelled. Raises the exception of the first part that fails."""
        await asyncio.gather(*self._tasks)

    @property
    def urls(self) -> list[tuple[str, str]]:
        """URL of each client link, with the port that the system chose for port 0, and the name of its rates."""
        return [(port.transport.url, port.serve.rates) for port in self.ports]

    @property
    def killed(self) -> bool:
        """True while the drone is killed, as it reports."""
        return self.router.killed

    async def _look(self) -> None:
        """Let all links act on the clock."""
        while True:
            await asyncio.sleep(LOOK_S)
            now = self.router.clock()
            for port in self.ports:
                port.look(now)
            self._vehicle.look(now)

    async def _beat(self) -> None:
        while True:
            self.component.beat()
            await asyncio.sleep(BEAT_S)

    def _traffic(self) -> list[Traffic]:
        """Return the traffic of the line, then of the client links."""
        rows = [Traffic(self.line.sent_bytes, self._vehicle.bytes_in, self.line.rate or 0.0)]
        return rows + [Traffic(port.transport.counts.bytes_out, port.transport.counts.bytes_in) for port in self.ports]
