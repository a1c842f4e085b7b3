"""The route table: which function serves a request, known before its body is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from fastapi import APIRouter
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.routing import Match
from starlette.types import Scope


class RouteRow(NamedTuple):
    """A route of the API: method ("WEBSOCKET" for a web socket), path with its parameters' names, function."""

    method: str
    path: str
    endpoint: Callable[..., Any]


class RouteTable:
    """The routes of an application's routers, in the order in which they are looked at."""

    def __init__(self, routers: Sequence[APIRouter]) -> None:
        routes = [route for router in routers for route in router.routes]
        self._routes = [route for route in routes if isinstance(route, APIRoute | APIWebSocketRoute)]

    def endpoint(self, scope: Scope) -> Callable[..., Any] | None:
        """The function that serves a request; None where none does."""
        return next((route.endpoint for route in self._routes if route.matches(scope)[0] is Match.FULL), None)

    def methods(self, scope: Scope) -> list[str]:
        """The methods that the path of a request takes, sorted; none where there is no such path."""
        routes = [route for route in self._routes if route.matches(scope)[0] is not Match.NONE]
        return sorted({method for route in routes if isinstance(route, APIRoute) for method in route.methods or ()})

    def rows(self) -> Iterator[RouteRow]:
        """Every route of the API, a row for each method."""
        for route in self._routes:
            for method in sorted(route.methods or ()) if isinstance(route, APIRoute) else ["WEBSOCKET"]:
                yield RouteRow(method, route.path, route.endpoint)
