"""Whether the ports of a virtual drone are free on this machine, and who has one that is not.

That is the process to end, or whose owner to ask. Only Linux tells (/proc).
"""

import errno
import pwd
import socket
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from types import MappingProxyType

from twodof.errors import LinkError
from twodof.link.transport import ports
from twodof.link.transport.url import parse

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
_PROC = Path("/proc")
_TABLES = MappingProxyType({"TCP": ("tcp", "tcp6"), "UDP": ("udp", "udp6")})
_CHILD = "twodof.fleet.child"
_LISTENING = "0A"
_PORT, _STATE, _USER, _INODE = 1, 3, 7, 9  # columns of /proc/net/tcp; the first is that of the local address
_MOST_SHOWN = 100


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
    """That `drones` from index `first` on find their ports free. Raises LinkError, which names one that is not."""
    for index in range(first, first + drones):
        if found := port_in_use(index):
            free = (number for number in range(MOST_DRONES - drones + 1) if _all_free(number, drones))
            other = next(free, None)
            rest = "" if other is None else f", or take other numbers: --first {other + 1}"
            raise LinkError(found, "this machine", f"end that program, or ask who started it{rest}")


def _all_free(first: int, drones: int) -> bool:
    return not any(map(port_in_use, range(first, first + drones)))


def port_owner(kind: str, port: int) -> str:
    """Who listens at a "TCP" or "UDP" port: `process 4711 (twodof fcu --index 0)`, or whose it is; "" if unknown.

    What other users' processes hold is not shown to us, only that they do.
    """
    for inode, user in _sockets(kind, port):
        return _process(f"socket:[{inode}]") or f"a process of {_name(user)}"
    return ""


def with_port_owner(error: LinkError) -> LinkError:
    """The error of a link that could not be opened, with who has its port in the remedy where that is so and known."""
    with suppress(LinkError):
        address = parse(error.where)
        port = address.port if address.listens else address.bind_port
        who = (
            port_owner("TCP" if address.kind.startswith("tcp") else "UDP", port)
            if port and "in use" in error.what
            else ""
        )
        if who:
            return LinkError(error.what, error.where, f"end {who}, or choose another port")
    return error


def _sockets(kind: str, port: int) -> Iterator[tuple[str, int]]:
    """Inode and user of each socket that is bound there."""
    for table in _TABLES[kind]:
        with suppress(OSError):
            for line in (_PROC / "net" / table).read_text().splitlines()[1:]:
                columns = line.split()
                there = int(columns[_PORT].rpartition(":")[2], 16) == port
                if there and (kind == "UDP" or columns[_STATE] == _LISTENING):
                    yield columns[_INODE], int(columns[_USER])


def _process(link: str) -> str:
    """The process that holds a socket, "" if it is not one that we may see."""
    wanted = Path(link)
    for folder in _PROC.glob("[0-9]*"):
        with suppress(OSError):
            if any(_link(one) == wanted for one in (folder / "fd").iterdir()):
                if _CHILD in _words(folder):  # whoever started it would start it again
                    folder = _PROC / (folder / "stat").read_text().rpartition(")")[2].split()[1]
                return f"process {folder.name} ({_command(folder)})"
    return ""


def _link(descriptor: Path) -> Path | None:
    """The file of a descriptor; None if it is closed by now, as the one is with which they are listed."""
    with suppress(OSError):
        return descriptor.readlink()
    return None


def _words(folder: Path) -> list[str]:
    return (folder / "cmdline").read_bytes().decode(errors="replace").rstrip("\0").split("\0")


def _command(folder: Path) -> str:
    """Its command line, without the interpreter in front of it."""
    words = _words(folder)
    if words[0].rpartition("/")[2].startswith("python") and words[1:]:
        words = [words[1].rpartition("/")[2], *words[2:]]
    text = " ".join(words)
    return "".join(c if c.isprintable() else "?" for c in text)[:_MOST_SHOWN]


def _name(user: int) -> str:
    with suppress(KeyError):
        return f"the user {pwd.getpwuid(user).pw_name}"
    return f"the user number {user}"
