"""The gate: every request passes it before a route sees it. What is refused here costs little and keeps no body."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Any

from fastapi.requests import HTTPConnection
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from twodof.lab.access.declared import most_body, watchers_may
from twodof.lab.access.origin import host_is_ours, origin_is_ours
from twodof.lab.access.role import Role, role_of, token_of
from twodof.lab.access.route_table import RouteTable
from twodof.lab.finite_json import FiniteJSON
from twodof.lab.settings import LabSettings

API = "/api/"
MOST_DISCARDED, DISCARD_S = 64 << 20, 5.0
"""Of a request that is refused so many bytes, and for so long [s], are read before it is answered."""
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_CSP = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS: Mapping[str, str] = MappingProxyType(
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
"""Of every answer: the page runs its own scripts only, asks nobody else, and is framed by nobody."""
_RAW_HEADERS = tuple((name.encode(), value.encode()) for name, value in HEADERS.items())


class RequestTooLarge(HTTPException):
    """More was sent than the route takes."""

    def __init__(self, most: int) -> None:
        super().__init__(413, f"the request is larger than the {most} bytes that are taken here")


class Gate:
    """Middleware that lets in who may: host, origin, token, role and size are looked at, in this order."""

    def __init__(self, app: ASGIApp, settings: LabSettings, routes: RouteTable) -> None:
        self._app, self._settings, self._routes = app, settings, routes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request, web socket or the server's life span."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        endpoint = self._routes.endpoint(scope) if scope["path"].startswith(API) else None
        refusal = self._refusal(connection, endpoint)
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": 1008, "reason": refusal[1]})
            return
        sender = _with_headers(send, scope["path"])
        most = most_body(endpoint)
        if refusal is None and int(connection.headers.get("content-length", "0") or 0) > most:
            refusal = _too_large(most)
        if refusal is not None:
            await _discard(receive)
            await _refuse(refusal, scope, receive, sender)
            return
        await self._app(scope, _bounded(receive, most), sender)

    def _refusal(self, connection: HTTPConnection, endpoint: Callable[..., Any] | None) -> tuple[int, str, str] | None:
        """Status, what and remedy where it is not let in."""
        scope = connection.scope
        host = connection.headers.get("host", "")
        if not host_is_ours(host, self._settings):
            return 421, "the request is for another host", "open the link that the server printed"
        method = "GET" if scope["type"] == "websocket" else scope["method"]
        reads = method in SAFE
        if (not reads or scope["type"] == "websocket") and not origin_is_ours(connection.headers.get("origin"), host):
            return 403, "the request comes from a page of another site", "use the server's own page"
        if not scope["path"].startswith(API):
            return None  # the page itself is the same for everybody, and holds nothing
        length = connection.headers.get("content-length", "0")
        if not length.isascii() or not length.isdigit():
            return 400, "its length is not a number", "send a request that is whole"
        role = role_of(token_of(connection), self._settings)
        if role is None:
            return 401, "the token is missing or is not one of this server's", "open the link that the server printed"
        scope.setdefault("state", {})["role"] = role
        if role is Role.WATCH and not reads and not watchers_may(endpoint):
            return 403, "this link is for watching only", "ask for the link that commands"
        return None


def _too_large(most: int) -> tuple[int, str, str]:
    return 413, f"the request is larger than the {most} bytes that are taken here", "send less"


async def _refuse(refusal: tuple[int, str, str], scope: Scope, receive: Receive, send: Send) -> None:
    status, what, remedy = refusal
    headers = {"connection": "close"}
    if status == 401:
        headers["www-authenticate"] = "Bearer"
    answer = FiniteJSON({"what": what, "where": scope["path"][:200], "remedy": remedy}, status, headers=headers)
    await answer(scope, receive, send)


async def _discard(receive: Receive) -> None:
    """Read on, and keep nothing: a client that is still sending would not hear why it is refused. It has bounds."""
    got = 0
    with suppress(TimeoutError):
        async with asyncio.timeout(DISCARD_S):
            while got < MOST_DISCARDED:
                message = await receive()
                got += len(message.get("body", b""))
                if message["type"] != "http.request" or not message.get("more_body", False):
                    return


def _bounded(receive: Receive, most: int) -> Receive:
    """What is received, until it is more than was allowed: a body may come in pieces, without a length."""
    got = 0

    async def bounded() -> Message:
        nonlocal got
        message = await receive()
        if message["type"] == "http.request":
            got += len(message.get("body", b""))
            if got > most:
                if message.get("more_body", False):
                    await _discard(receive)
                raise RequestTooLarge(most)
        return message

    return bounded


def _with_headers(send: Send, path: str) -> Send:
    """Sends every answer with the headers that guard the page; what the API tells is not kept by anybody."""

    async def sender(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message.get("headers", ())}
            added = [row for row in _RAW_HEADERS if row[0] not in present]
            if path.startswith(API) and b"cache-control" not in present:
                added.append((b"cache-control", b"no-store"))
            message["headers"] = [*message.get("headers", ()), *added]
        await send(message)

    return sender
