"""Access to the server: tokens and roles, the origin of requests, and how large a request may be.

`Gate` looks at every request before its route is found: host, origin, token. `LabRoute` looks at it before its body is
read: role and size. A route says in `dependencies` whether clients that only watch may call it, and its largest body.

A page of another site can have its reader's browser send requests to this computer. It cannot forge `Origin` or
`Sec-Fetch-Site`, which comes with a GET too; a link to the page opens it, but the API does not answer it. With a
name of its own that points to this computer (DNS rebinding) it would be its own origin; it cannot forge `Host`.
"""

import asyncio
import hmac
import ipaddress
import os
import socket
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from fastapi import APIRouter, Depends
from fastapi.requests import HTTPConnection, Request
from fastapi.responses import Response
from fastapi.routing import APIRoute
from pydantic_core import from_json
from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from twodof.errors import RecordingError
from twodof.lab.answers import FiniteJSON, Refused
from twodof.lab.settings import LabSettings, is_loopback
from twodof.lab.turns import Pace

API = "/api/"
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
OWN_SITE = frozenset({"same-origin", "none"})
"""`Sec-Fetch-Site` of requests to the API that the page or a person's typing makes; programs send none."""
MOST_BODY = 256 << 10
"""Default of the largest body of a request [byte]."""
MOST_KEYS, MOST_ITEMS = 256, 20_000
"""Most members of an object and of an array in a request's JSON: each wrong one takes .1 ms."""
STOP = "/kill"
"""End of the path of the request that stops motors, which waits for no other requests than such of watchers."""
MOST_DISCARDED, DISCARD_S = 64 << 20, 5.0
"""Bytes of a refused request that are read before it is answered, and the longest time [s]."""
_BEARER = "bearer "
_LONGEST_TOKEN = 200
_CSP = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = MappingProxyType(
    {
        "content-security-policy": _CSP,
        "x-content-type-options": "nosniff",
        "x-frame-options": "DENY",
        "referrer-policy": "no-referrer",
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=()",
    }
)
"""Headers of every answer: the page runs its own scripts only, loads nothing from elsewhere, and is not framed."""


class Role(StrEnum):
    """Right of a client: to command, or only to watch."""

    COMMAND = "command"
    WATCH = "watch"


class LabClient(NamedTuple):
    """Role and address of a client. Behind a proxy or a tunnel the address is that of the proxy."""

    role: Role
    address: str

    def __str__(self) -> str:
        who = "a commanding client" if self.role is Role.COMMAND else "a watching client"
        return f"{who} at {self.address}"


CLIENT: ContextVar[LabClient] = ContextVar("client", default=LabClient(Role.COMMAND, "this program"))  # noqa: B039
"""Client whose request is served."""


@dataclass(frozen=True)
class _Mark:
    """Mark in a route's `dependencies`: `watchers` may call the route too; its body has at most `most` bytes."""

    watchers: bool = False
    most: int = MOST_BODY

    async def __call__(self) -> None:
        """Do nothing."""


WATCHERS_MAY = Depends(_Mark(watchers=True))
"""In a route's `dependencies`: it changes nothing, or stops motors, so clients that only watch may call it too."""


def takes(most: int) -> Any:
    """Return a mark for a route's `dependencies` that allows bodies of up to `most` bytes, such as a log."""
    return Depends(_Mark(most=most))


class _BoundedRequest(Request):
    async def json(self) -> Any:
        """Return the body's JSON. Raises Refused for too many members, ValueError."""
        waiting = [found := from_json(await self.body())]
        while waiting:
            one = waiting.pop()
            if isinstance(one, dict | list):
                if len(one) > (most := MOST_KEYS if isinstance(one, dict) else MOST_ITEMS):
                    raise Refused(413, f"an object or array has more than {most} members", "send fewer")
                waiting += one.values() if isinstance(one, dict) else one
        return found


