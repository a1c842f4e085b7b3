"""MAVLink FTP: every request, however odd, is answered or passed over, and no file outside the tree is touched."""

import struct
import tempfile
from functools import cache
from pathlib import Path

from tests.fcu.mavlink.test_ftp import Server
from tests.fuzz.target import Target
from twodof.link.mavlink.ftp import FtpOperation, read_packet

PACKET = 12


@cache
def server() -> Server:
    """Server for all inputs, without sessions at the start of each."""
    return Server(Path(tempfile.mkdtemp(prefix="twodof-fuzz-")))


def packet(op: int, data: bytes = b"", session: int = 0, offset: int = 0) -> bytes:
    """An input's piece: its length, then a payload."""
    made = struct.pack("<HBBBBBxI", 1, session, op, len(data), 0, 0, offset) + data
    return bytes([len(made)]) + made


def seeds() -> list[bytes]:
    """A session that reads, one that writes, one that asks for what is not there."""
    read = (
        packet(FtpOperation.LIST, b"/etc/extras")
        + packet(FtpOperation.OPEN_RO, b"/etc/extras/all.bin")
        + packet(FtpOperation.READ, b"", 0, 9)
    )
    write = (
        packet(FtpOperation.CREATE, b"/controllers/a.json")
        + packet(FtpOperation.WRITE, b"{}")
        + packet(FtpOperation.TERMINATE)
    )
    return [
        read + packet(FtpOperation.BURST, b"\x50") + packet(FtpOperation.TERMINATE),
        write,
        packet(FtpOperation.REMOVE, b"/../etc/passwd"),
    ]


def attempt(data: bytes) -> None:
    """The packets one after the other."""
    there = server()
    there.raw(struct.pack("<HBBBBBxI", 0, 0, FtpOperation.RESET, 0, 0, 0, 0))
    at = 0
    while at < len(data):
        payload = data[at + 1 : at + 1 + data[at]]
        at += 1 + data[at]
        read_packet(payload.ljust(251, b"\0"))
        there.now += 0.1
        for answer in there.raw(payload[:251]):
            assert answer.op in (FtpOperation.ACK, FtpOperation.NAK)
    assert {path.name for path in there.controllers.parents[1].iterdir()} <= {"log", "state"}


TARGET = Target("ftp", seeds, attempt, 1000)
