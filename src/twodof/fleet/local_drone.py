"""A drone on this computer: its ports and their owners, its folder, its key, and the controllers that it flies."""

import asyncio
import errno
import pwd
import socket
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from twodof.errors import LinkError, printable
from twodof.link.connection import Connection
from twodof.link.mavlink.dialect import AUTOPILOT, message_id
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps
from twodof.link.transport import open_transport
from twodof.link.transport.url import Ports, parse

MOST_DRONES = Ports.GROUND_STATION - Ports.ONBOARD
"""Largest number of drones: the onboard port of the next one would be QGroundControl's."""

_LOOPBACK = "127.0.0.1"
# Ports that the programs of drone 0 listen on (docs/reference/protocol.md).
_LISTENED = (
    ("TCP", Ports.FLIGHT_CONTROLLER, "the flight controller"),
    ("TCP", Ports.COMPANION_TCP, "the companion"),
    ("UDP", Ports.COMPANION_ONBOARD, "the companion"),
    ("UDP", Ports.COMPANION_GROUND, "the companion, for ground stations"),
)
_PROC = Path("/proc")
_TABLES = MappingProxyType({"TCP": ("tcp", "tcp6"), "UDP": ("udp", "udp6")})
_CHILD = "twodof.fleet.child"
_LISTENING = "0A"
_PORT, _STATE, _USER, _INODE = 1, 3, 7, 9  # columns of /proc/net/tcp; the first is that of the local address
_MOST_SHOWN = 100


def port_in_use(index: int) -> str:
    """Return a sentence about the first port of drone `index` that is in use, "" if all are free."""
    for kind, first, whose in _LISTENED:
        port = first + index
        with closing(socket.socket(type=socket.SOCK_STREAM if kind == "TCP" else socket.SOCK_DGRAM)) as probe:
            if kind == "TCP":
                # As the servers set it: recently closed connections do not hold the port.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((_LOOPBACK, port))
                if kind == "TCP":
                    probe.listen(1)
            except OSError as refusal:
                if refusal.errno != errno.EADDRINUSE:
                    remedy = "let this user open the port, or choose other ports with --first"
                    raise LinkError(f"cannot be opened: {refusal.strerror}", f"{kind} port {port}", remedy) from refusal
                who = port_owner(kind, port)
                has = f"; {who} has it" if who else ""
                return f"{kind} port {port}, where {whose} of drone {index + 1} listens, is in use{has}"
    return ""


def check_ports_free(first: int, drones: int) -> None:
    """Raise LinkError if a port of one of `drones` drones, from index `first` on, is in use."""
    for index in range(first, first + drones):
        if found := port_in_use(index):
            numbers = range(MOST_DRONES - drones + 1)
            other = next((one for one in numbers if not any(map(port_in_use, range(one, one + drones)))), None)
            rest = "" if other is None else f", or take other numbers: --first {other + 1}"
            raise LinkError(found, "this machine", f"end that program, or ask who started it{rest}")


def port_owner(kind: str, port: int) -> str:
    """Return the process that listens at a "TCP" or "UDP" port: `process 4711 (twodof fcu --index 0)`; "" if unknown.

    If the process is another user's, the system shows only the user: `a process of the user ada`.
    """
    for table in _TABLES[kind]:
        with suppress(OSError):
            for line in (_PROC / "net" / table).read_text().splitlines()[1:]:
                columns = line.split()
                there = int(columns[_PORT].rpartition(":")[2], 16) == port
                if there and (kind == "UDP" or columns[_STATE] == _LISTENING):
                    return _process(f"socket:[{columns[_INODE]}]") or f"a process of {_name(int(columns[_USER]))}"
    return ""


def with_port_owner(error: LinkError) -> LinkError:
    """Return `error` with a remedy that names the process on its port; `error` itself if that process is unknown."""
    with suppress(LinkError):
        address = parse(error.where)
        port = address.port if address.listens else address.bind_port
        kind = "TCP" if address.kind.startswith("tcp") else "UDP"
        if port and "in use" in error.what and (who := port_owner(kind, port)):
            return LinkError(error.what, error.where, f"end {who}, or choose another port")
    return error


def _process(socket_name: str) -> str:
    """Return the process that holds a socket, "" if it is another user's."""
    for folder in _PROC.glob("[0-9]*"):
        with suppress(OSError):
            # A descriptor that was closed in the meantime resolves to itself.
            if any(one.resolve().name == socket_name for one in (folder / "fd").iterdir()):
                if _CHILD in _words(folder):  # its supervisor would restart it
                    folder = _PROC / (folder / "stat").read_text().rpartition(")")[2].split()[1]
                words = _words(folder)
                if words[0].rpartition("/")[2].startswith("python") and words[1:]:
                    words = [words[1].rpartition("/")[2], *words[2:]]
                return f"process {folder.name} ({printable(' '.join(' '.join(words).split()))[:_MOST_SHOWN]})"
    return ""


