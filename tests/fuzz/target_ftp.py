"""MAVLink FTP: every request, however odd, is answered once, and no file outside the tree is touched."""

import struct
import tempfile
from functools import cache
from pathlib import Path

from tests.fcu.mavlink.test_ftp import Server
from tests.fuzz.target import Target
from twodof.link.mavlink.ftp import FtpOperation, read_packet


@cache
def server() -> Server:
    """Server for all inputs, without sessions at the start of each."""
    made = Server(Path(tempfile.mkdtemp(prefix="twodof-fuzz-")))
    made.made = {"all.bin": bytes(600)}  # a burst of single bytes is short, too
    return made


def packet(op: int, data: bytes = b"", session: int = 0, offset: int = 0) -> bytes:
    """An input's piece: its length, then a payload."""
    made = struct.pack("<HBBBBBxI", op, session, op, len(data), 0, 0, offset) + data
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
    there, at = server(), 0
    while at < len(data):
        payload = data[at + 1 : at + 1 + data[at]][:251]
        at += 1 + data[at]
        there.now += 0.1
        answers = there.raw(payload, peer="stranger")
        while there.ftp.send_bursts():
            pass
        answers += there.answers()
        assert all(answer.op in (FtpOperation.ACK, FtpOperation.NAK) for answer in answers)
        match read_packet(payload.ljust(251, b"\0")).op:
            case FtpOperation.ACK | FtpOperation.NAK:
                assert answers == []
            case FtpOperation.BURST:
                assert answers
            case _:
                assert len(answers) == 1
    there.ftp.gone("stranger")
    assert there.ftp.sessions == 0
    assert there.one(FtpOperation.NONE).op == FtpOperation.ACK
    assert {path.name for path in there.controllers.parents[1].iterdir()} <= {"log", "state"}


TARGET = Target("ftp", seeds, attempt, 1000)
