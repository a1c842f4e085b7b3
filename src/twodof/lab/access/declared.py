"""What a route declares about who may call it: that it only computes or stops, and how large a request it takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])
_COMPUTES, _STOPS, _TAKES = "__lab_computes__", "__lab_stops__", "__lab_takes__"
MOST_BODY = 1 << 20
"""Bytes of a request that a route takes which declares nothing."""


def computes(endpoint: Endpoint) -> Endpoint:
    """Declare that a route only computes: it changes nothing, so that who may only watch may call it too."""
    setattr(endpoint, _COMPUTES, True)
    return endpoint


def stops(endpoint: Endpoint) -> Endpoint:
    """Declare that a route stops motors: the safe state, so that who may only watch may call it too."""
    setattr(endpoint, _STOPS, True)
    return endpoint


def takes(most: int) -> Callable[[Endpoint], Endpoint]:
    """Declare that a route takes requests of up to `most` bytes, a log for instance; else it is MOST_BODY."""

    def declare(endpoint: Endpoint) -> Endpoint:
        setattr(endpoint, _TAKES, most)
        return endpoint

    return declare


def only_computes(endpoint: Callable[..., Any]) -> bool:
    """Whether a route was declared so."""
    return bool(getattr(endpoint, _COMPUTES, False))


def only_stops(endpoint: Callable[..., Any]) -> bool:
    """Whether a route was declared so."""
    return bool(getattr(endpoint, _STOPS, False))


def watchers_may(endpoint: Callable[..., Any] | None) -> bool:
    """Whether who may only watch may call a route that does more than read."""
    return endpoint is not None and (only_computes(endpoint) or only_stops(endpoint))


def most_body(endpoint: Callable[..., Any] | None) -> int:
    """How large a request it takes [bytes]."""
    return int(getattr(endpoint, _TAKES, MOST_BODY))
