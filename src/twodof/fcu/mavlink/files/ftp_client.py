"""What the FTP server keeps of one client: its sessions, its burst, its last request with the answer."""

from collections import deque
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field

from twodof.fcu.command.result import Source
from twodof.fcu.mavlink.files.file_tree import OpenFile
from twodof.link.mavlink.ftp import FtpError, FtpPacket

MOST_SESSIONS = 4
"""Sessions of one client; a fifth closes the one that was opened first, but no upload."""
MOST_WAITING = 16
"""Requests of one client that wait; what comes beyond is for it to ask again."""
BURST_BYTES = 35_000
"""Most that answers one burst request, as in PX4."""


@dataclass(slots=True)
class FtpSession:
    """A file being read, or an upload to `path` that waits in memory; `used`, by the clock, when it last was.

    `failed`: a write was refused, so what is here is not what was to be sent.
    """

    file: OpenFile | None
    path: str = ""
    used: float = 0.0
    upload: bytearray = field(default_factory=bytearray)
    failed: bool = False


def burst_packets(request: FtpPacket, data: bytes, most: int, ends: bool) -> Iterator[FtpPacket]:
    """The answer to a burst request: `data` in packets of `most` bytes, then, if the file `ends` there, its end.

    Each is made when it is sent: a client may ask for 35,000 packets of one byte, which takes many control periods.
    """
    places = range(0, len(data), most)
    for number, at in enumerate(places):
        last = not ends and at + most >= len(data)
        yield request.part(number, request.offset + at, data[at : at + most], last)
    if ends or not data:
        sequence = (request.sequence + 1 + len(places)) & 0xFFFF
        yield request.nak(FtpError.END)._replace(sequence=sequence, offset=request.offset + len(data))


@dataclass(slots=True)
class FtpClient:
    """A client of the server, at `peer`. What it asks while it is `busy` waits: requests are carried out in order.

    `burst` is what is still to be sent of a burst from the session `burst_session`, None: there is none.
    """

    peer: Hashable
    source: Source
    sessions: dict[int, FtpSession] = field(default_factory=dict)
    burst: Iterator[FtpPacket] | None = None
    burst_session: int = 0
    request: FtpPacket | None = None
    answer: FtpPacket | None = None
    busy: bool = False
    waiting: deque[FtpPacket] = field(default_factory=deque)

    def open(self, session: FtpSession, wanted: int, close: Callable[[OpenFile], None]) -> int | None:
        """Opens a session, with the number `wanted` if that is free; None if only uploads are open already."""
        if len(self.sessions) >= MOST_SESSIONS:
            for number, oldest in self.sessions.items():
                if oldest.file is not None:
                    close(oldest.file)
                    del self.sessions[number]
                    break
            else:
                return None
        number = wanted if wanted not in self.sessions else min({*range(256)} - self.sessions.keys())
        self.sessions[number] = session
        return number
