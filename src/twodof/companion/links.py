"""The links of the companion: to the flight controller, and to the clients that come and go."""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from twodof.companion.client import SILENT_S, CompanionClient, profile
from twodof.companion.component import CompanionComponent
from twodof.companion.router import Router
from twodof.errors import LinkError, LinkLost
from twodof.link.connection import BROKEN_OFF_S
from twodof.link.mavlink.framing import Frame, Parser
from twodof.link.signing import Admission
from twodof.link.transport import open_transport
from twodof.link.transport.base import Packet, Transport
from twodof.link.transport.url import Ports, parse

OPEN_S, WAIT_S = 2.0, 60.0
FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.1, 2.0
VEHICLE_SILENT_S = 3.0
"""Without a frame for so long the flight controller counts as lost; its heartbeat comes each second."""
REMIND_S = 60.0
"""Interval of the reminders that the flight controller is not there."""
MOST_CLIENTS = 32
"""Clients of one link, so that strangers on one link leave room on the others."""
GIVES_PLACE_S = 10.0
"""A client that is silent for so long gives its place to a newcomer."""


@dataclass(frozen=True)
class Serve:
    """A URL at which clients are served, and the name of the message rates that they get unasked.

    `on_board`: only programs of the drone connect there. They may use the drone's own system id; other clients may not.
    """

    url: str
    rates: str = "onboard"
    on_board: bool = False


def px4_links(index: int = 0, open_to_all: bool = False) -> tuple[Serve, ...]:
    """Return the links of PX4 in simulation for drone `index`: UDP onboard and ground, and a TCP server.

    They listen on this machine only, unless `open_to_all`.
    """
    host = "0.0.0.0" if open_to_all else "127.0.0.1"
    return (
        Serve(f"udp://127.0.0.1:{Ports.ONBOARD + index}?bind={host}:{Ports.COMPANION_ONBOARD + index}", "onboard"),
        Serve(f"udp://127.0.0.1:{Ports.GROUND_STATION}?bind={host}:{Ports.COMPANION_GROUND + index}", "ground"),
        Serve(f"tcpin://{host}:{Ports.COMPANION_TCP + index}", "onboard"),
    )


class CompanionLink(ABC):
    """A link at `url` that is read until it breaks, and opened again after growing pauses."""

    transport: Transport

    def __init__(self, url: str, router: Router, component: CompanionComponent) -> None:
        self.url = url
        self.router = router
        self._component = component
        self._pause = FIRST_BACK_OFF_S
        self._admission = Admission(router.signing)

    @abstractmethod
    def take(self, packet: Packet) -> None:
        """Handle an incoming packet."""

    @abstractmethod
    async def keep(self) -> None:
        """Read the link, and open it again whenever it breaks, until cancelled."""

    async def open(self) -> None:
        """Open the link. Raises LinkError."""
        self.transport = await open_transport(self.url, OPEN_S)

    async def read(self) -> LinkLost:
        """Hand packets to `take` until the link is lost; return the reason."""
        try:
            while True:
                packet = await self.transport.receive(WAIT_S)
                while packet is not None:
                    self.take(packet)
                    packet = self.transport.receive_now()
        except LinkLost as reason:
            return reason

    async def back_off(self, stood: bool) -> None:
        """Wait before the link is opened again; each wait is longer, until the link was open for a while (`stood`)."""
        if stood:
            self._pause = FIRST_BACK_OFF_S
        await asyncio.sleep(self._pause)
        self._pause = min(2.0 * self._pause, LONGEST_BACK_OFF_S)

    def new_parser(self) -> Parser:
        """Make the parser of a new stream or peer."""
        return Parser(mavlink1=self.router.signing is None)

    def accepts(self, frame: Frame, peer: Hashable) -> bool:
        """Return whether a frame has the signature that the link demands; send a peer with an old clock our time."""
        return self._admission.admits(
            frame, self.router.clock(), lambda: self.transport.send(self._component.time(), peer)
        )


