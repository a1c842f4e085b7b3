"""Addresses of links, as URLs: the forms that MAVSDK's and MAVProxy's users know."""

import re
import termios
from dataclasses import dataclass, replace
from enum import IntEnum
from urllib.parse import SplitResult, parse_qsl, urlsplit

from twodof.errors import LinkError, shown


class Ports(IntEnum):
    """Ports of drone 0, as PX4 in simulation has them; drone i has the i-th after each, except at GROUND_STATION.

    The UDP ports are those of PX4 v1.16 (ROMFS/px4fmu_common/init.d-posix/px4-rc.mavlink). Ground programs look for a
    simulated drone at TCP 5760, the port of ArduPilot. The flight controller's port is our own.
    """

    ONBOARD = 14540
    """UDP: the companion sends to it, for clients on board and for MAVSDK."""
    GROUND_STATION = 14550
    """UDP: the companions of all drones send to it; QGroundControl listens there."""
    COMPANION_ONBOARD = 14580
    """UDP: the companion sends from it and listens there, for clients on board."""
    COMPANION_GROUND = 18570
    """UDP: the companion sends from it and listens there, for ground stations."""
    COMPANION_TCP = 5760
    """TCP: the companion listens there."""
    FLIGHT_CONTROLLER = 5790
    """TCP: the flight controller listens there, for its companion."""


FORMS = (
    "udp://HOST:PORT or udp://:PORT (listens), udpin://HOST:PORT, udp://HOST:PORT?bind=[HOST:]PORT, "
    "udpbcast://HOST:PORT, tcp://HOST:PORT, tcpin://HOST:PORT, serial:///dev/NAME?baud=N, mem://NAME, memin://NAME"
)
LOOPBACK = "127.0.0.1"
ANY = ("0.0.0.0", "::")
HERE = ("127.0.0.1", "localhost", "::1")
DEFAULT_BAUD = 921_600
LONGEST_URL = 1000
_ALIASES = {"udpout": "udp", "tcpout": "tcp"}
_NETWORK = ("udp", "udpin", "udpbcast", "tcp", "tcpin")
_SHORT = re.compile(r"(udp|udpin|udpout|udpbcast|tcp|tcpin):([^/].*)?")
_BARE = re.compile(
    r"(?!(?:udp|udpin|udpout|udpbcast|tcp|tcpin|mem|memin|serial):)([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:]+\])(:\d{1,5})?"
)
_MEMORY_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
BAUDS = {int(name[1:]): int(getattr(termios, name)) for name in dir(termios) if re.fullmatch(r"B[1-9]\d*", name)}


@dataclass(frozen=True)
class Address:
    """Address of a link: `kind` is udp, udpin, udpbcast, tcp, tcpin, serial, mem or memin; `name` is a host or device.

    `bind_name` and `bind_port` say where a udp or udpbcast link listens too; "" if it does not.
    """

    kind: str
    name: str
    port: int = 0
    baud: int = 0
    bind_name: str = ""
    bind_port: int = 0

    @property
    def listens(self) -> bool:
        """True if other sides connect to it."""
        return self.kind.endswith("in")

    def at(self, port: int) -> "Address":
        """Return the address with the port that the system chose where it listens."""
        if self.bind_name:
            return replace(self, bind_port=port)
        return replace(self, port=port) if self.listens else self

    def __str__(self) -> str:
        if self.kind == "serial":
            return f"serial://{self.name}?baud={self.baud}"
        if self.kind not in _NETWORK:
            return f"{self.kind}://{self.name}"
        bound = f"?bind={_bracketed(self.bind_name)}:{self.bind_port}" if self.bind_name else ""
        return f"{self.kind}://{_bracketed(self.name)}:{self.port}{bound}"


