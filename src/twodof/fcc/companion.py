"""The companion: opens the links, keeps the one to the flight controller up, and lets the router pass the frames."""

import asyncio
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

from twodof.errors import LinkError, LinkLost
from twodof.fcc.client import SILENT_S, CompanionClient, Identity
from twodof.fcc.component import CompanionComponent
from twodof.fcc.computer import ComputerStatus, Traffic
from twodof.fcc.rate_profiles import profile
from twodof.fcc.router import Router
from twodof.fcc.uplink_queue import BITS_A_BYTE, NETWORK_FRAME, NETWORK_RATE, UplinkQueue
from twodof.link.connection import BROKEN_OFF_S, TELL_S
from twodof.link.mavlink.framing import Frame, Parser
from twodof.link.signing.frame_signing import Signing, SigningVerdict
from twodof.link.transport import ports
from twodof.link.transport.base import Packet, Transport
from twodof.link.transport.open_transport import open_transport
from twodof.link.transport.tcp import TcpTransport
from twodof.link.transport.udp import UdpTransport
from twodof.link.transport.url import parse

# Of one link, so that strangers on one leave room on the others.
MOST_CLIENTS = 32
SWEEP_S = 0.1
BEAT_S = 1.0
# Its heartbeat comes each second.
VEHICLE_SILENT_S = 3.0
OPEN_S = 2.0
# How often it is repeated that the flight controller is not there.
REMIND_S = 60.0
FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.1, 2.0


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


class _Port:
    """One link that clients come to, and who is there."""

    def __init__(self, transport: Transport, serve: Serve, mavlink1: bool) -> None:
        self.transport = transport
        self.mavlink1 = mavlink1
        self.url = serve.url
        self.rates = profile(serve.rates)
        self.on_board = serve.on_board
        self.clients: dict[Hashable, CompanionClient] = {}
        self.parsers: dict[Hashable, tuple[Parser, float]] = {}
        kind = parse(serve.url).kind
        self.datagrams = kind in ("udp", "udpin", "udpbcast")  # nobody says when a peer has gone
        self.lasting: Hashable = transport.peers[0] if kind in ("udp", "udpbcast") else None

    @property
    def open_url(self) -> str:
        """Its URL, with the port that it listens on."""
        address, transport = parse(self.url), self.transport
        if not isinstance(transport, UdpTransport | TcpTransport):
            return self.url
        if address.bind_name:
            return str(replace(address, bind_port=transport.port))
        return str(replace(address, port=transport.port)) if address.listens else str(address)

    def keep(self, pilot: Callable[[], Identity | None]) -> None:
        """The place of a client behind which the pilot is goes to nobody else."""

        def keeps(peer: Hashable) -> bool:
            client = self.clients.get(peer)
            return client is not None and pilot() in client.identities

        self.transport.keeps = keeps

    def frames(self, packet: Packet, now: float) -> list[Frame]:
        """The frames that end in a packet."""
        key: Hashable = None if self.transport.whole else packet.peer
        known = self.parsers.get(key)
        parser = known[0] if known is not None else Parser(self.mavlink1)
        self.parsers[key] = (parser, now)
        return parser.feed(packet.data, self.transport.whole)