class VehicleLink(CompanionLink):
    """The link to the flight controller. `tell` gets lines for people while it is not reached."""

    def __init__(
        self, url: str, router: Router, component: CompanionComponent, tell: Callable[[str], None] | None
    ) -> None:
        super().__init__(url, router, component)
        self.bytes_in = 0
        self._tell = tell or (lambda text: None)
        self._parser = self.new_parser()
        self._peer: Hashable = None
        self._opened = self._fed = self._last_frame = 0.0
        self._there = False
        self._complaint, self._complained = "", 0.0
        self._pumping: asyncio.TimerHandle | None = None

    async def keep(self) -> None:
        told = False
        while True:
            try:
                await self.open()
            except LinkError as error:
                if not told:
                    self._component.link(False, f"flight controller not reached: {error.what}")
                    told = True
                self._complain(error)
                await self.back_off(stood=False)
                continue
            self._parser = self.new_parser()
            self.router.line.connect(self.transport)
            self._opened = self.router.clock()
            reason = await self.read()
            self.router.line.cut()
            self._set_there(False, f"flight controller lost: {reason.what}")
            await self.back_off(stood=self.router.clock() - self._opened > LONGEST_BACK_OFF_S)

    async def close(self) -> None:
        """Close the link if it is open."""
        if self._pumping is not None:
            self._pumping.cancel()
        if self.router.line.transport is not None:
            await self.router.line.transport.close()

    def take(self, packet: Packet) -> None:
        self._fed, self._peer = self.router.clock(), packet.peer
        self.bytes_in += len(packet.data)
        self._pass_on(self._parser.feed(packet.data, self.transport.whole))
        self.pump()

    def look(self, now: float) -> None:
        """Act on the clock: give up a frame that broke off, and notice a silent flight controller."""
        if self.router.line.transport is not None:  # a frame that broke off with the link is no sign of life
            if now - self._fed > BROKEN_OFF_S and self._parser.waiting:
                self._pass_on(self._parser.feed(b"", whole=True))
            if self._there and now - self._last_frame > VEHICLE_SILENT_S:
                self._set_there(False, f"flight controller silent for {VEHICLE_SILENT_S:g} s")
            if not self._there and now - max(self._opened, self._last_frame) > VEHICLE_SILENT_S:
                what, remedy = "the link stands, and no heartbeat comes", "see that it runs, and at this baud rate"
                if self.router.signing is not None and self.router.signing.refused:
                    remedy += ", and with this key"
                self._complain(LinkError(what, self.url, f"{remedy} or address"))
        self.pump()

    def pump(self) -> None:
        """Send waiting frames as soon as the line has room."""
        if self._pumping is None and self.router.line.waiting:
            delay = self.router.line.pump(self.router.clock())
            if delay is not None:
                self._pumping = asyncio.get_running_loop().call_later(delay, self._pump_again)

    def _pump_again(self) -> None:
        self._pumping = None
        self.pump()

    def _pass_on(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            if not self.accepts(frame, self._peer):
                continue
            if frame.known:
                self.transport.confirm(self._peer)
                self._last_frame = self._fed
                if not self._there:
                    self._set_there(True, "flight controller heard")
            self.router.from_vehicle(frame)

    def _set_there(self, there: bool, why: str) -> None:
        """Tell clients and people when the flight controller is heard, or is not any more."""
        if there != self._there:
            self._there = there
            self._component.link(there, why)
            if there:
                self.router.started()  # it may have been restarted
        if there and self._complaint:
            self._complaint = ""
            self._tell(why)

    def _complain(self, error: LinkError) -> None:
        """Tell people why the flight controller is not there: at once, and then seldom."""
        now, text = self.router.clock(), f"flight controller not reached yet: {error}"
        if text != self._complaint or now - self._complained >= REMIND_S:
            self._complaint, self._complained = text, now
            self._tell(text)


class ClientLink(CompanionLink):
    """A link that clients come to; their frames go on to `vehicle`."""

    def __init__(self, serve: Serve, vehicle: VehicleLink, component: CompanionComponent) -> None:
        super().__init__(serve.url, vehicle.router, component)
        self.clients: dict[Hashable, CompanionClient] = {}
        self.serve, self._vehicle = serve, vehicle
        self._rates = profile(serve.rates)
        self._parsers: dict[Hashable, tuple[Parser, float]] = {}  # with the time when each was fed last
        self._default: Hashable = None
        self._datagrams = parse(serve.url).kind in ("udp", "udpin", "udpbcast")  # these peers leave without a word

    async def open(self) -> None:
        await super().open()
        self.transport.keeps = self._is_pilot
        if self._datagrams and not parse(self.url).listens:
            self._default = self.transport.peers[0]
        self.look(self.router.clock())

    async def keep(self) -> None:
        stood = False
        while True:
            await self.read()
            self.look(self.router.clock())
            await self.back_off(stood)
            stood = False
            with suppress(LinkError):
                await self.open()
                stood = True

    def take(self, packet: Packet) -> None:
        key: Hashable = None if self.transport.whole else packet.peer
        parser = self._parsers[key][0] if key in self._parsers else self.new_parser()
        self._parsers[key] = (parser, self.router.clock())
        self._pass_on(parser.feed(packet.data, self.transport.whole), packet.peer)
        self._vehicle.pump()

    def look(self, now: float) -> None:
        """Act on the clock: notice clients that came or went without a word, and give up frames that broke off."""
        there = self.transport.peers
        for peer in (self._default,) if self._datagrams else there:
            if peer in there and peer not in self.clients:
                self._welcome(peer, stays=self._datagrams)
        for client in [*self.clients.values()]:
            silent = now - client.heard > SILENT_S
            if client.stays and client.peer in there:
                if silent and client.identities:
                    self.router.forget(client)
            elif client.stays or (silent if self._datagrams else client.peer not in there):
                self._dismiss(client)
        for peer, (parser, fed) in [*self._parsers.items()]:
            if parser.waiting and now - fed > BROKEN_OFF_S and peer in self.clients:
                self._pass_on(parser.feed(b"", whole=True), peer)
            if peer is not None and peer not in self.clients:
                del self._parsers[peer]

    def _pass_on(self, frames: Sequence[Frame], peer: Hashable) -> None:
        for frame in frames:
            if not self.accepts(frame, peer):
                continue
            client = self.clients.get(peer)
            if client is None:
                if not frame.known:  # its checksum cannot be verified, so it makes no client
                    continue
                client = self._welcome(peer)
                if client is None:
                    self.router.from_unplaced(frame)
                    continue
            if frame.known:
                self.transport.confirm(peer)
            self.router.from_client(client, frame)

    def _is_pilot(self, peer: Hashable) -> bool:
        """Return whether the pilot is at a peer, so that its place goes to no newcomer."""
        client = self.clients.get(peer)
        return client is not None and self.router.pilot in client.identities

    def _welcome(self, peer: Hashable, stays: bool = False) -> CompanionClient | None:
        """Add a client; return None if there are too many and none of them is silent."""
        now = self.router.clock()
        if len(self.clients) >= MOST_CLIENTS:
            leaving = [one for one in self.clients.values() if not one.stays and now - one.heard >= GIVES_PLACE_S]
            if not leaving:
                return None
            self._dismiss(min(leaving, key=lambda one: one.heard))
        client = CompanionClient(self.transport, peer, self._rates, now, stays, self.serve.on_board)
        self.clients[peer] = client
        self.router.add(client)
        return client

    def _dismiss(self, client: CompanionClient) -> None:
        del self.clients[client.peer]
        self._parsers.pop(client.peer, None)
        self.router.remove(client)