def parse(url: str) -> Address:
    """Return the address that a URL names.

    A listening form without a host listens on this machine only; `udpin://0.0.0.0:14550` listens on every interface.
    MAVProxy's short forms `udpin:HOST:PORT`, `udp:HOST:PORT` (listens, as there), `udpout:HOST:PORT`, `tcp:HOST:PORT`
    and `/dev/NAME,BAUD` are accepted too. `udp://HOST:PORT?bind=[HOST:]PORT` always sends to the first address and
    listens at the second. Raises LinkError for any other text.
    """
    if not isinstance(url, str) or len(url) > LONGEST_URL or not url.isprintable():
        raise LinkError(f"{shown(url)} is not a URL", "", f"use {FORMS}")
    if bare := _BARE.fullmatch(url):
        udp, tcp = (url if bare[2] else f"{url}:{port}" for port in (Ports.COMPANION_ONBOARD, Ports.COMPANION_TCP))
        raise LinkError("has no kind of link before its host", url, f"did you mean udp://{udp}, or tcp://{tcp}?")
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
        return _serial(url, parts)
    listens_too = kind in ("udp", "udpbcast") and bool(parts.query and parts.hostname)
    if parts.fragment or parts.path.strip("/") or parts.username is not None or (parts.query and not listens_too):
        raise LinkError("has parts that this kind of link does not take", url, f"use {FORMS}")
    bind_name, bind_port = _bound(url, parts.query, parts.hostname or "") if listens_too else ("", 0)
    if kind in ("mem", "memin"):
        if not _MEMORY_NAME.fullmatch(parts.netloc):
            raise LinkError("has no name of letters, digits, '_', '.', '-'", url, "write one such as mem://drone-1")
        return Address(kind, parts.netloc)
    if kind not in _NETWORK:
        raise LinkError(f"{shown(parts.scheme)} is not a kind of link", url, f"use {FORMS}")
    host = parts.hostname or ""
    if kind in ("udp", "tcp") and not host:
        kind += "in"
    if kind == "udpbcast" and not host:
        remedy = "write udpbcast://255.255.255.255:14550, or the broadcast address of your network"
        raise LinkError("has no host", url, remedy)
    if port is None or (port == 0 and not kind.endswith("in")):
        usual = {"udp": Ports.COMPANION_ONBOARD, "tcp": Ports.COMPANION_TCP}.get(kind, Ports.GROUND_STATION)
        raise LinkError("has no port", url, f"write {kind}://{host or LOOPBACK}:{usual}")
    if kind in ("udp", "udpbcast", "tcp") and host in ANY:
        what = f"{host} is not a host to send to"
        raise LinkError(what, url, f"to listen on every interface write {kind}in://{host}:{port}")
    return Address(kind, host or LOOPBACK, port, bind_name=bind_name, bind_port=bind_port)


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _options(url: str, query: str) -> list[tuple[str, str]]:
    try:
        return parse_qsl(query, keep_blank_values=True, max_num_fields=4)
    except ValueError as error:
        raise LinkError("has more options than any link takes", url, f"use {FORMS}") from error


def _bound(url: str, query: str, host: str) -> tuple[str, int]:
    """Return where `?bind=` listens; without a host on this machine only, as every listening form."""
    options = _options(url, query)
    if [name for name, _ in options] != ["bind"]:
        raise LinkError("has parts that this kind of link does not take", url, f"use {FORMS}")
    text = options[0][1]
    try:
        parts = urlsplit(f"//{text}" if ":" in text else f"//:{text}")
        port = parts.port
    except ValueError as error:
        raise LinkError(str(error), url, "write ?bind=PORT or ?bind=HOST:PORT") from error
    if port is None or parts.path or parts.query or parts.fragment or parts.username is not None:
        raise LinkError(f"{shown(text)} is not a place to listen at", url, "write ?bind=PORT or ?bind=HOST:PORT")
    if not parts.hostname and host not in HERE:
        what = f"listens on this machine only and cannot send to {host}"
        raise LinkError(what, url, f"to listen on every interface write ?bind=0.0.0.0:{port}")
    return parts.hostname or ("::1" if ":" in host else LOOPBACK), port


def _serial(url: str, parts: SplitResult) -> Address:
    """Return the address of a serial line; `?baud=` decides, or MAVSDK's `:BAUD` at the end of the path."""
    device, options = parts.path, dict(_options(url, parts.query))
    path, colon, tail = device.rpartition(":")
    if colon and tail.isdecimal() and "baud" not in options:
        device, options["baud"] = path, tail
    text = options.pop("baud", str(DEFAULT_BAUD))
    if parts.netloc or parts.fragment or not device.startswith("/") or len(device) < 2 or options:
        raise LinkError("is not a serial line", url, "write serial:///dev/ttyACM0?baud=921600")
    if not (text.isascii() and text.isdecimal() and len(text) <= 9 and int(text) in BAUDS):
        some = ", ".join(str(baud) for baud in sorted(BAUDS) if baud >= 9600)
        raise LinkError(f"baud {shown(text)} is not one that this machine sets", url, f"use one of {some}")
    return Address("serial", device, baud=int(text))
