"""Identity of a client: a MAVLink system id of its own, and the time stamps of that id for signing.

Two clients with the same ids share a lease: if one leaves, the other's drone is disarmed in flight. So each client
draws an id that no other client on this computer has, and draws again if a client elsewhere has it.
"""

from __future__ import annotations

import secrets
import socket
import sys
from collections.abc import Collection
from pathlib import Path

from twodof.errors import LinkError
from twodof.link.signing import Key, Signing, Stamps, read_key

OWN_SYSTEMS = (*range(200, 241), 242, 243, 244)
"""Ids to draw from, without discovery's (241), MAVSDK's (245), `twodof flash`'s (252) and QGroundControl's (255)."""

_MOST_TRIES = 8


_claims: dict[int, socket.socket] = {}


def drawn(besides: Collection[int] = ()) -> int:
    """Draw a system id that is not in `besides`; no other client on this computer gets it until `give_back`.

    If all are taken, and on systems other than Linux, another client may have the same id.
    """
    order: list[int] = [system for system in OWN_SYSTEMS if system not in besides]
    secrets.SystemRandom().shuffle(order)
    return next((system for system in order if _claim(system)), order[0])


def give_back(system: int) -> None:
    """Let other clients draw this id; an id that was not drawn here is left alone."""
    claim = _claims.pop(system, None)
    if claim is not None:
        claim.close()


def _claim(system: int) -> bool:
    """Claim an id on this computer; return False if it is taken. Linux frees the name when the process ends."""
    if not sys.platform.startswith("linux"):
        return False
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0twodof-client-{system}")
    except OSError:
        claim.close()
        return False
    _claims[system] = claim
    return True


def identity(system: int | None, on_board: bool, key: Key | str | Path | None) -> tuple[int, Signing | None]:
    """Return a client's system id and its signing; id 0 stands for the drone's own, which is not known yet.

    With a key's file, an id is preferred that has time stamps beside it and is free. Raises LinkError.
    """
    if system is not None or on_board or key is None or isinstance(key, Key):
        number = (0 if on_board else drawn()) if system is None else system
        return number, _signing(key, number)
    read = read_key(key)
    order = sorted(OWN_SYSTEMS, key=lambda number: (not _stamps(key, number).exists(), secrets.randbits(32)))
    for number in order[:_MOST_TRIES]:
        try:
            return number, Signing(read, Stamps(_stamps(key, number)))
        except LinkError as error:  # another process has it
            last = error
    raise last


def _signing(key: Key | str | Path | None, system: int) -> Signing | None:
    """Return the signing with a key; time stamps are beside the key's file, one file for each system id."""
    if key is None:
        return None
    if isinstance(key, Key):
        return Signing(key, Stamps(None))
    return Signing(read_key(key), Stamps(_stamps(key, system)))


def _stamps(key: str | Path, system: int) -> Path:
    return Path(f"{key}.{system}.stamps")
