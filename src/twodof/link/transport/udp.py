"""UDP: a socket with one address, a listening socket with the peers that were heard, or both.

A socket that is bound to a port of its own sends to its address. It also sends to each peer that writes to that port,
as the links of PX4 do. It broadcasts only while no peer is heard.
"""

import asyncio
import random
import socket
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from typing import Any, cast

from twodof.link.mavlink.framing import find_stop_frames, looks_like_a_stop
from twodof.link.transport.base import Packet, Transport
from twodof.link.transport.url import Address

MOST_PEERS = 32
# A ground station sends a heartbeat each second; after ten missed ones its place may go to another peer.
SILENT_S = 10.0
SOCKET_BUFFER = 4 << 20
# The buffer of a listening socket is smaller: a kill waits behind everything in it.
LISTENING_BUFFER = 1 << 20
# MAVLink fits into Ethernet's 1500 bytes; to parse longer datagrams would only cost time.
LONGEST_DATAGRAM = 2048
# The longest time [s] and the most datagrams that are read before other tasks get a turn.
TURN_S, BURST = 0.0005, 256

REFUSED_S = 2.0
# Linux charges a socket's buffer at least 768 bytes for a packet, even for one of a few bytes.
PACKET_BYTES = 700
# A peer with less than a quarter of its share of a flood, or with so few packets, is not part of it.
SHARE, FEW = 4, 8
MOST_REFUSED = 32
# If the flooding peers are too many to list, unknown peers keep one packet in so many.
ONE_IN = 256


class FloodGuard:
    """Guard that refuses peers that fill a socket faster than it is read; packets like a kill or disarm always pass.

    A flood is noticed when more than twice the content of the socket's buffer was read without finding it empty.
    `known` returns the peers that sent valid frames before.
    """

    def __init__(
        self, buffer_bytes: int, loop: asyncio.AbstractEventLoop, known: Callable[[], Iterable[Hashable]]
    ) -> None:
        self.count = 0
        """Floods noticed so far."""
        self._loop = loop
        self._known = known
        self._most = max(2 * buffer_bytes // PACKET_BYTES, 64)
        self._packets: Counter[Hashable] = Counter()  # by peer, since the socket was last empty
        self._left = self._most
        self._refuses: Callable[[Hashable], bool] | None = None
        self._until = 0.0

    def emptied(self) -> None:
        """Start a new count after the socket was read empty."""
        if self._left != self._most:
            self._packets.clear()
            self._left = self._most

    def passes(self, peer: Hashable, data: bytes) -> bool:
        """Return whether to accept a packet of `peer`, and count it if so."""
        if self._refuses is not None:
            if self._loop.time() > self._until:
                self._refuses = None
            elif self._refuses(peer):
                return looks_like_a_stop(data)
        self._packets[peer] += 1
        self._left -= 1
        if not self._left:
            self._refuse()
        return True

    def _refuse(self) -> None:
        """Refuse flooding peers; if there are too many, refuse every unknown peer."""
        limit = max(FEW, self._most // (SHARE * len(self._packets)))
        flooding = {peer for peer, count in self._packets.items() if count > limit}
        if self._refuses is not None or len(flooding) > MOST_REFUSED:
            trusted = {peer for peer in self._known() if peer not in flooding}
            self._refuses = lambda peer: peer not in trusted and bool(random.randrange(ONE_IN))
        else:
            self._refuses = flooding.__contains__
        self._until = self._loop.time() + REFUSED_S
        self.count += 1
        self.emptied()


class UdpTransport(Transport):
    """One UDP socket; the system's buffer is its queue. `open_udp` makes it."""

    whole = True

    def __init__(self, address: Address, opened: socket.socket, there: Hashable) -> None:
        super().__init__(str(address))
        self._broadcast = address.kind == "udpbcast"
        self._learns = address.listens or self._broadcast or bool(address.bind_name)
        self._loop = asyncio.get_running_loop()
        self._socket = opened
        self._heard: dict[Hashable, float] = {}  # peer -> time of its last valid frame
        self._server = there
        self._flood = FloodGuard(opened.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF), self._loop, lambda: self.peers)
        self._loop.add_reader(opened.fileno(), self._readable)
        self.url = str(address.at(opened.getsockname()[1]))

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The address that was opened, and the peers that sent valid frames to a listening socket."""
        if self._server is None:
            return tuple(self._heard)
        if self._broadcast and self._heard:
            now = self._loop.time()
            heard = tuple(peer for peer, when in self._heard.items() if now - when < SILENT_S)
            return heard or (self._server,)
        return (self._server, *self._heard)

    def confirm(self, peer: Hashable) -> None:
        """Add `peer`; if all places are taken, forget a peer that has been silent for SILENT_S."""
        if not self._learns or peer == self._server:
            return
        now = self._loop.time()
        if peer not in self._heard and len(self._heard) >= MOST_PEERS:
            oldest = min(self._heard, key=self._heard.__getitem__)
            if now - self._heard[oldest] < SILENT_S:
                return
            del self._heard[oldest]
        self._heard[peer] = now

    def is_unplaced(self, peer: Hashable) -> bool:
        """Return True if a peer did not get a place."""
        return self._learns and peer not in self._heard and peer != self._server

    def _readable(self) -> None:
        end = self._loop.time() + TURN_S
        for number in range(BURST):
            if number % 16 == 15 and self._loop.time() > end:
                return
            try:
                data, peer = self._socket.recvfrom(LONGEST_DATAGRAM + 1)
            except (BlockingIOError, InterruptedError):
                self._flood.emptied()
                return
            except OSError:  # the other side's port is closed for now: counted only
                self.counts.errors += 1
                continue
            refused = self._learns and not self._flood.passes(peer, data)
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
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()


async def open_udp(address: Address) -> UdpTransport:
    """Open a UDP socket that listens at `address`, sends to it, or both. Raises OSError if the system refuses."""
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
        with suppress(OSError):  # the system's own bound remains
            opened.setsockopt(socket.SOL_SOCKET, option, size)
    return UdpTransport(address, opened, None if address.listens else place)