class LabRoute(APIRoute):
    """Route that checks the client's role and the size of the request before its body is read."""

    @property
    def for_watchers(self) -> bool:
        """True if clients that only watch may call the route."""
        return any(mark.watchers for mark in self._marks) or (self.methods or set()) <= SAFE

    @property
    def most_body(self) -> int:
        """Largest body [bytes]."""
        return max((mark.most for mark in self._marks), default=MOST_BODY)

    @property
    def _marks(self) -> list[_Mark]:
        return [one.dependency for one in self.dependencies if isinstance(one.dependency, _Mark)]

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the function that serves a request."""
        handle = super().get_route_handler()

        async def checked(request: Request) -> Response:
            try:
                if CLIENT.get().role is Role.WATCH and not self.for_watchers:
                    raise Refused(403, "this link is for watching only", "ask for the link that commands")
                if int(request.headers.get("content-length", "0")) > self.most_body:
                    raise _too_large(self.most_body)
            except Refused:
                await _discard(request.receive)
                raise
            request.state.body.most = self.most_body
            return await handle(_BoundedRequest(request.scope, request.receive))

        return checked


RAW = {"requestBody": {"required": True, "content": {"application/octet-stream": {"schema": {"type": "string"}}}}}
"""`openapi_extra` of a route whose body is a file's bytes."""


async def receive_file(request: Request, path: Path) -> None:
    """Write the request's body, whose length the route bounds, into a new file. Raises RecordingError."""
    try:
        with path.open("xb") as stream:
            async for piece in request.stream():
                stream.write(piece)
    except OSError as refusal:
        what = f"cannot be kept: {os.strerror(refusal.errno or 0)}"
        raise RecordingError(what, "logs", "make room on the server's disk") from refusal


def lab_router(prefix: str, tag: str) -> APIRouter:
    """Return a router for routes of one subject."""
    return APIRouter(prefix=prefix, tags=[tag], route_class=LabRoute)


def lab_routes(routers: Sequence[APIRouter]) -> list[LabRoute]:
    """Return the routes of routers, web sockets left out."""
    return [route for router in routers for route in router.routes if isinstance(route, LabRoute)]


class Gate:
    """Middleware that checks host, origin and token of every request and web socket, in this order.

    Requests of clients that may not command begin in turns; those that stop motors have turns of their own.
    """

    def __init__(self, app: ASGIApp, settings: LabSettings) -> None:
        self._app, self._settings = app, settings
        self._paces, self._stops = {None: Pace(), Role.WATCH: Pace()}, {Role.WATCH: Pace()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, web socket or the server's life span."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        scope["headers"] = [one for one in scope["headers"] if one[0] != b"range"]  # whole files: a range costs as much
        refusal = self._refusal(HTTPConnection(scope))
        state, address = scope["state"], scope["client"][0] if scope.get("client") else "an unknown place"
        role = state.get("role")
        state["pace"] = pace = self._paces.get(role)
        if role is not None:
            CLIENT.set(LabClient(role, address))
            state["connection"].prove(role)
        with suppress(ClientDisconnect):
            if refusal is not None and scope["type"] == "http":
                await _discard(receive)
            if refusal is None and role is not None and scope["path"].endswith(STOP):
                pace = self._stops.get(role)
            if pace is not None:
                await pace.turn(address)
            if scope["type"] == "http":
                state["body"] = receive = _Body(receive, pace, address)
                send = _with_headers(send, scope["path"])
            if refusal is None:
                await self._app(scope, receive, send)
            elif scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008, "reason": refusal.what})
            else:
                said = {"what": refusal.what, "where": scope["path"][:200], "remedy": refusal.remedy}
                await FiniteJSON(said, refusal.status_code, headers=refusal.headers)(scope, receive, send)

    def _refusal(self, connection: HTTPConnection) -> Refused | None:
        scope = connection.scope
        host = connection.headers.get("host", "")
        if not host_is_ours(host, self._settings):
            return Refused(421, "the request is for another host", "open the link that the server printed")
        changes = scope["type"] == "websocket" or scope["method"] not in SAFE
        if changes and not origin_is_ours(connection.headers.get("origin"), host):
            return Refused(403, "the request comes from a page of another site", "use the server's own page")
        if not scope["path"].startswith(API):
            return None  # the page itself is the same for everybody, and holds nothing
        if connection.headers.get("sec-fetch-site", "none") not in OWN_SITE:
            return Refused(403, "the request comes from a page of another site", "use the server's own page")
        role = role_of(token_of(connection), self._settings)
        if role is None:
            what = "the token is missing or is not one of this server's"
            return Refused(401, what, "open the link that the server printed", {"www-authenticate": "Bearer"})
        scope["state"]["role"] = role
        return None


