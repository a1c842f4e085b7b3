"""An event loop for a test, and everything that comes to one end of a transport."""

import asyncio
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any

from tests.patience import PATIENCE_S
from twodof.link.transport.base import Transport
from twodof.link.transport.url import parse

# What a packet on loopback needs is under a millisecond; it is waited for until it must have been lost.
SOON = PATIENCE_S / 4


def run(work: Coroutine[Any, Any, Any]) -> Any:
    """In a fresh loop, with a deadline for the whole."""
    return asyncio.run(asyncio.wait_for(work, PATIENCE_S))


def port(end: Transport) -> int:
    """The port where an end listens."""
    address = parse(end.url)
    return address.bind_port or address.port


async def gather(end: Transport, size: int) -> bytes:
    """`size` bytes, however they are cut."""
    data = b""
    while len(data) < size:
        packet = await end.receive(SOON)
        assert packet is not None, f"{len(data)} of {size} bytes came"
        data += packet.data
    return data


def in_loop(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run an async test in a fresh loop, with a deadline."""

    @wraps(test)
    def limited(*given: Any, **named: Any) -> None:
        run(test(*given, **named))

    return limited
