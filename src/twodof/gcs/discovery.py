"""Discovery of drones: by heartbeats at the usual ports of this machine, and by answers at a host's ports."""

import asyncio
import errno
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, NamedTuple

from twodof.errors import LinkError, LinkLost, shown
from twodof.gcs.drone_state import word_of
from twodof.link.connection import Connection
from twodof.link.mavlink.dialect import AUTOPILOT, GROUND_STATION, NO_AUTOPILOT
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.modes import mode_name
from twodof.link.transport import open_transport
from twodof.link.transport.base import Transport
from twodof.link.transport.url import Ports, parse

LISTENED = (
    ("udp", Ports.COMPANION_ONBOARD),
    ("udp", Ports.COMPANION_GROUND),
    ("tcp", Ports.COMPANION_TCP),
    ("tcp", Ports.FLIGHT_CONTROLLER),
)
"""Where PX4, the companion and the flight controller listen, + i for drone i."""
DRONES = 8
REQUEST_MESSAGE, RIG = 512, 54206.0
SYSTEM = 241
"""System id of a client that only looks: no other client uses it."""


class FoundDrone(NamedTuple):
    """Drone that was heard: its system id, the URL to connect to, its state, its autopilot in words.

    A twodof drone also reports its active `controller` and how many parameters are `changed` from their defaults.
    """

    system: int
    url: str
    mode: str
    armed: bool
    autopilot: str
    controller: str = ""
    changed: int | None = None


LOOPBACK = "127.0.0.1"


def urls(hosts: Iterable[str] = ()) -> list[str]:
    """Return the URLs for `discover`: ports of this machine to which drones send, then ports of `hosts`."""
    places = [f"udpin://127.0.0.1:{Ports.ONBOARD + i}" for i in range(DRONES)]
    for host in hosts:
        for i in range(DRONES):
            places += [f"{kind}://{host}:{port + i}" for kind, port in LISTENED]
    return [*places, f"udpin://127.0.0.1:{Ports.GROUND_STATION}"]


async def open_link(url: str, timeout: float) -> tuple[Transport, LinkError | None]:
    """Open the transport of `url`; return it with None, or one to another port with the error of the first.

    A drone sends to one UDP port of this machine, which only one program can have. If another program has it, the
    returned transport sends to the port where the drone listens. Raises as `open_transport`.
    """
    try:
        return await open_transport(url, timeout), None
    except LinkError as error:
        address, cause = parse(url), error.__cause__
        taken = isinstance(cause, OSError) and cause.errno == errno.EADDRINUSE
        index = address.port - Ports.ONBOARD
        if not taken or address.kind != "udpin" or not 0 <= index < Ports.GROUND_STATION - Ports.ONBOARD:
            raise
        return await open_transport(f"udp://{LOOPBACK}:{Ports.COMPANION_ONBOARD + index}", timeout), error


async def discover(
    timeout: float = 3.0, hosts: Iterable[str] = (), places: Iterable[str] | None = None
) -> list[FoundDrone]:
    """Return the drones heard within `timeout` [s], by system id, each with a URL of its own if there is one.

    Listens at the ports of this machine to which drones send, and asks at the ports of `hosts`. `places` are URLs to
    look at instead. A place that cannot be opened is skipped. Raises LinkError for an unknown host.
    """
    hosts = list(hosts)
    for host in hosts:
        await _known(host)
    looked = list(urls(hosts) if places is None else places)
    heard: dict[tuple[int, str], FoundDrone] = {}
    await asyncio.gather(*(_look(url, timeout, heard) for url in looked))
    best: dict[int, FoundDrone] = {}
    drones = Counter(url for _, url in heard)  # at a URL with several drones, connecting finds any of them
    for found in sorted(heard.values(), key=lambda one: (drones[one.url] > 1, looked.index(one.url)), reverse=True):
        best[found.system] = found
    return [best[system] for system in sorted(best)]


async def _known(host: str) -> None:
    try:
        await asyncio.get_running_loop().getaddrinfo(host, None)
    except (OSError, UnicodeError) as error:
        raise LinkError(
            "is not a host that is known here", shown(host), "correct its name, or give its number"
        ) from error


def _note(heard: dict[tuple[int, str], FoundDrone], connection: Connection, url: str, system: int, got: Any) -> None:
    """Add the facts of one message of an autopilot to `heard`."""
    before = heard.get((system, url))
    if got.get_type() == "HEARTBEAT" and got.autopilot != NO_AUTOPILOT:
        word = word_of("MAV_AUTOPILOT", got.autopilot)
        found = FoundDrone(system, url, mode_name(got.custom_mode), bool(got.base_mode & 128), word)
        if before is None:
            asked = message(
                "COMMAND_LONG", command=REQUEST_MESSAGE, param1=RIG, target_system=system, target_component=1
            )
            connection.send(asked)
        else:
            found = found._replace(controller=before.controller, changed=before.changed)
        heard[system, url] = found
    elif got.get_type() == "TWODOF_RIG" and before is not None:
        heard[system, url] = before._replace(controller=got.controller, changed=got.changed)


async def _look(url: str, timeout: float, heard: dict[tuple[int, str], FoundDrone]) -> None:
    loop = asyncio.get_running_loop()
    end = loop.time() + timeout
    with suppress(LinkError):
        transport, _ = await open_link(url, timeout)
        async with Connection(transport, system=SYSTEM, component=GROUND_STATION) as connection:
            beats = loop.time()
            while (now := loop.time()) < end:
                if now >= beats:
                    beats += 1.0
                    with suppress(LinkLost):
                        connection.send(message("HEARTBEAT", type=6, autopilot=NO_AUTOPILOT, system_status=4))
                received = await connection.receive(min(end, beats) - now)
                if received is not None and received.frame.component == AUTOPILOT:
                    _note(heard, connection, url, received.frame.system, received.message)
