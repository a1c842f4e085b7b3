"""The folder of on-board logs, bounded in size, and the writer of rows of steps into ULog files there."""

import os
import re
import stat
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, TwodofError
from twodof.fcu.onboard_log.log_topics import FORMAT, PX4_TOPICS, STEP_TOPIC, Rows, records
from twodof.fcu.parameters.table import LOG_ALWAYS, LOG_BOOT, LOG_NEVER
from twodof.flightlog.atomic import sync_folder
from twodof.flightlog.provenance import MAX_FILE_BYTES
from twodof.flightlog.ulog_writer import MESSAGE, ULogWriter

MAX_BYTES = 2 << 30
MAX_NUMBER = 65_000
"""Largest number of a log: LOG_ENTRY counts in 16 bits."""

_NAME = re.compile(r"log_(\d{5})\.ulg")


@dataclass(frozen=True)
class StoredLog:
    """A log on board: `number` from 1, size [bytes], and when it was last written [s since 1970, UTC]."""

    number: int
    path: Path
    size: int
    time_utc: int


class LogFolder:
    """Folder `path` of logs log_00001.ulg and so on, made if need be, with at most `max_bytes` and `max_logs`."""

    def __init__(self, path: str | Path, max_bytes: int = MAX_BYTES, max_logs: int = 100) -> None:
        """Make the folder. Raises LogError if it cannot be made."""
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
        """Return the size [byte] after which a log goes on in a new file: `read_log` reads it, and four fit here."""
        return min(self.max_bytes // 4, MAX_FILE_BYTES // 2)

    def logs(self) -> list[StoredLog]:
        """Return the logs by rising number; a file that went in the meantime is left out. Raises LogError."""
        found = []
        try:
            paths = [*self.path.iterdir()]
        except OSError as refusal:
            remedy = "check that the folder exists and can be read"
            raise LogError(f"cannot be listed: {refusal.strerror}", str(self.path), remedy) from refusal
        for path in paths:
            match = _NAME.fullmatch(path.name)
            with suppress(OSError):
                seen = path.lstat()
                if match is not None and stat.S_ISREG(seen.st_mode):
                    found.append(StoredLog(int(match[1]), path, seen.st_size, int(seen.st_mtime)))
        return sorted(found, key=lambda log: log.number)

    def next_path(self) -> Path:
        """Return the path of the next log, after making room. Raises LogError."""
        logs = self.logs()
        self.make_room(logs)
        for number in range(logs[-1].number + 1 if logs else 1, MAX_NUMBER + 1):
            path = self.path / f"log_{number:05d}.ulg"
            if not os.path.lexists(path):  # something else may have the name
                return path
        raise LogError(f"{MAX_NUMBER} logs were written", str(self.path), "erase the logs")

    def make_room(self, logs: list[StoredLog]) -> None:
        """Delete the oldest of `logs` until one more, of `most_of_one` bytes, is within the bounds."""
        kept, size = len(logs), sum(log.size for log in logs)
        for log in logs:
            if kept < self.max_logs and size + self.most_of_one <= self.max_bytes:
                return
            _delete(log.path)
            kept, size = kept - 1, size - log.size

    def erase(self, keep: Path | None = None) -> int:
        """Delete all logs but the one being written, `keep`; return their number. Raises LogError."""
        logs = [log for log in self.logs() if log.path != keep]
        for log in logs:
            _delete(log.path)
        sync_folder(self.path)
        return len(logs)


def _delete(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as refusal:
        remedy = "let this user delete files in the folder"
        raise LogError(f"cannot be deleted: {refusal.strerror}", str(path), remedy) from refusal


MARGIN = 250
"""Number of steps in a log before arming and after disarming."""
LINES = 64
HEAD_BYTES = 20_000
"""Bytes reserved for the head of a log without parameters; formats take 5 kB."""
PARAMETER_BYTES = 64
"""Most bytes of one parameter in a log: header, type, a name of 16 characters and value."""
RETRY_S = 10.0
"""Time after which a disk that refused is tried again [s], if no new log is due before."""

FORMATS: Mapping[str, str] = {STEP_TOPIC: FORMAT, **{topic.name: topic.format for topic in PX4_TOPICS}}


class LogWriter:
    """Writer of rows of steps into the logs of `folder`, as SDLOG_MODE says; called from one thread.

    Each log begins with the facts given to `describe` and with all parameters. `failure` is the reason why the last log
    ended early or did not begin.
    """

    def __init__(self, folder: LogFolder, parameters: Mapping[str, float]) -> None:
        self.folder = folder
        self.failure: TwodofError | None = None
        self._requested = False
        self._info: Mapping[str, str | int] = {}
        self._parameters = dict(parameters)
        self._writer: ULogWriter | None = None
        self._before: Rows | None = None
        self._lines: deque[tuple[str, int, str]] = deque(maxlen=LINES)
        self._steps, self._most_steps = 0, 1 << 62  # in this log
        self._since_armed = MARGIN
        self._was_armed = self._was_disarmed_again = False
        self._tick = -1
        self._stamp_us = 0
        self._retry = 0.0

    @property
    def path(self) -> Path | None:
        """Return the log being written, None if there is none."""
        return self._writer.path if self._writer is not None else None

    def request(self, wanted: bool) -> None:
        """Log always from here on (`wanted`), or again only when SDLOG_MODE says so."""
        self._requested = wanted

    def describe(self, info: Mapping[str, str | int]) -> None:
        """Set the facts of the flight for the logs that begin from here on."""
        self._info = info

    def rows(self, rows: Rows) -> None:
        """Log steps (n,), laid out as `ROW`; a tick before the last one is a restart and begins a new log."""
        ticks = rows["tick"].astype(np.int64)
        breaks = np.flatnonzero(np.diff(ticks, prepend=self._tick) <= 0)
        at = 0
        for end in (*breaks.tolist(), len(rows)):
            if end > at:
                self._run(rows[at:end])
            if end < len(rows):
                self._restart()
            at = end

    def text(self, level: str, line: str) -> None:
        """Log a line of text; the lines shortly before a log begins are its first ones."""
        if self._writer is None:
            self._lines.append((level, self._stamp_us, line))
        else:
            self._guarded(lambda writer: writer.text(level, self._stamp_us, line))

    def parameters(self, values: Mapping[str, float], relisted: bool) -> None:
        """Note changed parameters, or all of a new list (`relisted`); log those that have changed."""
        before = self._parameters
        self._parameters = dict(values) if relisted else before | dict(values)
        changed = {name: value for name, value in values.items() if before.get(name) != value}
        self._guarded(lambda writer: [writer.parameter(name, value, self._stamp_us) for name, value in changed.items()])

    def dropped(self, lost_ms: int) -> None:
        """Log that rows are missing, over `lost_ms` [ms]."""
        self._guarded(lambda writer: writer.dropout(lost_ms, self._stamp_us))

    def flush(self, deadline_s: float) -> None:
        """Wait until all is on the disk."""
        self._guarded(lambda writer: writer.flush(deadline_s))

    def end(self) -> None:
        """End the log being written, if there is one."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except LogError as refusal:
                self.failure = refusal
            self._steps, self._most_steps = 0, 1 << 62

    def _restart(self) -> None:
        self.end()
        self._lines.clear()
        self._before, self._since_armed, self._tick = None, MARGIN, -1
        self._was_armed = self._was_disarmed_again = False

    def _run(self, rows: Rows) -> None:
        """Log steps of one run, cut where logging begins and ends."""
        wanted = self._wanted(rows["armed"] != 0)
        edges = np.flatnonzero(np.diff(wanted)) + 1
        for part, wants in zip(np.split(rows, edges), wanted[np.append(0, edges).astype(np.intp)], strict=True):
            if wants:
                self._log(part)
            else:
                self._retry = 0.0
                self.end()
                self._stamp_us = int(part["timestamp"][-1])
                before = part if self._before is None else np.concatenate([self._before, part])
                self._before = before[-MARGIN:].copy()
        self._tick = int(rows["tick"][-1])

    def _wanted(self, armed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a flag for each of the next steps (n,): True if the log takes it."""
        index = np.arange(len(armed))
        last = np.maximum.accumulate(np.where(armed, index, -1))
        since = np.where(last >= 0, index - last, index + 1 + self._since_armed)
        ended = np.asarray((since == MARGIN + 1) & (self._was_armed | (last >= 0)))
        self._since_armed = min(int(since[-1]), 1 << 30)
        self._was_armed |= bool(armed.any())
        mode = self._parameters["SDLOG_MODE"]
        if self._requested or mode == LOG_ALWAYS:
            return np.ones(len(armed), dtype=np.bool_)
        if mode == LOG_NEVER:
            return np.zeros(len(armed), dtype=np.bool_)
        near = since <= MARGIN
        if mode == LOG_BOOT and not self._was_disarmed_again:
            near |= ~np.logical_or.accumulate(ended)
        self._was_disarmed_again |= bool(ended.any())
        return np.asarray(near)

    def _log(self, rows: Rows) -> None:
        if self._writer is None and time.monotonic() >= self._retry:
            self._begin(rows)
        room = self._most_steps - self._steps
        if len(rows) > room:  # it goes on in another file
            self._log(rows[:room])
            self.end()
            self._log(rows[room:])
        else:
            self._append(rows)

    def _begin(self, rows: Rows) -> None:
        """Open a log with the rows and lines shortly before `rows`."""
        before, self._before = self._before, None
        first = rows if before is None else before
        start_us = int(first["timestamp"][0])
        info: dict[str, str | int] = {**self._info, "time_ref_utc": 0, "start_utc": int(time.time())}
        try:
            self._writer = ULogWriter(
                self.folder.next_path(), FORMATS, info, self._parameters, start_us=start_us, full="wait"
            )
        except LogError as refusal:
            self._failed(refusal)
            return
        self.failure = None
        self._steps = 0
        sizes = (self._writer.layout(name).itemsize + MESSAGE.size + 2 for name in FORMATS)
        head = HEAD_BYTES + PARAMETER_BYTES * len(self._parameters)
        self._most_steps = max((self.folder.most_of_one - head) // sum(sizes), 2 * MARGIN)
        lines = [line for line in self._lines if line[1] >= start_us]
        self._lines.clear()
        if before is not None:
            self._append(before)
        self._guarded(lambda writer: [writer.text(*line) for line in lines])

    def _append(self, rows: Rows) -> None:
        self._stamp_us = int(rows["timestamp"][-1])

        def append(writer: ULogWriter) -> None:
            for topic in PX4_TOPICS:
                writer.write_many(topic.name, records(topic, writer.layout(topic.name), rows))
            # Last, as what is said next stands at the time of the record before it.
            writer.write_many(STEP_TOPIC, rows)
            self._steps += len(rows)

        self._guarded(append)

    def _guarded(self, action: Callable[[ULogWriter], object]) -> None:
        """Act on the log being written, if there is one; note that the disk has refused."""
        try:
            if self._writer is not None:
                action(self._writer)
        except LogError as refusal:
            self._failed(refusal)

    def _failed(self, refusal: LogError) -> None:
        self.end()
        self.failure = refusal
        self._retry = time.monotonic() + RETRY_S
