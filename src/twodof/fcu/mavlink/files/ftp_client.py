"""What the FTP server keeps of one client: its sessions, its burst, its last request with the answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterator

from twodof.fcu.command.result import Source
from twodof.fcu.mavlink.files.file_tree import OpenFile
from twodof.link.mavlink.ftp import FtpError, FtpPacket

MOST_SESSIONS = 4
"""Sessions of one client; a fifth closes the one that was opened first, but no upload."""
MOST_WAITING = 16
"""Requests of one client that wait; what comes beyond is for it to ask again."""
BURST_BYTES = 35_000
"""Most that answers one burst request, as in PX4."""


class FtpSession:
    """A file being read, or an upload to `path` that waits in memory; `used`, by the clock, when it last was."""

    __slots__ = ("failed", "file", "path", "upload", "used")

    def __init__(self, file: OpenFile | None, path: str = "", used: float = 0.0) -> None:
        self.file = file
        self.path = path
        self.used = used
        self.upload = bytearray()
        self.failed = False  # a write was refused: what is here is not what was to be sent


class Burst:
    """The answer to a burst request: `data` in packets of `most` bytes, then, if the file `ends` there, its end."""

    def __init__(self, asked: FtpPacket, data: bytes, most: int, ends: bool) -> None:
        self.asked = asked
        self.done = False
        self._data, self._most, self._ends = data, most, ends
        self._at = self._number = 0

    def next(self, count: int) -> Iterator[FtpPacket]:
        """The next packets, at most `count`."""
        for _ in range(count):
            if self.done:
                return
            part = self._data[self._at : self._at + self._most]
            if not part:
                self.done = True
                end = self.asked.nak(FtpError.END)
                yield end._replace(
                    sequence=(self.asked.sequence + 1 + self._number) & 0xFFFF,
                    offset=self.asked.offset + self._at,
                )
                return
            last = self._at + len(part) >= len(self._data) and not self._ends
            yield self.asked.part(self._number, self.asked.offset + self._at, part, last)
            self._at += len(part)
            self._number += 1
            self.done = last


class FtpClient:
    """A client of the server, at `peer`. What it asks while it is `busy` waits: requests are carried out in order."""

    __slots__ = ("answer", "asked", "burst", "busy", "peer", "sessions", "source", "waiting")

    def __init__(self, peer: Hashable, source: Source) -> None:
        self.peer = peer
        self.source = source
        self.sessions: dict[int, FtpSession] = {}
        self.burst: Burst | None = None
        self.asked: FtpPacket | None = None
        self.answer: FtpPacket | None = None
        self.busy = False
        self.waiting: deque[FtpPacket] = deque()

    def open(self, session: FtpSession, wanted: int, close: Callable[[OpenFile], None]) -> int | None:
        """Opens a session, with the number `wanted` if that is free; None if only uploads are open already."""
        if len(self.sessions) >= MOST_SESSIONS:
            oldest = next((number for number, one in self.sessions.items() if one.file is not None), None)
            if oldest is None:
                return None
            file = self.sessions.pop(oldest).file
            if file is not None:
                close(file)
        number = wanted if wanted not in self.sessions else min({*range(256)} - self.sessions.keys())
        self.sessions[number] = session
        return number
