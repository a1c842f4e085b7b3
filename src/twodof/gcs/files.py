"""Files on board, read and written by MAVLink FTP, and the download of logs."""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from twodof.errors import LinkLost, LogError, Rejected
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.gcs.drone_state import StatusTexts
from twodof.gcs.session import Deadline, DroneSession
from twodof.link.mavlink.ftp import MOST_DATA, FtpError, FtpOperation, FtpPacket, packed, read_packet
from twodof.link.mavlink.messages import message

LARGEST = 1 << 29
"""Size of the largest file that is read [bytes]."""
MOST_ENTRIES = 10_000
"""Most entries of a folder that are listed."""


class FileEntry(NamedTuple):
    """File of `size` bytes, or a folder of size 0."""

    name: str
    size: int
    folder: bool


class AsyncFiles:
    """Files of one drone; every call raises Rejected with the drone's reason, LinkLost and Timeout."""

    def __init__(self, session: DroneSession, texts: StatusTexts) -> None:
        self._session = session
        self._texts = texts
        self._sequence = 0

    async def write(
        self, path: str, content: bytes, timeout: float = 60.0, sent: Callable[[float], None] | None = None
    ) -> None:
        """Write the file `path`, whole or not at all; `sent` is called with the share that has arrived.

        A call that is cancelled before the share is 1 leaves the file as it was.
        """
        deadline = self._session.deadline(timeout, f"sending {path}")
        number = (await self._ask(FtpOperation.CREATE, deadline, data=path.encode())).session
        with self._ending(number):
            for start in range(0, len(content), MOST_DATA):
                piece = content[start : start + MOST_DATA]
                await self._ask(FtpOperation.WRITE, deadline, number, start, piece)
                if sent is not None:
                    sent(min(1.0, (start + MOST_DATA) / len(content)))
        await self._ask(FtpOperation.TERMINATE, deadline, number)

    async def read(self, path: str, timeout: float = 60.0) -> bytes:
        """Return the content of the file `path`."""
        deadline = self._session.deadline(timeout, f"reading {path}")
        opened = await self._ask(FtpOperation.OPEN_RO, deadline, data=path.encode())
        (size,) = struct.unpack("<I", opened.data[:4])
        content = bytearray()
        with self._ending(opened.session):
            if size > LARGEST:
                what = f"{path} has {size} bytes"
                raise Rejected(what, deadline.where, f"at most {LARGEST} bytes are read")
            while len(content) < size:
                part = await self._ask(FtpOperation.READ, deadline, opened.session, len(content), wanted=MOST_DATA)
                if not part.size:
                    break
                content += part.data[: part.size]
        await self._ask(FtpOperation.TERMINATE, deadline, opened.session)
        return bytes(content)

    async def list(self, path: str = "/", timeout: float = 10.0) -> list[FileEntry]:
        """Return the entries of the folder `path`."""
        deadline = self._session.deadline(timeout, f"listing {path}")
        found: list[FileEntry] = []
        places = 0
        while places < MOST_ENTRIES:
            try:
                part = await self._ask(FtpOperation.LIST, deadline, offset=places, data=path.encode())
            except Rejected as refusal:
                if refusal.what == _words(FtpError.END):
                    break
                raise
            rows = part.data[: part.size].rstrip(b"\0").split(b"\0")
            found += [entry for row in rows if (entry := _entry(row)) is not None]
            places += len(rows)
        return found

    async def remove(self, path: str, timeout: float = 5.0) -> None:
        """Delete the file `path`."""
        await self._ask(FtpOperation.REMOVE, self._session.deadline(timeout, f"removing {path}"), data=path.encode())

    async def _ask(
        self,
        op: FtpOperation,
        deadline: Deadline,
        number: int = 0,
        offset: int = 0,
        data: bytes = b"",
        wanted: int | None = None,
    ) -> FtpPacket:
        session, spoken = self._session, self._texts.count
        sequence = self._sequence
        question = self._question(op, number, offset, data, len(data) if wanted is None else wanted)

        def answer(got: Any) -> FtpPacket | None:
            found = read_packet(bytes(got.payload))
            fits = found.asked == op and found.sequence == (sequence + 1) & 0xFFFF
            return found if fits and found.op in (FtpOperation.ACK, FtpOperation.NAK) else None

        found = await session.ask(question, ("FILE_TRANSFER_PROTOCOL",), answer, deadline)
        if found.op == FtpOperation.ACK:
            return found
        code = found.data[0] if found.size else 0
        said = "; ".join(line.text for line in self._texts.reasons_since(spoken)[-3:])
        if code == FtpError.END:
            said = ""  # the end of a folder is no refusal
        raise Rejected(said or _words(code), f"{deadline.where}, {deadline.doing}", "read the drone's messages")

    @contextmanager
    def _ending(self, number: int) -> Iterator[None]:
        """End the drone's FTP session, without waiting, if the block raises: PX4 has only one session."""
        try:
            yield
        except BaseException:
            with suppress(LinkLost):
                self._session.send(self._question(FtpOperation.TERMINATE, number, 0, b"", 0))
            raise

    def _question(self, op: FtpOperation, number: int, offset: int, data: bytes, size: int) -> Any:
        sequence, self._sequence = self._sequence, (self._sequence + 2) & 0xFFFF
        packet = FtpPacket(sequence, number, op, size, 0, 0, offset, data)
        return packed(packet, self._session.system, self._session.component)


