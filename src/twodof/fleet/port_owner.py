"""Who has a port of this machine: the process to end, or whose owner to ask. Only Linux tells (/proc)."""

from __future__ import annotations

import pwd
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

from twodof.errors import LinkError
from twodof.link.transport.url import parse

_PROC = Path("/proc")
_TABLES = MappingProxyType({"TCP": ("tcp", "tcp6"), "UDP": ("udp", "udp6")})
_CHILD = "twodof.fleet.child"
_LISTENING = "0A"
_PORT, _STATE, _USER, _INODE = 1, 3, 7, 9  # columns of /proc/net/tcp; the first is that of the local address
_MOST_SHOWN = 100


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


def _process(socket: str) -> str:
    """The process that holds a socket, "" if it is not one that we may see."""
    wanted = Path(socket)
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
