"""What the companion does with every link: read it until it breaks, and wait longer each time to open it again."""

import asyncio
from abc import ABC, abstractmethod

from twodof.companion.router import Router
from twodof.errors import LinkError, LinkLost
from twodof.link.mavlink.framing import Parser
from twodof.link.transport import open_transport
from twodof.link.transport.base import Packet, Transport

OPEN_S = 2.0
FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.1, 2.0


class CompanionLink(ABC):
    """A link at `url`, whose packets `take` gets."""

    transport: Transport

    def __init__(self, url: str, router: Router) -> None:
        self.url = url
        self.router = router
        self._wait = FIRST_BACK_OFF_S

    @abstractmethod
    def take(self, packet: Packet) -> None:
        """A packet that came."""

    @abstractmethod
    async def keep(self) -> None:
        """Read it, and open it again, for ever."""

    async def open(self) -> None:
        """Open it. Raises LinkError."""
        self.transport = await open_transport(self.url, OPEN_S)

    async def read(self) -> LinkLost:
        """Hand on what comes until the link is lost; why it was. Raises LinkError for a fault of ours."""
        lost: asyncio.Future[LinkLost] = asyncio.get_running_loop().create_future()

        def taken(packet: Packet) -> None:
            try:
                self.take(packet)
            except BaseException:  # the loop shows it; who waits for `lost` must end too
                if not lost.done():
                    lost.set_exception(LinkError("a frame was not passed on", self.url, "report the fault"))
                raise

        def ended(reason: LinkLost) -> None:
            if not lost.done():
                lost.set_result(reason)

        self.transport.hand_to(taken, ended)
        return await lost

    async def back_off(self, stood: bool) -> None:
        """Wait before it is opened again: longer than the last time, unless it `stood` meanwhile."""
        if stood:
            self._wait = FIRST_BACK_OFF_S
        await asyncio.sleep(self._wait)
        self._wait = min(2.0 * self._wait, LONGEST_BACK_OFF_S)

    def new_parser(self) -> Parser:
        """For a stream, or a peer, of which nothing has come yet."""
        return Parser(mavlink1=self.router.signing is None)
