"""The logs that the drone has on board: which there are, and bringing them down."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from twodof.errors import LogError
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.gcs.mavlink.deadline import Deadline
from twodof.gcs.mavlink.session import DroneSession
from twodof.link.mavlink.messages import message

MOST_LOGS = 10_000
LARGEST = 1 << 29
"""Bytes of the largest log that is brought down."""
PIECE = 90
PIECES = 512
"""Pieces that are asked for at once."""
RETRY_S = 0.5
STALLED_S = 5.0


class LogEntry(NamedTuple):
    """A log on board: its number, length [bytes], and when it was begun (seconds of UTC, 0: not known)."""

    number: int
    size: int
    time_utc: int


class AsyncLogs:
    """The logs of one drone."""

    def __init__(self, session: DroneSession) -> None:
        self._session = session

    async def list(self, timeout: float = 5.0) -> list[LogEntry]:
        """All logs on board, the oldest first. Raises LinkLost, Timeout."""
        deadline = self._session.deadline(timeout, "listing the logs on board")
        asked = message("LOG_REQUEST_LIST", start=0, end=0xFFFF, **self._session.target)
        found: dict[int, LogEntry] = {}

        def accept(got: Any) -> dict[int, LogEntry] | None:
            if got.num_logs:
                found[got.id] = LogEntry(got.id, got.size, got.time_utc)
            return found if len(found) >= min(got.num_logs, MOST_LOGS) else None

        await self._session.ask(lambda _: asked, ("LOG_ENTRY",), accept, deadline, prolonged=True)
        return [found[number] for number in sorted(found)]

    async def download(
        self,
        entry: LogEntry,
        path: str | Path,
        timeout: float = 600.0,
        progress: Callable[[int, int], None] | None = None,
        overwrite: bool = False,
    ) -> Path:
        """Bring a log down into `path`, whole or not at all; `progress(bytes, of)` is told on the way.

        Raises LogError for a file that is there, a log that is empty or too large, Timeout when nothing more comes for
        5 s, LinkLost.
        """
        check_free(path, overwrite)
        where = f"drone {self._session.system}, log {entry.number}"
        if not 0 < entry.size <= LARGEST:
            raise LogError(f"{entry.size} bytes", where, f"1 to {LARGEST} bytes are brought down")
        data = await self._bytes(entry, Deadline(timeout, "bringing a log down", where), progress)
        with atomic_write(path) as file:
            file.write(data)
        return Path(path)

    async def _bytes(self, entry: LogEntry, deadline: Deadline, progress: Callable[[int, int], None] | None) -> bytes:
        """Asks for PIECES at once from the first that is missing on, and again where nothing more comes."""
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
                    while wanted and (got := await heard.next(min(stalled.end, session.now + RETRY_S))) is not None:
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
