"""LabSettings: where the server listens, what it connects to, where it keeps what it keeps, who may come in."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass, field
from pathlib import Path

from twodof.errors import LinkError

PAGE = Path(__file__).parent / "page"
"""Where the build of `web/` puts the page."""
LOOPBACK = "127.0.0.1"
PORT = 8080
COMMAND_TOKEN, WATCH_TOKEN = "TWODOF_LAB_COMMAND_TOKEN", "TWODOF_LAB_WATCH_TOKEN"
"""Variables of the environment with tokens that outlive the server's program; without them they are drawn."""


@dataclass(frozen=True)
class LabSettings:
    """Settings of one server.

    `folder` is the user's data folder. `connect` are the URLs of drones; none: those of this computer, as they come.
    `key` signs what is sent to them. A client that gives `command_token` may do everything, one with `watch_token`
    may only look. On the loopback a client without a token may do everything too, unless `token_always`; elsewhere it
    is refused. Port 0 is a free one. The logs in the folders `logs` are shown too, and only read. Raises LinkError
    where it would listen to a network without a token.
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

    def __post_init__(self) -> None:
        if self.needs_token and not self.command_token:
            what = "reaches further than this user: a server there needs a token"
            raise LinkError(what, self.host, "start it by `twodof lab --host` or `twodof up --host`, which make one")

    @property
    def needs_token(self) -> bool:
        """Whether clients without a token are refused: others can reach the server, or it is asked for."""
        return self.token_always or self.reached

    @property
    def reached(self) -> bool:
        """Whether other computers can reach it."""
        return not is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches a server that listens at `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
