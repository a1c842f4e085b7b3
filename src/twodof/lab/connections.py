"""Connections of the server: places by role and person, and time limits of heads, bodies and answers.

A connection that has proved no role may be anybody's. It never takes the place of one that has: each role has its own
places. When they are full, the person with the most connections loses the oldest one, as in nginx
(`ngx_drain_connections`), so that a new connection is always accepted.
"""

from __future__ import annotations

import asyncio
import re
import resource
import time
from collections.abc import Callable
from math import inf
from typing import Any

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from twodof.errors import LinkError
from twodof.lab.access import STOP, Role, role_of
from twodof.lab.settings import LabSettings
from twodof.lab.turns import Turns, greediest

HEAD_S, BODY_S, SEND_S = 10.0, 10.0, 30.0
"""Longest time for a request's head, for its body, and in which a client takes nothing of an answer [s]."""
BODY_RATE = 16 * 1024
"""Bytes of a body that give it one second more."""
MOST_PLACES = 2000
"""Most connections of one role; a web socket that hears telemetry has a place of its own."""
OWN_FILES = 32
"""Files that the server keeps open for itself: drones, processes, recordings, files that it sends."""
ACCEPTED_AT_ONCE, ENDED_AT_ONCE = 1, 32
PIECE = 4096
"""Bytes read at once [byte]: none of them keeps the event loop for long."""
READ_AT_ONCE, REST, LONGEST_REST_S = 2, 16.0, 0.5
"""Pieces of a role that does not command are read in turns; each rests so many times as long, up to the last [s]."""
_TOKEN, _QUERY = re.compile(rb"earer +(\S{1,200})"), re.compile(rb"GET [^ ]{1,40}[?&]token=([^& ]{1,200})")
_STOP = re.compile(rb"POST [^ ?]{1,100}" + STOP.encode())


def raise_file_limit() -> int:
    """Let the process open as many files as the system allows; return their number."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = 65_536 if hard == resource.RLIM_INFINITY else hard
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    return most


class Places:
    """Places of connections in a process that may open `files` files. Raises LinkError if they do not suffice."""

    def __init__(self, files: int) -> None:
        self.most = min(MOST_PLACES, (files - OWN_FILES - ACCEPTED_AT_ONCE) // 5)
        if self.most < 2:
            what = f"this process may open {files} files only"
            raise LinkError(what, "server", "raise the limit: `ulimit -n 1024`, then start it again")
        self._taken: dict[Role | None, dict[PlacedConnection, None]] = {role: {} for role in (None, *Role)}

    def take(self, one: PlacedConnection) -> None:
        """Give a connection a place among those of its role, and close another one if there are too many."""
        taken = self._taken[one.role]
        taken[one] = None
        if len(taken) > self.most:
            person = greediest(other.person for other in taken)
            theirs = [other for other in taken if other.person == person]
            next((other for other in theirs if other.idle), theirs[0]).end()

    def leave(self, one: PlacedConnection) -> None:
        """Take a connection's place back."""
        self._taken[one.role].pop(one, None)

    def end_late(self) -> None:
        """Close connections whose time is over, a few at once; for each turn of the server's clock."""
        now = time.monotonic()
        everyone = [one for taken in self._taken.values() for one in taken]
        for one in everyone:
            if one.transport.is_closing():  # the client takes the rest, or not
                one.due = min(one.due, now + SEND_S)
        for one in [one for one in everyone if min(one.due, one.unread_due) < now][:ENDED_AT_ONCE]:
            one.end()


class LabConfig(uvicorn.Config):
    """Uvicorn's configuration with the places of its connections, and the settings for their tokens."""

    def __init__(self, app: ASGIApp, places: Places, settings: LabSettings, **options: Any) -> None:
        self.places, self.settings = places, settings
        self.lines = {role: Turns(READ_AT_ONCE, 10_000, "server") for role in (None, *Role)}
        super().__init__(app, http=HttpConnection, ws=SocketConnection, backlog=ACCEPTED_AT_ONCE, **options)