def _words(code: int) -> str:
    return FtpError(code).name.lower().replace("_", " ") if code in [*FtpError] else f"error {code}"


def _entry(row: bytes) -> FileEntry | None:
    """Return the entry of a listing's row, "F name TAB size" or "D name"; None for one to be skipped."""
    text = row.decode("utf-8", "replace")
    kind, (name, _, size) = text[:1], text[1:].partition("\t")
    if kind not in ("F", "D") or not name or name in (".", ".."):
        return None
    return FileEntry(name, int(size) if size.isdigit() else 0, kind == "D")


MOST_LOGS = 10_000
PIECE = 90
PIECES = 512
"""Pieces requested at once."""
LOG_RETRY_S = 0.5
STALLED_S = 5.0


class LogEntry(NamedTuple):
    """Log on board: its number, size [bytes], and start (seconds of UTC, 0 if unknown)."""

    number: int
    size: int
    time_utc: int


class AsyncLogs:
    """Logs on board of one drone."""

    def __init__(self, session: DroneSession) -> None:
        self._session = session

    async def list(self, timeout: float = 5.0) -> list[LogEntry]:
        """Return all logs on board, the oldest first. Raises LinkLost, Timeout."""
        deadline = self._session.deadline(timeout, "listing the logs on board")
        asked = message("LOG_REQUEST_LIST", start=0, end=0xFFFF, **self._session.target)
        found: dict[int, LogEntry] = {}

        def accept(got: Any) -> dict[int, LogEntry] | None:
            if got.num_logs:
                found[got.id] = LogEntry(got.id, got.size, got.time_utc)
            return found if len(found) >= min(got.num_logs, MOST_LOGS) else None

        await self._session.ask(asked, ("LOG_ENTRY",), accept, deadline, prolonged=True)
        return [found[number] for number in sorted(found)]

    async def download(
        self,
        entry: LogEntry,
        path: str | Path,
        timeout: float = 600.0,
        progress: Callable[[int, int], None] | None = None,
        overwrite: bool = False,
    ) -> Path:
        """Download a log into `path`, whole or not at all; `progress` is called with the bytes so far and of all.

        Raises LogError for an existing file and for a log that is empty or too large, Timeout if nothing comes for 5 s,
        LinkLost.
        """
        check_free(path, overwrite)
        where = f"{self._session.where}, log {entry.number}"
        if not 0 < entry.size <= LARGEST:
            raise LogError(f"{entry.size} bytes", where, f"1 to {LARGEST} bytes can be downloaded")
        data = await self._bytes(entry, Deadline(timeout, "downloading a log", where), progress)
        with atomic_write(path) as file:
            file.write(data)
        return Path(path)

    async def _bytes(self, entry: LogEntry, deadline: Deadline, progress: Callable[[int, int], None] | None) -> bytes:
        """Request PIECES at once from the first missing one on, and again if nothing more comes."""
        session, data = self._session, bytearray(entry.size)
        missing = set(range(0, entry.size, PIECE))
        try:
            with session.listen("LOG_DATA") as heard:
                stalled = Deadline(min(STALLED_S, deadline.left), deadline.doing, deadline.where)
                while missing:
                    first = min(missing)
                    wanted = {at for at in missing if at < first + PIECES * PIECE}
                    count = min(max(wanted) + PIECE, entry.size) - first
                    session.send(message("LOG_REQUEST_DATA", id=entry.number, ofs=first, count=count, **session.target))
                    while wanted and (got := await heard.next(min(stalled.end, session.now + LOG_RETRY_S))) is not None:
                        if (
                            got.id == entry.number
                            and got.ofs in wanted
                            and got.count == min(PIECE, entry.size - got.ofs)
                        ):
                            data[got.ofs : got.ofs + got.count] = bytes(got.data[: got.count])
                            wanted.discard(got.ofs)
                            missing.discard(got.ofs)
                            stalled = Deadline(min(STALLED_S, deadline.left), deadline.doing, deadline.where)
                        stalled.check()
                    stalled.check()
                    if progress is not None:
                        progress(entry.size - sum(min(PIECE, entry.size - at) for at in missing), entry.size)
        finally:
            if session.lost is None:
                session.send(message("LOG_REQUEST_END", **session.target))
        return bytes(data)
