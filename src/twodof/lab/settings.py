"""Settings of a server, its tokens, and the links that it prints."""

import ipaddress
import secrets
import socket
from dataclasses import dataclass, field
from pathlib import Path

from twodof.errors import LinkError

PAGE = Path(__file__).parent / "page"
"""Folder into which the build of `web/` writes the page."""
LOOPBACK = "127.0.0.1"
PORT = 8080
COMMAND_TOKEN, WATCH_TOKEN = "TWODOF_LAB_COMMAND_TOKEN", "TWODOF_LAB_WATCH_TOKEN"
"""Environment variables with lasting tokens; without them tokens are drawn at each start."""


@dataclass(frozen=True)
class LabSettings:
    """Settings of one server.

    `folder` is the user's data folder. `connect` are the URLs of drones, by default of those on this computer; `key`
    signs messages to them. A client with `command_token` may do everything, one with `watch_token` may only look. On
    the loopback a client without a token may do everything, unless `token_always`; elsewhere it is refused. Port 0
    stands for a free port. Logs in the folders `logs` are shown but never changed. `warm_up` compiles the virtual rig
    for previews at the start. Raises LinkError if other computers can reach the server and there is no `command_token`.
    """

    folder: Path
    host: str = LOOPBACK
    port: int = PORT
    connect: tuple[str, ...] = ()
    key: Path | None = None
    command_token: str = field(default="", repr=False)
    watch_token: str = field(default="", repr=False)
    page: Path = PAGE
    logs: tuple[Path, ...] = ()
    token_always: bool = False
    warm_up: bool = False

    def __post_init__(self) -> None:
        if self.needs_token and not self.command_token:
            what = "others can reach this server: it needs a token"
            raise LinkError(what, self.host, "start it by `twodof lab --host` or `twodof up --host`, which make one")

    @property
    def needs_token(self) -> bool:
        """True if clients without a token are refused."""
        return self.token_always or self.reached

    @property
    def reached(self) -> bool:
        """True if other computers can reach the server."""
        return not is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Return True if only this computer reaches a server at `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def drawn_tokens(host: str, command: str = "", watch: str = "", always: bool = False) -> tuple[str, str]:
    """Return a server's tokens: one to watch and, if `host` needs it or `always`, one to command.

    Tokens that are not given are drawn at random and stored nowhere.
    """
    needed = secrets.token_urlsafe(24) if always or not is_loopback(host) else ""
    return command or needed, watch or secrets.token_urlsafe(24)


def links(settings: LabSettings, port: int) -> dict[str, str]:
    """Return the links of a server at `port`, to command and to watch, with their tokens."""
    host = socket.gethostname() if settings.host in ("0.0.0.0", "::") else settings.host
    base = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
    command = f"?token={settings.command_token}" if settings.command_token else ""
    return {"command": base + command, "watch": f"{base}?token={settings.watch_token}" if settings.watch_token else ""}


def link_warning(settings: LabSettings) -> str:
    """Return a warning about the links for the user who starts a server; "" without tokens."""
    if not settings.needs_token:
        return ""
    over = " It goes over the network as plain text." if settings.reached else ""
    return f"Nobody gets in without a link. Whoever has the first one flies the drones.{over}\n"