class Companion:
    """Routes between the flight controller at `vehicle` (a URL) and clients at `serve`; a context manager.

    `system` is the vehicle's system id (1 to 255). With `signing` its own messages are signed, and only frames that are
    signed with that key pass or have any effect. Without it signed frames pass untouched. `line_rate` [byte/s] bounds
    what is sent to the flight controller. Its default is what a serial line's baud rate carries, and 1 Mbyte/s over a
    network; in memory nothing is bounded. `tell` is called with a line for people while the flight controller is not
    reached, each minute, and when it is heard then.
    Raises LinkError where a client's link cannot be opened; the flight controller may come later.
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
        self.lost = 0
        self._signing = signing
        self._system = system
        self._ports: list[_Port] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._parser = self._new_parser()
        self._told = -TELL_S
        self._fed = self._last_frame = 0.0
        self._there = False
        self._tell = tell
        self._opened = 0.0
        self._complaint, self._complained = "", 0.0
        self._pumping: asyncio.TimerHandle | None = None
        self._bytes = [0, 0]

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self.router = Router(self._system, self.line, self._loop.time, self._signing)
        self.component = CompanionComponent(
            self.router, self._loop.time, ComputerStatus(self._traffic, self._loop.time)
        )
        try:
            for one in self.serve:
                self._ports.append(_Port(await open_transport(one.url), one, self._signing is None))
        except LinkError:
            await self.close()
            raise
        for port in self._ports:
            port.keep(lambda: self.router.pilot)
            self._sweep_port(port, self._loop.time())
        self._fault = self._loop.create_future()
        works = [self._keep_line(), self._sweep(), self._beat(), *(self._serve(port) for port in self._ports)]
        self._tasks = [self._loop.create_task(work) for work in works]
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close all links."""
        for task in self._tasks:
            task.cancel()
        ended = await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._tasks and self._fault.done() and not self._fault.cancelled():
            ended.append(self._fault.exception())
        self._tasks = []
        if self._pumping is not None:
            self._pumping.cancel()
        for port in self._ports:
            await port.transport.close()
        if self.line.transport is not None:
            await self.line.transport.close()
        if self._signing is not None:
            self._signing.close()
        for end in ended:
            if isinstance(end, Exception):
                raise end

    async def run(self) -> None:
        """Until a part of it fails, which it raises, or it is cancelled."""
        await asyncio.gather(self._fault, *self._tasks)

    @property
    def urls(self) -> list[tuple[str, str]]:
        """Of each link that clients come to its URL, with the port that the system chose for port 0, and its rates."""
        return [(port.open_url, one.rates) for port, one in zip(self._ports, self.serve, strict=True)]

    @property
    def clients(self) -> list[CompanionClient]:
        """Who is there."""
        return [*self.router.clients]

    @property
    def killed(self) -> bool:
        """Whether the drone has said that it was killed, and not yet that it was released."""
        return self.router.killed

    def _new_parser(self) -> Parser:
        return Parser(mavlink1=self._signing is None)

    def _let_in(self, frame: Frame, peer: Hashable = None, port: _Port | None = None) -> bool:
        """Whether a frame is signed as it must be; who signs rightly with an old stamp, at a port, is told the time."""
        if self._signing is None:
            return True
        verdict = self._signing.check(frame)
        now = self._loop.time()
        if (
            port is not None
            and verdict in (SigningVerdict.REPEATED, SigningVerdict.STALE)
            and now - self._told >= TELL_S
        ):
            self._told = now
            with suppress(LinkError):  # it is gone, or we have no stamps left
                port.transport.send(self.component.time(), peer)
        return verdict is SigningVerdict.ACCEPTED

    # The line to the flight controller.

    async def _keep_line(self) -> None:
        """Open it, read it until it breaks, and so on for ever, at growing intervals while it does not come back."""
        wait, said = FIRST_BACK_OFF_S, False
        while True:
            try:
                transport = await open_transport(self.vehicle, OPEN_S)
            except LinkError as error:
                if not said:
                    self.component.link(False, f"flight controller not reached: {error.what}")
                    said = True
                self._complain(error)
                await asyncio.sleep(wait)
                wait = min(2.0 * wait, LONGEST_BACK_OFF_S)
                continue
            self._parser = self._new_parser()
            self.line.connect(transport)
            self.router.started()
            opened = self._opened = self._loop.time()
            reason = await self._until_lost(transport, self._from_vehicle)
            self.line.cut()
            self.lost += 1
            self._heard(False, f"flight controller lost: {reason.what}")
            if self._loop.time() - opened > LONGEST_BACK_OFF_S:  # it stood for a while
                wait = FIRST_BACK_OFF_S
            await asyncio.sleep(wait)
            wait = min(2.0 * wait, LONGEST_BACK_OFF_S)

    def _heard(self, there: bool, why: str) -> None:
        """The vehicle is heard, or is not any more: said when it changes."""
        if there != self._there:
            self._there = there
            self.component.link(there, why)
        if there and self._complaint:
            self._complaint = ""
            self._say(why)

    def _complain(self, error: LinkError) -> None:
        """Why the flight controller is not there: said when it becomes known, and seldom after that."""
        now, text = self._loop.time(), f"flight controller not reached yet: {error}"
        if text != self._complaint or now - self._complained >= REMIND_S:
            self._complaint, self._complained = text, now
            self._say(text)

    def _say(self, text: str) -> None:
        if self._tell is not None:
            self._tell(text)

    def _from_vehicle(self, packet: Packet) -> None:
        self._fed = self._loop.time()
        self._bytes[1] += len(packet.data)
        transport = self.line.transport
        whole = transport is not None and transport.whole
        for frame in self._parser.feed(packet.data, whole):
            if not self._let_in(frame):
                continue
            if frame.known:
                if transport is not None:
                    transport.confirm(packet.peer)
                self._last_frame = self._fed
                if not self._there:
                    self._heard(True, "flight controller heard")
            self.router.from_vehicle(frame)
        self._pump()

    def _pump(self) -> None:
        """Send what waits as soon as the line has room."""
        if self._pumping is None and self.line.waiting:
            delay = self.line.pump(self._loop.time())
            if delay is not None:
                self._pumping = self._loop.call_later(delay, self._pump_again)

    def _pump_again(self) -> None:
        self._pumping = None
        self._pump()

    # Clients.

    async def _serve(self, port: _Port) -> None:
        """Read a clients' link, opening it again where it was one that breaks."""

        def take(packet: Packet) -> None:
            self._from_client(port, packet)

        wait = FIRST_BACK_OFF_S
        while True:
            await self._until_lost(port.transport, take)
            self._sweep_port(port, self._loop.time())
            await asyncio.sleep(wait)
            wait = min(2.0 * wait, LONGEST_BACK_OFF_S)
            with suppress(LinkError):
                port.transport = await open_transport(port.url, OPEN_S)
                port.keep(lambda: self.router.pilot)
                wait = FIRST_BACK_OFF_S

    def _from_client(self, port: _Port, packet: Packet) -> None:
        with self.line.together():
            self._take(port, packet)
        self._pump()

    def _take(self, port: _Port, packet: Packet) -> None:
        for frame in port.frames(packet, self._loop.time()):
            if not self._let_in(frame, packet.peer, port):
                continue
            client = port.clients.get(packet.peer)
            if client is None:
                if not frame.known:  # its checksum cannot be known, and a stranger is not believed
                    continue
                client = self._welcome(port, packet.peer)
                if client is None:
                    self.router.from_stranger(frame)
                    continue
            if frame.known:
                port.transport.confirm(packet.peer)
            self.router.from_client(client, frame)

    def _welcome(self, port: _Port, peer: Hashable, stays: bool = False) -> CompanionClient | None:
        """A new client; None where there are too many, and none of them is silent."""
        now = self._loop.time()
        if len(port.clients) >= MOST_CLIENTS:
            silent = min(
                (one for one in port.clients.values() if not one.stays), key=lambda one: one.heard, default=None
            )
            if silent is None or now - silent.heard < SWEEP_S * 100:
                return None
            self._dismiss(silent)
        client = CompanionClient(
            f"{port.transport.url} {peer}", port.transport, peer, port.rates, now, stays, now, port.on_board
        )
        port.clients[peer] = client
        self.router.add(client)
        return client

    def _dismiss(self, client: CompanionClient) -> None:
        for port in self._ports:
            if port.clients.get(client.peer) is client:
                del port.clients[client.peer]
                port.parsers.pop(client.peer, None)
        self.router.remove(client)

    async def _until_lost(self, transport: Transport, take: Callable[[Packet], None]) -> LinkLost:
        """Hand on what comes until the link is lost; why it was."""
        lost: asyncio.Future[LinkLost] = self._loop.create_future()

        def taken(packet: Packet) -> None:
            fine = False
            try:
                take(packet)
                fine = True
            finally:  # a fault of ours goes to the loop, which shows it; `run` must end too
                if not fine and not self._fault.done():
                    self._fault.set_exception(LinkError("a frame was not passed on", transport.url, "report the fault"))

        def ended(reason: LinkLost) -> None:
            if not lost.done():
                lost.set_result(reason)

        transport.hand_to(taken, ended)
        return await lost

    # What is done by the clock.

    async def _sweep(self) -> None:
        """Find who has come and gone without a word, what broke off, and what was not answered."""
        while True:
            await asyncio.sleep(SWEEP_S)
            now = self._loop.time()
            for port in self._ports:
                self._sweep_port(port, now)
            self.router.follow(now)
            if now - self._fed > BROKEN_OFF_S and self._parser.waiting:
                for frame in self._parser.feed(b"", whole=True):
                    if self._let_in(frame):
                        self.router.from_vehicle(frame)
            if self.line.transport is not None:
                if self._there and now - self._last_frame > VEHICLE_SILENT_S:
                    self._heard(False, f"flight controller silent for {VEHICLE_SILENT_S:g} s")
                    self.router.started()  # it may come back as one that was started anew
                if not self._there and now - max(self._opened, self._last_frame) > VEHICLE_SILENT_S:
                    what, remedy = "the link stands, and no heartbeat comes", "see that it runs, and at this baud rate"
                    if self._signing is not None and self._signing.counts.refused:
                        remedy += ", and with this key"
                    self._complain(LinkError(what, self.vehicle, f"{remedy} or address"))
                self.router.subscriptions.asking.poll(now)
            self._pump()

    def _sweep_port(self, port: _Port, now: float) -> None:
        there = port.transport.peers
        for peer in (port.lasting,) if port.datagrams else there:
            if peer in there and peer not in port.clients:
                self._welcome(port, peer, stays=port.datagrams)
        for client in [*port.clients.values()]:
            silent = now - client.heard > SILENT_S
            if client.stays and client.peer in there:
                if silent and client.identities:
                    self.router.forget(client)
            elif client.stays or (silent if port.datagrams else client.peer not in there):
                self._dismiss(client)
        for peer, (parser, fed) in [*port.parsers.items()]:
            if parser.waiting and now - fed > BROKEN_OFF_S and peer in port.clients:
                for frame in parser.feed(b"", whole=True):
                    if self._let_in(frame, peer, port):
                        self.router.from_client(port.clients[peer], frame)
            if peer is not None and peer not in port.clients:
                del port.parsers[peer]

    async def _beat(self) -> None:
        while True:
            self.component.beat()
            await asyncio.sleep(BEAT_S)

    def _traffic(self) -> list[Traffic]:
        """The line first, then the clients' links."""
        rows = [Traffic(self.line.counts.bytes, self._bytes[1], self.line.rate or 0.0)]
        return rows + [Traffic(port.transport.counts.bytes_out, port.transport.counts.bytes_in) for port in self._ports]
