"""Whether the ports of a virtual drone are free on this machine, asked before any program is started."""

from __future__ import annotations

import errno
import socket
from contextlib import closing

from twodof.errors import LinkError
from twodof.fleet.port_owner import port_owner
from twodof.link.transport import ports

MOST_DRONES = ports.GROUND_STATION - ports.ONBOARD
"""The next one's port for clients on board is QGroundControl's."""

_LOOPBACK = "127.0.0.1"
# What is listened at, with drone 0's port (docs/reference/protocol.md).
_LISTENED = (
    ("TCP", ports.FLIGHT_CONTROLLER, "the flight controller"),
    ("TCP", ports.COMPANION_TCP, "the companion"),
    ("UDP", ports.COMPANION_ONBOARD, "the companion"),
    ("UDP", ports.COMPANION_GROUND, "the companion, for ground stations"),
)


def port_in_use(index: int) -> str:
    """The first port of the drone `index` that somebody has, in words; "" if all are free."""
    for kind, first, whose in _LISTENED:
        port = first + index
        with closing(socket.socket(type=socket.SOCK_STREAM if kind == "TCP" else socket.SOCK_DGRAM)) as probe:
            if kind == "TCP":
                # As who listens there will set it: connections that were closed lately do not hold the port.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((_LOOPBACK, port))
                if kind == "TCP":
                    probe.listen(1)
            except OSError as refusal:
                if refusal.errno != errno.EADDRINUSE:
                    raise LinkError(f"cannot be opened: {refusal.strerror}", f"{kind} port {port}") from refusal
                who = port_owner(kind, port)
                has = f"; {who} has it" if who else ""
                return f"{kind} port {port}, where {whose} of drone {index + 1} listens, is in use{has}"
    return ""


def check_ports_free(first: int, drones: int) -> None:
    """That `drones` from number `first` on find their ports free. Raises LinkError, which names one that is not."""
    for index in range(first, first + drones):
        if found := port_in_use(index):
            free = (number for number in range(MOST_DRONES - drones + 1) if _all_free(number, drones))
            other = next(free, None)
            rest = "" if other is None else f", or take other numbers: --first {other}"
            raise LinkError(found, "this machine", f"end that program, or ask who started it{rest}")


def _all_free(first: int, drones: int) -> bool:
    return not any(map(port_in_use, range(first, first + drones)))
