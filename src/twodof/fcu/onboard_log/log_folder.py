"""The folder of on-board logs: numbered files, bounded in number and bytes, the oldest going first."""

import os
import re
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from twodof.errors import LogError
from twodof.flightlog.atomic import sync_folder
from twodof.flightlog.provenance import MAX_FILE_BYTES

MAX_BYTES = 2 << 30
MAX_NUMBER = 65_000
"""LOG_ENTRY counts in 16 bits."""

_NAME = re.compile(r"log_(\d{5})\.ulg")


@dataclass(frozen=True)
class StoredLog:
    """A log on board: `number` from 1, size [bytes], and when it was last written [s since 1970, UTC]."""

    number: int
    path: Path
    size: int
    time_utc: int


class LogFolder:
    """Logs as log_00001.ulg and so on in the folder `path`, which is made; `max_bytes` and `max_logs` bound them."""

    def __init__(self, path: str | Path, max_bytes: int = MAX_BYTES, max_logs: int = 100) -> None:
        """Raises LogError where the folder cannot be made."""
        self.path = Path(path)
        self.max_bytes, self.max_logs = max_bytes, max_logs
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as refusal:
            raise LogError(
                f"no folder for logs: {refusal.strerror}", str(path), "choose a folder that can be written"
            ) from refusal

    @property
    def most_of_one(self) -> int:
        """Bytes after which a log goes on in a new file: what `read_log` reads, and a quarter of the folder's bound."""
        return min(self.max_bytes // 4, MAX_FILE_BYTES // 2)

    def logs(self) -> list[StoredLog]:
        """The logs by rising number; a file that went in the meantime is left out. Raises LogError."""
        found = []
        try:
            paths = [*self.path.iterdir()]
        except OSError as refusal:
            raise LogError(f"cannot be listed: {refusal.strerror}", str(self.path), "see that it is there") from refusal
        for path in paths:
            match = _NAME.fullmatch(path.name)
            with suppress(OSError):
                seen = path.lstat()
                if match is not None and stat.S_ISREG(seen.st_mode):
                    found.append(StoredLog(int(match[1]), path, seen.st_size, int(seen.st_mtime)))
        return sorted(found, key=lambda log: log.number)

    def next_path(self) -> Path:
        """Where the next log goes, after making room. Raises LogError."""
        logs = self.logs()
        self.make_room(logs)
        for number in range(logs[-1].number + 1 if logs else 1, MAX_NUMBER + 1):
            path = self.path / f"log_{number:05d}.ulg"
            if not os.path.lexists(path):  # something else may have the name
                return path
        raise LogError(f"{MAX_NUMBER} logs were written", str(self.path), "erase the logs")

    def make_room(self, logs: list[StoredLog]) -> None:
        """Deletes the oldest of `logs` until one more, of `most_of_one` bytes, is within the bounds."""
        kept, size = len(logs), sum(log.size for log in logs)
        for log in logs:
            if kept < self.max_logs and size + self.most_of_one <= self.max_bytes:
                return
            _delete(log.path)
            kept, size = kept - 1, size - log.size

    def erase(self, keep: Path | None = None) -> int:
        """Deletes all logs but the one being written, `keep`; returns how many. Raises LogError."""
        logs = [log for log in self.logs() if log.path != keep]
        for log in logs:
            _delete(log.path)
        sync_folder(self.path)
        return len(logs)


def _delete(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as refusal:
        raise LogError(f"cannot be deleted: {refusal.strerror}", str(path)) from refusal
