"""Addresses of links, as URLs: the forms that MAVSDK's and MAVProxy's users know."""

import re
import termios
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

from twodof.errors import LinkError, shown

FORMS = (
    "udp://HOST:PORT or udp://:PORT (listens), udpin://HOST:PORT, tcp://HOST:PORT, tcpin://HOST:PORT, "
    "serial:///dev/NAME?baud=N, mem://NAME, memin://NAME"
)
LOOPBACK = "127.0.0.1"
ANY = ("0.0.0.0", "::")
DEFAULT_BAUD = 921_600
LONGEST_URL = 1000
_ALIASES = {"udpout": "udp", "tcpout": "tcp"}
_NETWORK = ("udp", "udpin", "tcp", "tcpin")
_SHORT = re.compile(r"(udp|udpin|udpout|tcp|tcpin):([^/].*)?")
_MEMORY_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
BAUDS = {int(name[1:]): int(getattr(termios, name)) for name in dir(termios) if re.fullmatch(r"B[1-9]\d*", name)}


@dataclass(frozen=True)
class Address:
    """Where a link leads: `kind` is udp, udpin, tcp, tcpin, serial, mem or memin; `name` a host, device or name."""

    kind: str
    name: str
    port: int = 0
    baud: int = 0

    @property
    def listens(self) -> bool:
        """Whether others come to it."""
        return self.kind.endswith("in")

    def __str__(self) -> str:
        if self.kind == "serial":
            return f"serial://{self.name}?baud={self.baud}"
        host = f"[{self.name}]" if ":" in self.name else self.name
        return f"{self.kind}://{host}:{self.port}" if self.kind in _NETWORK else f"{self.kind}://{self.name}"


def parse(url: str) -> Address:
    """The address that a URL names.

    A listening form without a host listens on this machine only; `udpin://0.0.0.0:14550` listens on every interface.
    MAVProxy's short forms `udpin:HOST:PORT`, `udp:HOST:PORT` (listens, as there), `udpout:HOST:PORT`, `tcp:HOST:PORT`
    and `/dev/NAME,BAUD` are taken too. Raises LinkError for anything else.
    """
    if not isinstance(url, str) or len(url) > LONGEST_URL or not url.isprintable():
        raise LinkError(f"{shown(url)} is no URL", "", f"use {FORMS}")
    short = _SHORT.fullmatch(url)
    if short:
        url = f"{'udpin' if short[1] == 'udp' else short[1]}://{short[2] or ''}"
    elif url.startswith("/dev/"):
        device, _, baud = url.partition(",")
        url = f"serial://{device}" + (f"?baud={baud}" if baud else "")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise LinkError(str(error), url, f"use {FORMS}") from error
    kind = _ALIASES.get(parts.scheme, parts.scheme)
    if kind == "serial":
        return _serial(url, parts.netloc, parts.path, parts.query)
    if parts.query or parts.fragment or parts.path.strip("/") or parts.username is not None:
        raise LinkError("has parts that this kind of link does not take", url, f"use {FORMS}")
    if kind in ("mem", "memin"):
        if not _MEMORY_NAME.fullmatch(parts.netloc):
            raise LinkError("has no name of letters, digits, '_', '.', '-'", url, "such as mem://drone-1")
        return Address(kind, parts.netloc)
    if kind not in _NETWORK:
        raise LinkError(f"{shown(parts.scheme)} is no kind of link", url, f"use {FORMS}")
    host = parts.hostname or ""
    if kind in ("udp", "tcp") and not host:
        kind += "in"
    if port is None or (port == 0 and not kind.endswith("in")):
        raise LinkError("has no port", url, f"write {kind}://{host or LOOPBACK}:14550")
    if kind in ("udp", "tcp") and host in ANY:
        raise LinkError(
            f"{host} is no host to send to", url, f"to listen on every interface write {kind}in://{host}:{port}"
        )
    return Address(kind, host or LOOPBACK, port)


def _serial(url: str, host: str, device: str, query: str) -> Address:
    """A serial line's address; `?baud=` decides, or MAVSDK's `:BAUD` at the end of the path."""
    options = dict(parse_qsl(query, keep_blank_values=True, max_num_fields=4))
    path, colon, tail = device.rpartition(":")
    if colon and tail.isdecimal():
        device = path
        options.setdefault("baud", tail)
    text = options.pop("baud", str(DEFAULT_BAUD))
    if host or len(device) < 2 or options:
        raise LinkError("is no serial line", url, "write serial:///dev/ttyACM0?baud=921600")
    if not (text.isascii() and text.isdecimal() and len(text) <= 9 and int(text) in BAUDS):
        some = ", ".join(str(baud) for baud in sorted(BAUDS) if baud >= 9600)
        raise LinkError(f"baud {shown(text)} is none that this machine sets", url, f"use one of {some}")
    return Address("serial", device, baud=int(text))
