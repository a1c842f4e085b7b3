"""The link to the flight controller: kept up, told of when it comes and goes, and given what waits for it."""

import asyncio
from collections.abc import Callable, Hashable, Sequence

from twodof.companion.companion_link import LONGEST_BACK_OFF_S, CompanionLink
from twodof.companion.component import CompanionComponent
from twodof.companion.router import Router
from twodof.errors import LinkError
from twodof.link.connection import BROKEN_OFF_S
from twodof.link.mavlink.framing import Frame
from twodof.link.signing import SigningVerdict
from twodof.link.transport.base import Packet

# Its heartbeat comes each second.
VEHICLE_SILENT_S = 3.0
# How often it is repeated that the flight controller is not there.
REMIND_S = 60.0


class VehicleLink(CompanionLink):
    """The link to the flight controller at `url`; `tell` gets a line for people where it is not reached, if given."""

    def __init__(
        self, url: str, router: Router, component: CompanionComponent, tell: Callable[[str], None] | None
    ) -> None:
        super().__init__(url, router)
        self.lost = 0  # how often
        self.bytes_in = 0  # bytes
        self._component = component
        self._tell = tell or (lambda text: None)
        self._parser = self.new_parser()
        self._peer: Hashable = None
        self._opened = self._fed = self._last_frame = 0.0
        self._there = False
        self._complaint, self._complained = "", 0.0
        self._pumping: asyncio.TimerHandle | None = None

    async def keep(self) -> None:
        """Open it, read it until it breaks, and so on for ever."""
        said = False
        while True:
            try:
                await self.open()
            except LinkError as error:
                if not said:
                    self._component.link(False, f"flight controller not reached: {error.what}")
                    said = True
                self._complain(error)
                await self.back_off(stood=False)
                continue
            self._parser = self.new_parser()
            self.router.line.connect(self.transport)
            self.router.started()
            self._opened = self.router.clock()
            reason = await self.read()
            self.router.line.cut()
            self.lost += 1
            self._heard(False, f"flight controller lost: {reason.what}")
            await self.back_off(stood=self.router.clock() - self._opened > LONGEST_BACK_OFF_S)

    async def close(self) -> None:
        """Close it, if it is open."""
        if self._pumping is not None:
            self._pumping.cancel()
        if self.router.line.transport is not None:
            await self.router.line.transport.close()

    def take(self, packet: Packet) -> None:
        """A packet of the flight controller."""
        self._fed, self._peer = self.router.clock(), packet.peer
        self.bytes_in += len(packet.data)
        self._pass_on(self._parser.feed(packet.data, self.transport.whole))
        self.pump()

    def look(self, now: float) -> None:
        """By the clock: see what broke off, what was not answered, and whether the flight controller is silent."""
        if self.router.line.transport is not None:  # what broke off with the link is no sign of life
            if now - self._fed > BROKEN_OFF_S and self._parser.waiting:
                self._pass_on(self._parser.feed(b"", whole=True))
            if self._there and now - self._last_frame > VEHICLE_SILENT_S:
                self._heard(False, f"flight controller silent for {VEHICLE_SILENT_S:g} s")
                self.router.started()  # it may come back as one that was started anew
            if not self._there and now - max(self._opened, self._last_frame) > VEHICLE_SILENT_S:
                what, remedy = "the link stands, and no heartbeat comes", "see that it runs, and at this baud rate"
                if self.router.signing is not None and self.router.signing.counts.refused:
                    remedy += ", and with this key"
                self._complain(LinkError(what, self.url, f"{remedy} or address"))
            self.router.subscriptions.asking.poll(now)
        self.pump()

    def pump(self) -> None:
        """Send what waits as soon as the line has room."""
        if self._pumping is None and self.router.line.waiting:
            delay = self.router.line.pump(self.router.clock())
            if delay is not None:
                self._pumping = asyncio.get_running_loop().call_later(delay, self._pump_again)

    def _pump_again(self) -> None:
        self._pumping = None
        self.pump()

    def _pass_on(self, frames: Sequence[Frame]) -> None:
        signing = self.router.signing
        for frame in frames:
            if signing is not None and signing.check(frame) is not SigningVerdict.ACCEPTED:
                continue
            if frame.known:
                self.transport.confirm(self._peer)
                self._last_frame = self._fed
                if not self._there:
                    self._heard(True, "flight controller heard")
            self.router.from_vehicle(frame)

    def _heard(self, there: bool, why: str) -> None:
        """The vehicle is heard, or is not any more: said when it changes."""
        if there != self._there:
            self._there = there
            self._component.link(there, why)
        if there and self._complaint:
            self._complaint = ""
            self._tell(why)

    def _complain(self, error: LinkError) -> None:
        """Why the flight controller is not there: said when it becomes known, and seldom after that."""
        now, text = self.router.clock(), f"flight controller not reached yet: {error}"
        if text != self._complaint or now - self._complained >= REMIND_S:
            self._complaint, self._complained = text, now
            self._tell(text)
