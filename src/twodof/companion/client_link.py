"""A link that clients come to: who is there, who has come and gone, and what they send."""

from collections.abc import Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from twodof.companion.client import SILENT_S, CompanionClient
from twodof.companion.companion_link import CompanionLink
from twodof.companion.component import CompanionComponent
from twodof.companion.streams.rate_profiles import profile
from twodof.companion.vehicle_link import VehicleLink
from twodof.errors import LinkError
from twodof.link.connection import BROKEN_OFF_S, TELL_S
from twodof.link.mavlink.framing import Frame, Parser
from twodof.link.signing import SigningVerdict
from twodof.link.transport import ports
from twodof.link.transport.base import Packet
from twodof.link.transport.tcp import TcpTransport
from twodof.link.transport.udp import UdpTransport
from twodof.link.transport.url import parse

# Of one link, so that strangers on one leave room on the others. A newcomer takes the place of one that is silent.
MOST_CLIENTS = 32
GIVES_PLACE_S = 10.0


@dataclass(frozen=True)
class Serve:
    """Where clients come to, and the rates (`rates.PROFILES`) that they get unasked.

    `on_board`: only the drone's own programs come there, which may speak as its own system; nobody else may.
    """

    url: str
    rates: str = "onboard"
    on_board: bool = False


def px4_links(index: int = 0, open_to_all: bool = False) -> tuple[Serve, ...]:
    """Where PX4 in simulation serves its clients, for drone `index`: UDP onboard and ground, and a TCP server.

    On this machine only, unless `open_to_all`.
    """
    host = "0.0.0.0" if open_to_all else "127.0.0.1"
    return (
        Serve(f"udp://127.0.0.1:{ports.ONBOARD + index}?bind={host}:{ports.COMPANION_ONBOARD + index}", "onboard"),
        Serve(f"udp://127.0.0.1:{ports.GROUND_STATION}?bind={host}:{ports.COMPANION_GROUND + index}", "ground"),
        Serve(f"tcpin://{host}:{ports.COMPANION_TCP + index}", "onboard"),
    )


class ClientLink(CompanionLink):
    """One link that clients come to; what they send goes on to `vehicle`."""

    def __init__(self, serve: Serve, vehicle: VehicleLink, component: CompanionComponent) -> None:
        super().__init__(serve.url, vehicle.router)
        self.clients: dict[Hashable, CompanionClient] = {}
        self._serve, self._vehicle, self._component = serve, vehicle, component
        self._rates = profile(serve.rates)
        self._parsers: dict[Hashable, tuple[Parser, float]] = {}  # and when they were fed last
        self._told = -TELL_S
        self._lasting: Hashable = None
        self._datagrams = parse(serve.url).kind in ("udp", "udpin", "udpbcast")  # nobody says when a peer has gone

    @property
    def address(self) -> tuple[str, str]:
        """Its URL, with the port that it listens on, and its rates."""
        address, transport = parse(self.url), self.transport
        if isinstance(transport, UdpTransport | TcpTransport):
            if address.bind_name:
                address = replace(address, bind_port=transport.port)
            elif address.listens:
                address = replace(address, port=transport.port)
            return str(address), self._serve.rates
        return self.url, self._serve.rates

    async def open(self) -> None:
        """Open it. Raises LinkError."""
        await super().open()
        self.transport.keeps = self._keeps
        if self._datagrams and not parse(self.url).listens:
            self._lasting = self.transport.peers[0]
        self.look(self.router.clock())

    async def keep(self) -> None:
        """Read it, and open it again where it is one that breaks."""
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
        """A packet of a client."""
        with self.router.line.together():
            key: Hashable = None if self.transport.whole else packet.peer
            parser = self._parsers[key][0] if key in self._parsers else self.new_parser()
            self._parsers[key] = (parser, self.router.clock())
            self._pass_on(parser.feed(packet.data, self.transport.whole), packet.peer)
        self._vehicle.pump()

    def look(self, now: float) -> None:
        """By the clock: see who has come and gone without a word, and what broke off."""
        there = self.transport.peers
        for peer in (self._lasting,) if self._datagrams else there:
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
            if not self._lets_in(frame, peer):
                continue
            client = self.clients.get(peer)
            if client is None:
                if not frame.known:  # its checksum cannot be known, and a stranger is not believed
                    continue
                client = self._welcome(peer)
                if client is None:
                    self.router.from_stranger(frame)
                    continue
            if frame.known:
                self.transport.confirm(peer)
            self.router.from_client(client, frame)

    def _lets_in(self, frame: Frame, peer: Hashable) -> bool:
        """Whether a frame is signed as it must be; who signs rightly with an old stamp is told the time."""
        signing = self.router.signing
        verdict = SigningVerdict.ACCEPTED if signing is None else signing.check(frame)
        if verdict in (SigningVerdict.REPEATED, SigningVerdict.STALE):
            now = self.router.clock()
            if now - self._told >= TELL_S:
                self._told = now
                with suppress(LinkError):  # it is gone, or we have no stamps left
                    self.transport.send(self._component.time(), peer)
        return verdict is SigningVerdict.ACCEPTED

    def _keeps(self, peer: Hashable) -> bool:
        """Whether the pilot is behind a client, whose place goes to nobody else then."""
        client = self.clients.get(peer)
        return client is not None and self.router.pilot in client.identities

    def _welcome(self, peer: Hashable, stays: bool = False) -> CompanionClient | None:
        """A new client; None where there are too many, and none of them is silent."""
        now = self.router.clock()
        if len(self.clients) >= MOST_CLIENTS:
            leaving = [one for one in self.clients.values() if not one.stays and now - one.heard >= GIVES_PLACE_S]
            if not leaving:
                return None
            self._dismiss(min(leaving, key=lambda one: one.heard))
        name = f"{self.transport.url} {peer}"
        client = CompanionClient(name, self.transport, peer, self._rates, now, stays, now, self._serve.on_board)
        self.clients[peer] = client
        self.router.add(client)
        return client

    def _dismiss(self, client: CompanionClient) -> None:
        del self.clients[client.peer]
        self._parsers.pop(client.peer, None)
        self.router.remove(client)