def token_of(connection: HTTPConnection) -> str:
    """Return the token in a request's header; for a web socket, which has no such header, that in `?token=`."""
    header = connection.headers.get("authorization", "")
    if header[: len(_BEARER)].lower() == _BEARER:
        return str(header[len(_BEARER) :].strip())
    if connection.scope["type"] == "websocket":
        query = connection.scope.get("query_string", b"")[:4096].decode("latin-1")
        return str(parse_qs(query).get("token", [""])[0])
    return ""


def role_of(token: str, settings: LabSettings) -> Role | None:
    """Return the role that a token gives; None for a wrong token."""
    if not token:
        return None if settings.needs_token else Role.COMMAND
    given = token[:_LONGEST_TOKEN].encode()
    for known, role in ((settings.command_token, Role.COMMAND), (settings.watch_token, Role.WATCH)):
        if known and hmac.compare_digest(given, known.encode()):
            return role
    return None


def host_is_ours(host: str, settings: LabSettings) -> bool:
    """Return True if `Host` is an address or name of this server that no other site can use for itself.

    For a server on the loopback that is a loopback address or `localhost`; else any address, or this computer's name.
    """
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return False
    if is_loopback(name):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return settings.reached and name in {*_own_names(), settings.host.lower()}
    return settings.reached


def origin_is_ours(origin: str | None, host: str) -> bool:
    """Return True if a request comes from the server's own page, or from a program, which sends no `Origin`."""
    if origin is None:
        return True
    try:
        found = urlsplit(origin)
    except ValueError:
        return False
    return found.scheme in ("http", "https") and bool(host) and found.netloc.lower() == host.lower()


@lru_cache(maxsize=1)
def _own_names() -> frozenset[str]:
    name = socket.gethostname().lower()
    return frozenset({name, f"{name}.local"} - {""})


def _too_large(most: int) -> Refused:
    return Refused(413, f"the request is larger than {most} bytes", "send less")


async def _discard(receive: Receive) -> None:
    """Read the rest of a request and drop it: a client that is still sending would not read the refusal."""
    got = 0
    with suppress(TimeoutError):
        async with asyncio.timeout(DISCARD_S):
            while got < MOST_DISCARDED:
                message = await receive()
                got += len(message.get("body", b""))
                if message["type"] != "http.request" or not message.get("more_body", False):
                    return


class _Body:
    """Body of a request, of at most `most` bytes; once it is whole it waits for another turn, by its size."""

    def __init__(self, receive: Receive, pace: Pace | None, person: str) -> None:
        self._receive, self._pace, self._person = receive, pace, person
        self._size, self.most = 0, MOST_BODY

    async def __call__(self) -> Message:
        """Return the next message. Raises Refused."""
        message = await self._receive()
        self._size += len(message.get("body", b""))
        more = message.get("more_body", False)
        if self._size > self.most:  # it may come in pieces and without a length
            if more:
                await _discard(self._receive)
            raise _too_large(self.most)
        if self._pace is not None and self._size and message["type"] == "http.request" and not more:
            await self._pace.turn(self._person, self._size)
        return message


def _with_headers(send: Send, path: str) -> Send:
    """Return `send` with the headers that guard the page; answers of the API are not cached."""

    async def sender(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in (HEADERS | {"cache-control": "no-store"} if path.startswith(API) else HEADERS).items():
                headers.setdefault(name, value)
        await send(message)

    return sender
