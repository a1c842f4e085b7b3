"""Where a request comes from: our own page or a program, not a page of somebody else's.

A page of another site can have its reader's browser send requests to this computer. It cannot forge `Origin`. With a
name of its own that it lets point to this computer (DNS rebinding) it would be its own origin; it cannot forge `Host`.
"""

from __future__ import annotations

import ipaddress
import socket
from functools import lru_cache
from urllib.parse import urlsplit

from twodof.lab.settings import LabSettings


def host_is_ours(host: str, settings: LabSettings) -> bool:
    """Whether `Host` names this server: by a number or a name that nobody else lets point here.

    On the loopback that is a number of the loopback or `localhost`; else any number, or this computer's own name.
    """
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return False
    if name == "localhost":
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return settings.reached and name in {*_own_names(), settings.host.lower()}
    return settings.reached or address.is_loopback


def origin_is_ours(origin: str | None, host: str) -> bool:
    """Whether a request comes from our own page: its `Origin` is its `Host`. A program sends none."""
    if origin is None:
        return True
    try:
        found = urlsplit(origin)
    except ValueError:
        return False
    return found.scheme in ("http", "https") and bool(host) and found.netloc.lower() == host.lower()


@lru_cache(maxsize=1)
def _own_names() -> frozenset[str]:
    name = socket.gethostname().lower()
    return frozenset({name, f"{name}.local"} - {""})
