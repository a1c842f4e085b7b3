"""UDP: to one address, or listening, where who sends sound packets is a peer until it has long been silent, or both.

Bound to a port of its own it always sends to its address, and also to each peer that writes to that port, as PX4's
links do. It broadcasts only while no peer is heard.
"""

import asyncio
import socket
from collections.abc import Hashable
from contextlib import suppress
from typing import Any, cast

from twodof.link.transport.base import Packet, Transport
from twodof.link.transport.flood_filter import FloodFilter
from twodof.link.transport.stop_frames import find_stop_frames
from twodof.link.transport.url import Address

MOST_PEERS = 32
# A ground station sends a heartbeat each second; ten missed ones, and its place may go to another.
SILENT_S = 10.0
SOCKET_BUFFER = 4 << 20
# Of a socket that anybody may fill: what waits there is ahead of a kill.
LISTENING_BUFFER = 1 << 20
# What MAVLink sends fits into Ethernet's 1500; what is longer would be looked through at the cost of who flies.
LONGEST_DATAGRAM = 2048
# Datagrams are read for so long [s] before anybody else gets a turn, and no more than so many.
TURN_S, BURST = 0.0005, 256


class UdpTransport(Transport):
    """One UDP socket; the system's buffer is its queue. Made by `open_udp`."""

    whole = True

    def __init__(self, address: Address, opened: socket.socket, there: Hashable) -> None:
        super().__init__(str(address))
        self._broadcast = address.kind == "udpbcast"
        self._learns = address.listens or self._broadcast or bool(address.bind_name)
        self._loop = asyncio.get_running_loop()
        self._socket = opened
        self._heard: dict[Hashable, float] = {}  # peer -> when a sound packet of it came last
        self._server = there
        self._flood = FloodFilter(opened, self._loop, lambda: self.peers)
        self._loop.add_reader(opened.fileno(), self._readable)

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The address it was opened to, and those that sent sound packets to where it listens."""
        if self._server is None:
            return tuple(self._heard)
        if self._broadcast and self._heard:
            now = self._loop.time()
            heard = tuple(peer for peer, when in self._heard.items() if now - when < SILENT_S)
            return heard or (self._server,)
        return (self._server, *self._heard)

    @property
    def port(self) -> int:
        """The port it listens on or sends from; 0 once it is closed."""
        return 0 if self.closed else int(self._socket.getsockname()[1])

    def confirm(self, peer: Hashable) -> None:
        """Make room for `peer` if need be, by forgetting one that has been silent for SILENT_S."""
        if not self._learns or peer == self._server:
            return
        now = self._loop.time()
        if peer not in self._heard and len(self._heard) >= MOST_PEERS:
            oldest = min(self._heard, key=self._heard.__getitem__)
            if now - self._heard[oldest] < SILENT_S:
                return
            del self._heard[oldest]
        self._heard[peer] = now

    def stranger(self, peer: Hashable) -> bool:
        """Whether a peer did not get a place."""
        return self._learns and peer not in self._heard and peer != self._server

    @property
    def floods(self) -> int:
        """How often somebody filled the socket faster than it is read, and was refused for a while."""
        return self._flood.count

    def _readable(self) -> None:
        now = self._loop.time()
        end = now + TURN_S
        for number in range(BURST):
            if number % 16 == 15 and self._loop.time() > end:
                return
            try:
                data, peer = self._socket.recvfrom(LONGEST_DATAGRAM + 1)
            except (BlockingIOError, InterruptedError):
                self._flood.emptied()
                return
            except OSError:  # the other side's port is closed (yet): counted, no reason to end
                self.counts.errors += 1
                continue
            refused = self._learns and not self._flood.came(peer, data)
            if refused or len(data) > LONGEST_DATAGRAM:
                self.counts.dropped_in += 1
                continue
            peer = peer if self._learns else self._server
            for raw in find_stop_frames(data) if self._inbox.stops_first else ():
                self._inbox.put_ahead(raw, peer)
            self._inbox.put(Packet(data, peer))
            if self.closed:
                return

    def _send(self, data: bytes, peer: Hashable) -> bool:
        try:
            if self._learns:
                self._socket.sendto(data, cast(tuple[Any, ...], peer))
            else:
                self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self.counts.errors += 1
            return False
        return True

    def _release(self) -> None:
        self._flood.close()
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()


async def open_udp(address: Address) -> UdpTransport:
    """A UDP socket that listens at or sends to `address`, or does both. Raises OSError where the system refuses."""
    loop = asyncio.get_running_loop()
    places = await loop.getaddrinfo(address.name, address.port, type=socket.SOCK_DGRAM)
    family, kind, protocol, _, place = places[0]
    opened = socket.socket(family, kind, protocol)
    try:
        opened.setblocking(False)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, int(address.kind == "udpbcast"))
        if address.listens:
            opened.bind(place)
        elif address.bind_name:
            own = await loop.getaddrinfo(address.bind_name, address.bind_port, family=family, type=kind)
            opened.bind(own[0][4])
        elif address.kind == "udp":
            opened.connect(place)
    except OSError:
        opened.close()
        raise
    anybody = address.listens or address.bind_name
    for option, size in (
        (socket.SO_RCVBUF, LISTENING_BUFFER if anybody else SOCKET_BUFFER),
        (socket.SO_SNDBUF, SOCKET_BUFFER),
    ):
        with suppress(OSError):  # the system's own bound stays
            opened.setsockopt(socket.SOL_SOCKET, option, size)
    return UdpTransport(address, opened, None if address.listens else place)
