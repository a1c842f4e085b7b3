"""Transports by URL: UDP, TCP, serial lines and links in memory."""

import asyncio

from twodof.errors import LinkError, LinkLost
from twodof.link.transport.base import Transport, open_memory
from twodof.link.transport.serial_port import open_serial
from twodof.link.transport.tcp import open_tcp
from twodof.link.transport.udp import open_udp
from twodof.link.transport.url import Address, parse

# Often enough not to be noticed, seldom enough not to be felt.
RETRY_S = 0.05


async def open_transport(url: str, timeout: float = 5.0) -> Transport:
    """Open the transport that `url` names; the forms are in `url.parse`.

    If the other side does not listen yet, `open_transport` tries again until `timeout` [s] has passed. Raises LinkError
    for an invalid URL or one that the system refuses, LinkLost without an answer in time.
    """
    address = parse(url)
    try:
        async with asyncio.timeout(timeout):
            while True:
                try:
                    return await _open(address)
                except ConnectionRefusedError:
                    await asyncio.sleep(RETRY_S)
    except TimeoutError as error:
        what = f"no answer within {timeout:g} s"
        raise LinkLost(what, str(address), "start the other side, or correct the address") from error
    except OSError as error:
        bound = address.listens or address.bind_name
        remedy = "choose another port, or end the program that has it" if bound else "check the host's name"
        raise LinkError(f"cannot be opened: {error.strerror or error}", str(address), remedy) from error


async def _open(address: Address) -> Transport:
    if address.kind.startswith("udp"):
        return await open_udp(address)
    if address.kind.startswith("tcp"):
        return await open_tcp(address)
    return open_serial(address) if address.kind == "serial" else open_memory(address)
