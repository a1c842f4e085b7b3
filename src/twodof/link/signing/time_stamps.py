"""Time stamps of signed packets, kept across restarts: none of ours is used twice, none of theirs is taken twice.

The stamps on the disk run ahead of the stamps that were used, by a margin. So they are written in the background every
few seconds, not with each packet. After a crash everything up to the stamps on the disk counts as used. A stamp is in
units of 10 us since 2015-01-01 (https://mavlink.io/en/guide/message_signing.html).
"""

import fcntl
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from twodof.errors import LinkError, LogError
from twodof.flightlog.atomic import atomic_write
from twodof.link.signing.key import read_guarded

PER_SECOND = 100_000
EPOCH_S = 1_420_070_400
HIGHEST = 2**48 - 1
# After a crash a peer is refused for as long at most, and ours run ahead of the clock by as much.
MARGIN = 10 * PER_SECOND
# A stamp further ahead of our clock than this is no clock's, and would spend the range, which ends in 2104. Less would
# refuse a peer whose clock is wrong, and let what was refused of it be said again by others once its time has come.
MOST_AHEAD = 365 * 24 * 3600 * PER_SECOND
MOST_STREAMS = 1024
MOST_FILE_BYTES = 100_000
WRITE_SECONDS = 5.0
OWN = "own"


def wall_stamp() -> int:
    """Now, by the system's clock."""
    return max(0, int((time.time() - EPOCH_S) * PER_SECOND))


class Stamps:
    """Highest stamp used by each stream, on the disk ahead of its use.

    A stream is a name: `OWN`, or link, system and component of a sender. `path` None keeps nothing: for tests, and for
    a key that lives no longer than the process. One process at a time may have a file. Raises LinkError if another
    has it, or if it cannot be read: guessing would let old packets in. A disk that fails later stops no flight, as a
    kill must always get through: `failure` says so, and it is tried again each second.
    """

    def __init__(self, path: str | Path | None, clock: Callable[[], int] = wall_stamp) -> None:
        self._path = Path(path) if path is not None else None
        self.clock = clock
        self._used: dict[str, int] = {}
        self._stored: dict[str, int] = {}
        self._writing: Future[None] | None = None
        self._ahead: dict[str, int] = {}
        self._lock_file = -1
        self.failure = ""
        self._retry_at = 0.0
        if self._path is not None:
            self._take_lock(self._path)
            try:
                self._stored = _read(self._path)
            except LinkError:
                self._drop_lock()
                raise
            self._used = dict(self._stored)
        self._pool = ThreadPoolExecutor(1, "stamps") if self._path is not None else None

    def next_own(self) -> int:
        """A stamp of ours that was never used: the clock, or one more than the last."""
        stamp = max(self.clock(), self._used.get(OWN, 0) + 1)
        if stamp > HIGHEST:
            raise LinkError("the time stamps of this key are used up", "signing", "set the clock and change the key")
        self.use(OWN, stamp)
        return stamp

    @property
    def own(self) -> int:
        """Our time: the clock, or the highest stamp of ours."""
        return max(self.clock(), self._used.get(OWN, 0))

    @property
    def room(self) -> bool:
        """Whether one more stream may begin."""
        return len(self._used) < MOST_STREAMS

    def last(self, stream: str) -> int | None:
        """The highest stamp that `stream` used, None if it is new."""
        return self._used.get(stream)

    def use(self, stream: str, stamp: int) -> None:
        """Say that `stream` used everything up to `stamp`; it is on the disk, or `failure` says why not."""
        self._used[stream] = stamp
        if self._path is None:
            return
        if stamp > self._stored.get(stream, -1):
            self._settle()
            if stamp > self._stored.get(stream, -1) and time.monotonic() >= self._retry_at:
                self._try(lambda: self._write(self._reserved()))
        elif stamp > self._stored[stream] - MARGIN // 2 and self._writing is None and self._pool is not None:
            self._ahead = self._reserved()
            self._writing = self._pool.submit(_write, self._path, self._ahead)
        elif self._writing is not None and self._writing.done():
            self._settle()

    def close(self) -> None:
        """Write what was really used, so that nobody waits for the margin, and let others have the file.

        Raises LinkError if that fails.
        """
        if self._path is None or self._pool is None:
            return
        try:
            self._settle()
            self._write(dict(self._used))
        finally:
            self._pool.shutdown()
            self._pool = None
            self._drop_lock()

    def _reserved(self) -> dict[str, int]:
        return {stream: min(HIGHEST, used + MARGIN) for stream, used in self._used.items()}

    def _write(self, stamps: dict[str, int]) -> None:
        if self._path is not None:
            _write(self._path, stamps)
            self._stored = stamps

    def _settle(self) -> None:
        """Wait for the write in the background, if there is one."""
        if self._writing is not None:
            writing, self._writing = self._writing, None
            if self._try(lambda: writing.result(timeout=WRITE_SECONDS)):
                self._stored = self._ahead

    def _try(self, write: Callable[[], None]) -> bool:
        """Whether a write went well; if not, it is kept in mind and not tried again for a second."""
        try:
            write()
        except (LinkError, TimeoutError) as error:
            self.failure = str(error) or "the disk does not answer"
            self._retry_at = time.monotonic() + 1.0
            return False
        self.failure = ""
        return True

    def _take_lock(self, path: Path) -> None:
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
            self._lock_file = os.open(f"{path}.lock", flags, 0o600)
            fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._drop_lock()
            taken = isinstance(error, BlockingIOError)
            what = "another process signs with these time stamps" if taken else f"cannot be locked: {error.strerror}"
            raise LinkError(what, str(path), "give each process a file of its own") from error

    def _drop_lock(self) -> None:
        if self._lock_file >= 0:
            os.close(self._lock_file)
            self._lock_file = -1


def _read(path: Path) -> dict[str, int]:
    """The stamps in a file that nobody but its owner, us, can have set back."""
    beside = "and change the key: old packets could come back"
    try:
        data = read_guarded(path, MOST_FILE_BYTES + 1, 0o022, "the time stamps", beside, "make it readable")
    except LinkError as error:
        if isinstance(error.__cause__, FileNotFoundError):  # any other refusal may hide stamps that were kept
            return {}
        raise
    try:
        found: Any = json.loads(data) if len(data) <= MOST_FILE_BYTES else None
    except (ValueError, RecursionError):
        found = None
    sound = isinstance(found, dict) and len(found) <= MOST_STREAMS
    if not sound or not all(type(value) is int and 0 <= value <= HIGHEST for value in found.values()):
        raise LinkError("holds no time stamps", str(path), f"remove it {beside}")
    return {str(stream): value for stream, value in found.items()}


def _write(path: Path, stamps: dict[str, int]) -> None:
    try:
        with atomic_write(path, "w") as file:
            json.dump(stamps, file)
    except LogError as error:
        raise LinkError(f"the time stamps are not kept: {error.what}", str(path), "make room on the disk") from error
