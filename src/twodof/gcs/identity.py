"""What a client calls itself: a MAVLink system id of its own, and the time stamps that go with it where it signs.

Who has the same ids has the same lease: one's leaving would disarm the other's drone in flight. So each client draws
its own, which no other on this computer has, and draws again where somebody elsewhere has that one.
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
"""Ids that are drawn from: not discovery's (241), MAVSDK's (245), `twodof flash`'s (252), QGroundControl's (255)."""

_MOST_TRIES = 8


_claims: dict[int, socket.socket] = {}


def drawn(besides: Collection[int] = ()) -> int:
    """A system id that is drawn, none of `besides`, ours on this computer until `give_back`.

    Where all are taken, and on systems other than Linux, one is drawn that another may have.
    """
    order: list[int] = [system for system in OWN_SYSTEMS if system not in besides]
    secrets.SystemRandom().shuffle(order)
    return next((system for system in order if _claim(system)), order[0])


def give_back(system: int) -> None:
    """Let others draw an id; one that was not drawn here is left alone."""
    claim = _claims.pop(system, None)
    if claim is not None:
        claim.close()


def _claim(system: int) -> bool:
    """Whether nobody on this computer has it. Linux frees such a name with its process, however that ends."""
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
    """The system id to take and what signs for it; id 0 for the drone's own, which is not known yet.

    With a key's file one is drawn that has time stamps there already and that no other process uses. Raises LinkError.
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
    """Signing with a key; a key's file has its time stamps beside it, for each system id its own."""
    if key is None:
        return None
    if isinstance(key, Key):
        return Signing(key, Stamps(None))
    return Signing(read_key(key), Stamps(_stamps(key, system)))


def _stamps(key: str | Path, system: int) -> Path:
    return Path(f"{key}.{system}.stamps")
