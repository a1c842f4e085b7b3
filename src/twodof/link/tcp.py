"""TCP: to a host, or listening for several clients; a reader that cannot keep up stops its sender, not its memory."""

import asyncio
import socket
from collections.abc import Hashable
from contextlib import suppress
from typing import cast

from twodof.errors import LinkError
from twodof.link.transport import MOST_OUT_BYTES, Packet, Transport
from twodof.link.url import Address

MOST_CLIENTS = 32
# What may wait of one stream; then its sender is stopped, and it alone: another's kill must not wait behind a flood.
WINDOW_BYTES = 16 << 10
# Read at once: rubbish is looked through at a megabyte a second.
PIECE_BYTES = 4 << 10


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

    def __init__(self, owner: "TcpTransport") -> None:
        self._owner = owner
        self._buffer = bytearray(PIECE_BYTES)
        self.socket: asyncio.Transport | None = None
        self.name = ""
        self.paused = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A connection stands."""
        self.socket = cast(asyncio.Transport, transport)
        raw = transport.get_extra_info("socket")
        for level, option, value in _OPTIONS:
            with suppress(OSError):  # a system that has it not: its own two hours hold
                raw.setsockopt(level, option, value)
        peer = transport.get_extra_info("peername")
        self.name = f"{peer[0]}:{peer[1]}" if peer else "?"
        self._owner._connected(self)

    def get_buffer(self, sizehint: int) -> bytearray:
        """Where the next bytes of the stream go."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Some bytes of the stream."""
        self._owner._arrived(bytes(memoryview(self._buffer)[:nbytes]), self)

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is gone."""
        self._owner._disconnected(self, exc)

    def __repr__(self) -> str:
        return f"<tcp {self.name}>"


class TcpTransport(Transport):
    """One connection to a server, or a listening socket with its clients. Made by `open_tcp`."""

    def __init__(self, address: Address) -> None:
        super().__init__(str(address))
        self._listens = address.listens
        self._server: asyncio.Server | None = None
        self._streams: dict[_Stream, None] = {}
        self._inbox.on_taken = self._resume

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The connections that stand."""
        return tuple(self._streams)

    @property
    def port(self) -> int:
        """The port it listens on, 0 for a client."""
        return int(self._server.sockets[0].getsockname()[1]) if self._server is not None else 0

    @property
    def backlog(self) -> int:
        """Bytes that wait for the slowest reader."""
        return max((one.socket.get_write_buffer_size() for one in self._streams if one.socket is not None), default=0)

    def _connected(self, stream: _Stream) -> None:
        if len(self._streams) >= MOST_CLIENTS or self._closed:
            self.counts.errors += 1
            if stream.socket is not None:
                stream.socket.abort()
        else:
            self._streams[stream] = None

    def _disconnected(self, stream: _Stream, error: Exception | None) -> None:
        self._streams.pop(stream, None)
        if not self._listens:
            self._lose(f"the connection broke: {error}" if error else "the other side closed the connection")

    def _arrived(self, data: bytes, stream: _Stream) -> None:
        if stream not in self._streams:
            return
        self._inbox.put(Packet(data, stream))
        if self._inbox.waits_of(stream) >= WINDOW_BYTES and not stream.paused and stream.socket is not None:
            stream.paused = True
            stream.socket.pause_reading()

    def _resume(self, peer: Hashable) -> None:
        stream = cast(_Stream, peer)
        if stream.paused and self._inbox.waits_of(stream) < WINDOW_BYTES // 2:
            stream.paused = False
            if stream.socket is not None and not stream.socket.is_closing():
                stream.socket.resume_reading()

    def _send(self, data: bytes, peer: Hashable) -> bool:
        stream = cast(_Stream, peer)
        if stream not in self._streams or stream.socket is None or stream.socket.is_closing():
            return False
        if stream.socket.get_write_buffer_size() + len(data) > MOST_OUT_BYTES:
            return False
        stream.socket.write(data)
        return True

    def _release(self) -> None:
        if self._server is not None:
            self._server.close()
        for stream in [*self._streams]:
            if stream.socket is not None:
                # Flushes what the system takes at once; `close` alone would wait for a peer that does not read.
                if stream.socket.get_write_buffer_size():
                    stream.socket.abort()
                else:
                    stream.socket.close()
        self._streams.clear()


async def open_tcp(address: Address) -> TcpTransport:
    """A connection to `address`, or a socket that listens there.

    Raises LinkError where the system refuses, ConnectionRefusedError where nobody listens (yet).
    """
    loop = asyncio.get_running_loop()
    transport = TcpTransport(address)
    try:
        if address.listens:
            transport._server = await loop.create_server(lambda: _Stream(transport), address.name, address.port)
        else:
            await loop.create_connection(lambda: _Stream(transport), address.name, address.port)
    except ConnectionRefusedError:
        raise
    except OSError as error:
        remedy = "choose another port, or end who has it" if address.listens else "check the host's name"
        raise LinkError(f"cannot be opened: {error.strerror or error}", str(address), remedy) from error
    return transport
