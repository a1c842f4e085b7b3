"""The links of a server: what it prints once, with the tokens in them."""

from __future__ import annotations

import secrets
import socket
from typing import NamedTuple

from twodof.lab.settings import LabSettings, is_loopback

_ANYWHERE = ("0.0.0.0", "::")


class Tokens(NamedTuple):
    """What lets a client command, and what lets one watch; "" where there is none."""

    command: str
    watch: str


def drawn_tokens(host: str, command: str = "", watch: str = "", always: bool = False) -> Tokens:
    """The tokens of a server at `host`: one to watch, and where it is needed, or `always`, one to command.

    Those that are not given are drawn anew; they are stored nowhere.
    """
    needed = secrets.token_urlsafe(24) if always or not is_loopback(host) else ""
    return Tokens(command or needed, watch or secrets.token_urlsafe(24))


def links(settings: LabSettings, port: int) -> dict[str, str]:
    """The links of a server that listens at `port`: to command, and to watch only. They hold the tokens."""
    host = socket.gethostname() if settings.host in _ANYWHERE else settings.host
    base = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
    command = f"?token={settings.command_token}" if settings.command_token else ""
    return {"command": base + command, "watch": f"{base}?token={settings.watch_token}" if settings.watch_token else ""}


def who_gets_in(settings: LabSettings) -> str:
    """What who starts a server is to know of its links, a line; "" where they guard nothing."""
    if not settings.needs_token:
        return ""
    over = " It goes over the network as plain text." if settings.reached else ""
    return f"Nobody gets in without a link. Whoever has the first one flies the drones.{over}\n"