def _words(folder: Path) -> list[str]:
    return (folder / "cmdline").read_bytes().decode(errors="replace").rstrip("\0").split("\0")


def _name(user: int) -> str:
    with suppress(KeyError):
        return f"the user {pwd.getpwuid(user).pw_name}"
    return f"the user number {user}"


REQUEST_MESSAGE = 512

_PROBE = 240  # MAVLink system of the probe that waits for a drone; no client uses it


STOCK = "stock"
FLIES = "flies "


class ControllerReport(NamedTuple):
    """Active controller of a drone, and the number of parameters that differ from their defaults."""

    controller: str = STOCK
    changed: int = 0


def controller_in_words(controller: str, changed: int) -> str:
    """Describe what an earlier user left on a drone: "flies my_attitude; 3 parameters differ from their defaults".

    `controller` is the text in the message TWODOF_RIG, `changed` the number of parameters that are not at default.
    """
    what = "the stock controllers" if controller == STOCK else printable(controller)
    if not changed:
        return f"{FLIES}{what}; all parameters are at their defaults"
    differ = (
        "1 parameter differs from its default" if changed == 1 else f"{changed} parameters differ from their defaults"
    )
    return f"{FLIES}{what}; {differ}"


@dataclass(frozen=True)
class LocalDrone:
    """Drone number `index`: ports (docs/reference/protocol.md), seed, state folder and key file."""

    index: int
    seed: int = 1
    state: Path = Path()
    key: Path | None = None

    @property
    def options(self) -> list[str]:
        """Command-line options for both programs of the drone."""
        return ["--index", str(self.index), *(() if self.key is None else ("--key", str(self.key)))]

    @property
    def controller_options(self) -> list[str]:
        """Further command-line options for the flight controller alone."""
        return ["--seed", str(self.seed), "--state", str(self.state)]

    @property
    def system(self) -> int:
        """MAVLink system id."""
        return self.index + 1

    @property
    def fcu(self) -> str:
        """URL of the flight controller."""
        return f"tcp://127.0.0.1:{Ports.FLIGHT_CONTROLLER + self.index}"

    @property
    def companion(self) -> str:
        """URL of the companion's TCP port."""
        return f"tcp://127.0.0.1:{Ports.COMPANION_TCP + self.index}"

    def described(self, lockstep: bool) -> dict[str, Any]:
        """Return numbers and files of the drone, and the URL for each kind of client, as plain data."""
        return {
            "index": self.index,
            "system": self.system,
            "seed": self.seed,
            "state": str(self.state.absolute()),
            "key": None if self.key is None else str(self.key.absolute()),
            "fcu": self.fcu,
            "companion": self.companion,
            # In lockstep one client grants the time: it connects straight to the flight controller.
            "drone": self.fcu if lockstep else f"udp://127.0.0.1:{Ports.COMPANION_ONBOARD + self.index}",
            "mavsdk": f"udpin://127.0.0.1:{Ports.ONBOARD + self.index}",
            "mavproxy": f"tcp:127.0.0.1:{Ports.COMPANION_TCP + self.index}",
            "qgroundcontrol": f"udp://127.0.0.1:{Ports.GROUND_STATION}",
        }


async def wait_until_heard(url: str, system: int, timeout: float, key: Key | None = None) -> ControllerReport:
    """Wait for the flight controller with system id `system` at `url`; return its active controller.

    Frames are signed with `key`, if given. Raises LinkError if the flight controller is not heard within `timeout` [s].
    """
    try:
        async with asyncio.timeout(timeout):
            signing = None if key is None else Signing(key, Stamps(None))
            async with Connection(await open_transport(url, timeout), _PROBE, 1, signing) as connection:
                while True:
                    got = await connection.receive(1.0)
                    if got is None or (got.frame.system, got.frame.component) != (system, AUTOPILOT):
                        continue
                    if got.message.get_type() == "HEARTBEAT":
                        asked = {"command": REQUEST_MESSAGE, "param1": float(message_id("TWODOF_RIG"))}
                        connection.send(message("COMMAND_LONG", target_system=system, target_component=1, **asked))
                    elif got.message.get_type() == "TWODOF_RIG":
                        return ControllerReport(got.message.controller, got.message.changed)
    except TimeoutError:
        remedy = "read the output of the program at this URL"
        raise LinkError(f"no heartbeat of system {system} within {timeout:g} s", url, remedy) from None