class PlacedConnection(asyncio.Protocol):
    """Connection with a place, in `scope["state"]["connection"]` of its requests.

    `role` is None until a request has shown its token. The connection is closed at `due` or `unread_due`, or earlier if
    it is `idle` and another one needs its place.
    """

    config: Any  # LabConfig
    loop: asyncio.AbstractEventLoop
    transport: asyncio.Transport
    client: tuple[str, int] | None
    app_state: dict[str, Any]
    role: Role | None = None
    due = unread_due = inf
    idle = _gone = False
    places = property(lambda self: self.config.places)
    reads = True  # False while earlier data wait for the application
    take_in: Callable[[bytes], None]  # the protocol's
    _unread = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place."""
        super().connection_made(transport)
        transport.max_size = PIECE  # type: ignore[attr-defined]  # of asyncio's transports
        self.app_state = {**self.app_state, "connection": self}
        self.due = time.monotonic() + HEAD_S
        self.places.take(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back."""
        self._gone = True
        self.places.leave(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read at once what a commanding client sends, and a watcher's stop; let all else wait in line."""
        if self.role is None:
            found = _TOKEN.search(data) or _QUERY.match(data)
            self.prove(role_of(found[1].decode("latin-1") if found else "", self.config.settings))
        if not self._unread and (self.role is Role.COMMAND or (self.role is not None and _STOP.match(data))):
            self.take_in(data)
            return
        self.transport.pause_reading()
        if not self._unread:
            self._reading = self.loop.create_task(self._read(self.config.lines[self.role]))
        self._unread += data

    async def _read(self, line: Turns) -> None:
        """Read in turn what waits, then let more come; the wait counts for no time limit."""
        left, self.due = self.due - time.monotonic(), inf
        await line.take(self.person)
        self.due, began = time.monotonic() + left, time.thread_time()
        data, self._unread = self._unread, b""
        try:
            if not self.transport.is_closing():
                self.take_in(data)
                if self.reads and not self._unread:
                    self.transport.resume_reading()
        finally:
            self.loop.call_later(min(REST * (time.thread_time() - began), LONGEST_REST_S), line.give_back)

    @property
    def person(self) -> str:
        """Address of the client."""
        return "" if self.client is None else self.client[0]

    def prove(self, role: Role | None) -> None:
        """Move to the places of a role; None is that of a client that has not proved one."""
        if role is not self.role and not self._gone:
            self.places.leave(self)
            self.role = role
            self.places.take(self)

    def end(self) -> None:
        """Close the connection at once, also if the client takes nothing."""
        self._gone = True
        self.places.leave(self)
        self.transport.abort()


class HttpConnection(PlacedConnection, H11Protocol):
    """HTTP connection with time limits."""

    idle = property(lambda self: self.cycle is None or self.cycle.response_complete)
    reads = property(lambda self: not self.flow.read_paused)

    def take_in(self, data: bytes) -> None:
        """Give data to the protocol, and set the time for the rest of the head or body."""
        before = self.conn.their_state
        H11Protocol.data_received(self, data)
        self._set_due(len(data), self.conn.their_state is not before)

    def on_response_complete(self) -> None:
        """Go on with the next request, which may have come already."""
        super().on_response_complete()
        self._set_due(0, True)

    def _set_due(self, size: int, begins: bool) -> None:
        state, now = self.conn.their_state, time.monotonic()
        if state is h11.SEND_BODY:
            self.due = (now + BODY_S if begins or not self.reads else self.due) + size / BODY_RATE
        elif state is h11.IDLE and size:
            self.due = min(self.due, now + HEAD_S)
        else:
            self.due = inf

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Leave the place to the web socket."""
        self.places.leave(self)
        super().handle_websocket_upgrade(event)

    def pause_writing(self) -> None:
        """Set the time in which the client must take more."""
        super().pause_writing()
        self.unread_due = time.monotonic() + SEND_S

    def resume_writing(self) -> None:
        """Wait no longer for the client."""
        super().resume_writing()
        self.unread_due = inf


class SocketConnection(PlacedConnection, WebSocketsSansIOProtocol):
    """Web socket, which has a connection's place until it hears telemetry, and again while it is being closed."""

    reads = property(lambda self: not self.read_paused)
    take_in = WebSocketsSansIOProtocol.data_received

    def keep(self) -> None:
        """Leave the connections' places for one among the clients of telemetry."""
        self.places.leave(self)

    def leave(self) -> None:
        """Take a connection's place for the time of closing."""
        if not self._gone:
            self.idle, self.due = True, time.monotonic() + HEAD_S
            self.places.take(self)
