"""TCP: to a host, or listening for several clients; a slow reader makes its sender wait and fills no memory."""

import asyncio
import socket
from collections import Counter
from collections.abc import Hashable
from contextlib import suppress
from typing import cast

from twodof.link.mavlink.framing import LONGEST_STOP, find_stop_frames
from twodof.link.transport.base import MOST_OUT_BYTES, Packet, Transport
from twodof.link.transport.url import Address

MOST_CLIENTS = 32
# Read in one round of the event loop, of all streams together: rubbish is looked through at a megabyte a second. Each
# address has the same share, and each stream the same of its address's, so that who opens many gets no more.
ROUND_BYTES, LEAST_BYTES = 4 << 10, 128
# Shares that may wait of one stream; then its sender is stopped, and it alone.
WINDOW_SHARES = 4
# A stream that fills its share rests for so long [s] for each other one that did so within FILLED_S: of many that flood
# the reader takes no more than leaves it time, and comes at once to who speaks little. One alone never rests.
REST_S, FILLED_S = 0.003, 0.25
# What the system keeps for who listens, and for who sends to one that does: no kill can overtake what waits there.
RECEIVED_BYTES, SENT_BYTES = 4 << 10, 4 << 10
# Of who waits to be taken in, and of who is refused once in so long [s].
BACKLOG, REFUSED_S = 64, 0.05
# Who has a place says something sound within so long [s], and again: a ground station sends a heartbeat each second.
SPEAKS_S, SILENT_S = 1.0, 10.0

# A peer whose machine or cable has gone says no goodbye: it has gone when nothing that it was sent is acknowledged for
# so long [s]; if it is sent nothing it is asked whether it is there.
GONE_S = 30
_ASKED = {"KEEPIDLE": GONE_S // 3, "KEEPINTVL": GONE_S // 6, "KEEPCNT": 4, "USER_TIMEOUT": 1000 * GONE_S}
_OPTIONS = (
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    *((socket.IPPROTO_TCP, getattr(socket, f"TCP_{name}", -1), value) for name, value in _ASKED.items()),
)


class _Stream(asyncio.BufferedProtocol):
    """One connection, of a client or to a server; itself the peer."""

    socket: asyncio.Transport  # once it stands

    def __init__(self, owner: "TcpTransport") -> None:
        self._owner = owner
        self._buffer = memoryview(bytearray(ROUND_BYTES))
        self._tail = b""  # the last bytes, in which a stop may have begun
        self.name = self.address = ""
        self.paused = self.rests = False
        self.came, self.sound = 0.0, -1.0  # when it came, when it last said something sound
        self.filled = -FILLED_S  # when it last filled its share

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set up a new connection."""
        self.socket = cast(asyncio.Transport, transport)
        raw = transport.get_extra_info("socket")
        for level, option, value in _OPTIONS:
            with suppress(OSError):  # a system that has it not: its own two hours hold
                raw.setsockopt(level, option, value)
        if not self._owner._listens:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_BYTES)
        peer = transport.get_extra_info("peername")
        self.address = str(peer[0]) if peer else "?"
        self.name = f"{peer[0]}:{peer[1]}" if peer else "?"
        self._owner._connected(self)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the buffer for the next bytes of the stream."""
        return self._buffer[: self._owner._share(self)]

    def buffer_updated(self, nbytes: int) -> None:
        """Take bytes of the stream."""
        self._owner._arrived(bytes(self._buffer[:nbytes]), self)

    def find_stop_frames(self, data: bytes) -> list[bytes]:
        """Return the kills and disarms that end in `data`, which continues the stream."""
        before, data = len(self._tail), self._tail + data
        self._tail = data[-LONGEST_STOP:]
        return find_stop_frames(data, before)

    def connection_lost(self, exc: Exception | None) -> None:
        """Note the end of the connection."""
        self._owner._disconnected(self, exc)

    def __repr__(self) -> str:
        return f"<tcp {self.name}>"


class TcpTransport(Transport):
    """One connection to a server, or a listening socket with its clients. Made by `open_tcp`."""

    def __init__(self, address: Address, listening: list[socket.socket]) -> None:
        super().__init__(str(address))
        self._listens = address.listens
        self._loop = asyncio.get_running_loop()
        self._listening = listening
        self._tasks: set[asyncio.Task[object]] = set()
        self._streams: dict[_Stream, None] = {}
        self._addresses: Counter[str] = Counter()  # how many of them
        self._inbox.on_taken = self._resume

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The open connections."""
        return tuple(self._streams)

    @property
    def backlog(self) -> int:
        """Bytes that wait for the slowest reader."""
        return max((one.socket.get_write_buffer_size() for one in self._streams), default=0)

    def confirm(self, peer: Hashable) -> None:
        """Note a valid frame: the peer is not the first to lose its place."""
        cast(_Stream, peer).sound = self._loop.time()

    def _accepts(self, one: socket.socket) -> None:
        """Accept the next connection of a listening socket."""
        try:
            came, address = one.accept()
        except OSError:  # it has gone again, or there are too many files
            self.counts.errors += 1
            return
        if not self._makes_room(str(address[0])):
            self.counts.errors += 1
            came.close()
            self._loop.remove_reader(one)  # who is refused comes again, and costs who flies
            self._loop.call_later(REFUSED_S, self._accepts_again, one)
            return
        came.setblocking(False)
        task = self._loop.create_task(self._take_in(came))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _accepts_again(self, one: socket.socket) -> None:
        if not self.closed:
            self._loop.add_reader(one, self._accepts, one)

    async def _take_in(self, came: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(lambda: _Stream(self), came)
        except OSError:  # it has gone again
            self.counts.errors += 1

    def _makes_room(self, address: str) -> bool:
        """Return True if there is a place for one more connection from `address`; if need be, free one.

        The first to lose its place is the oldest connection that never sent a valid frame. The next is one that has
        been silent for SILENT_S. Last, an address with more than half of all places loses its newest connection to
        another address. A connection that is kept never loses its place.
        """
        if len(self._streams) < MOST_CLIENTS:
            return True
        now = self._loop.time()
        others = [stream for stream in self._streams if not self.keeps(stream)]
        losers = [stream for stream in others if stream.sound < 0.0 and now - stream.came > SPEAKS_S][:1]
        losers += sorted((one for one in others if 0.0 <= one.sound < now - SILENT_S), key=lambda one: one.sound)[:1]
        losers += [
            one for one in others if one.address != address and self._addresses[one.address] > MOST_CLIENTS // 2
        ][-1:]
        if not losers:
            return False
        self._forget(losers[0])
        losers[0].socket.abort()
        return True

    def _forget(self, stream: _Stream) -> None:
        if stream in self._streams:
            del self._streams[stream]
            self._addresses[stream.address] -= 1
            self._addresses += Counter()  # without those that have none

    def _connected(self, stream: _Stream) -> None:
        stream.came = self._loop.time()
        if len(self._streams) >= MOST_CLIENTS or self.closed:
            self.counts.errors += 1
            stream.socket.abort()
        else:
            self._streams[stream] = None
            self._addresses[stream.address] += 1

    def _share(self, stream: _Stream) -> int:
        """Return how much of a stream is read at once [byte]."""
        of_address = ROUND_BYTES // max(len(self._addresses), 1) // max(self._addresses[stream.address], 1)
        return max(of_address, LEAST_BYTES)

    def _disconnected(self, stream: _Stream, error: Exception | None) -> None:
        self._forget(stream)
        if not self._listens:
            self._lose(f"the connection broke: {error}" if error else "the other side closed the connection")

    def _arrived(self, data: bytes, stream: _Stream) -> None:
        if stream not in self._streams:
            return
        for raw in stream.find_stop_frames(data) if self._inbox.stops_first else ():
            self._inbox.put_ahead(raw, stream)
        self._inbox.put(Packet(data, stream))
        if self._inbox.waits_of(stream) >= WINDOW_SHARES * self._share(stream) and not stream.paused:
            stream.paused = True
            stream.socket.pause_reading()
        if len(data) >= self._share(stream):
            self._rest(stream)

    def _rest(self, stream: _Stream) -> None:
        now = stream.filled = self._loop.time()
        others = sum(now - one.filled < FILLED_S for one in self._streams) - 1
        if others > 0 and not stream.rests:
            stream.rests = True
            stream.socket.pause_reading()
            self._loop.call_later(REST_S * others, self._rested, stream)

    def _rested(self, stream: _Stream) -> None:
        stream.rests = False
        self._go_on(stream)

    def _resume(self, peer: Hashable) -> None:
        stream = cast(_Stream, peer)
        if stream.paused and self._inbox.waits_of(stream) < WINDOW_SHARES * self._share(stream) // 2:
            stream.paused = False
            self._go_on(stream)

    def _go_on(self, stream: _Stream) -> None:
        if not (stream.paused or stream.rests or stream.socket.is_closing() or self.closed):
            stream.socket.resume_reading()

    def _send(self, data: bytes, peer: Hashable) -> bool:
        stream = cast(_Stream, peer)
        if stream not in self._streams or stream.socket.is_closing():
            return False
        if stream.socket.get_write_buffer_size() + len(data) > MOST_OUT_BYTES:
            return False
        stream.socket.write(data)
        return True

    def _release(self) -> None:
        for one in self._listening:
            self._loop.remove_reader(one)
            one.close()
        self._listening.clear()
        for stream in [*self._streams]:
            # Flushes what the system takes at once; `close` alone would wait for a peer that does not read.
            if stream.socket.get_write_buffer_size():
                stream.socket.abort()
            else:
                stream.socket.close()
        self._streams.clear()
        self._addresses.clear()


async def open_tcp(address: Address) -> TcpTransport:
    """Connect to `address`, or listen there. Raises OSError if the system refuses."""
    loop = asyncio.get_running_loop()
    listening: list[socket.socket] = []
    transport = TcpTransport(address, listening)
    try:
        if address.listens:
            places = await loop.getaddrinfo(address.name, address.port, type=socket.SOCK_STREAM)
            for family, kind, _, _, place in dict.fromkeys(places):
                listening.append(one := socket.socket(family, kind))
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVED_BYTES)  # who connects inherits it
                one.setblocking(False)
                one.bind(place)
                one.listen(BACKLOG)
                loop.add_reader(one, transport._accepts, one)
            transport.url = str(address.at(listening[0].getsockname()[1]))
        else:
            await loop.create_connection(lambda: _Stream(transport), address.name, address.port)
    except OSError:
        transport._release()
        raise
    return transport
