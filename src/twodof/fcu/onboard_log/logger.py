"""OnboardLogger: every step of a flight in ULog files on board, written by a thread beside the control loop."""

import struct
import threading
from collections import deque
from collections.abc import Callable, Container, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Self

import numpy as np

from twodof import __version__
from twodof.errors import LogError, TwodofError
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.onboard_log.log_topics import ROW, pack
from twodof.fcu.onboard_log.log_writer import MAX_BYTES, LogFolder, LogWriter, StoredLog
from twodof.fcu.parameters.parameter_store import ParametersChanged, ParametersRelisted, ParameterStore
from twodof.flightlog.append_only_file import DEADLINE_S
from twodof.signals import TICK_US

LONGEST_QUEUE = 20_000
"""Rows that may wait for the disk, 6 MB: 80 s of real time."""
LOCKSTEP_WAIT_S = 30.0
LISTING_S = 10.0
"""Longest wait for the disk before the logs are listed [s]."""
_PAUSE_S = 0.2
_AT_ONCE = 4096

ABOUT = MappingProxyType({"ver_hw": "TWODOF", "ver_sw": __version__, "sys_os_name": "Linux"})

Note = Callable[[LogWriter], object]
"""Task for the writer, queued between rows."""


class OnboardLogger:
    """Logger of steps into `folder`, as SDLOG_MODE of `store` says; `step` is a listener of the control loop.

    `step` never waits in real time: while the disk is too slow, rows are dropped and counted in `dropped`, with a mark
    in the log. In `lockstep` it waits for the disk instead, so that nothing is missing. Whatever the disk does, the
    flight goes on: `failure` says why a log ended early or did not begin. `info` returns the facts of the flight (rig,
    seed, controller); it is called when time begins and at each arming.
    """

    def __init__(
        self,
        folder: str | Path,
        store: ParameterStore,
        lockstep: bool = False,
        info: Callable[[], Mapping[str, str | int]] = dict,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        """Make the folder and start the thread. Raises LogError if the folder cannot be made."""
        self.folder = LogFolder(folder, max_bytes, int(store["SDLOG_DIRS_MAX"]))
        self.lockstep = lockstep
        self.dropped = 0
        self._info = info
        self._writer = LogWriter(self.folder, {row.name: store[row.name] for row in store.rows})
        self._queue: deque[bytes | Note] = deque()
        self._tick, self._armed = -1, False
        self._gap: int | None = None  # tick of the first row that was dropped since the last one taken
        self._wake, self._room = threading.Event(), threading.Event()
        self._closed = self._ended = False
        self._thread = threading.Thread(target=self._serve, name="on-board log", daemon=True)
        self._thread.start()
        store.bus.subscribe(ParametersChanged, lambda changed: self._changed(store, changed.values))
        store.bus.subscribe(ParametersRelisted, lambda _: self._changed(store, None))

    @property
    def failure(self) -> TwodofError | None:
        """Return why the last log ended early or could not begin; None while all is well."""
        if not self._thread.is_alive() and not self._closed:
            return LogError("the logger's thread ended by a fault of its own", str(self.folder.path), "report it")
        return self._writer.failure

    @property
    def path(self) -> Path | None:
        """Return the log being written, None while there is none."""
        return self._writer.path

    def step(self, step: ControlStep) -> None:
        """Queue a step; takes about a microsecond."""
        queue = self._queue
        if step.tick <= self._tick or (step.armed and not self._armed) or self._tick < 0:
            queue.append(partial(LogWriter.describe, info={**ABOUT, **self._info()}))
        self._tick, self._armed = step.tick, step.armed
        if len(queue) >= LONGEST_QUEUE and not self._waited():
            self._drop(step.tick)
            return
        try:
            row = pack(step)
        except struct.error:  # a number that is out of its range, which no step has
            self._drop(step.tick)
            return
        if self._gap is not None:
            queue.append(partial(LogWriter.dropped, lost_ms=(step.tick - self._gap) * TICK_US // 1000))
            self._gap = None
        queue.append(row)

    def note(self, level: str, line: str) -> None:
        """Log a line of text with a level: "error", "warning", "info" or "debug"."""
        self._put(lambda writer: writer.text(level, line))

    def remark(self, severity: int, text: str) -> None:
        """Log a text of the vehicle with its MAV_SEVERITY."""
        self.note("error" if severity <= 3 else "warning" if severity == 4 else "info", text)

    def start(self) -> None:
        """Log from the next step on, armed or not, until `stop`."""
        self._put(lambda writer: writer.request(True))

    def stop(self) -> None:
        """End the logging that `start` began."""
        self._put(lambda writer: writer.request(False))

    def start_new_log(self) -> None:
        """Log into a new file from here on; does not wait."""
        self._put(LogWriter.end)

    def logs(self) -> list[StoredLog]:
        """Return the logs by rising number, with the one being written and all its rows so far. Raises LogError."""
        if self._thread.is_alive():
            with suppress(LogError):  # a disk that is silent: what is on it is listed
                self._ask(_flush, LISTING_S)
        return self.folder.logs()

    def erase(self) -> int:
        """Delete all logs but the one being written; return their number. Raises LogError."""
        return self.folder.erase(self.path)

    def flush(self, deadline_s: float = 10.0) -> None:
        """Wait until all rows are on the disk. Raises LogError if they are not there within `deadline_s` [s]."""
        self._ask(_flush, deadline_s)
        if self.failure is not None:
            raise LogError(self.failure.what, self.failure.where, self.failure.remedy)

    def end(self, deadline_s: float = 10.0) -> None:
        """End the log being written; the next rows go into a new one. Raises LogError as `flush`."""
        self._ask(LogWriter.end, deadline_s)

    def close(self, deadline_s: float = 10.0) -> None:
        """End the log and the thread. Raises LogError as `flush`; a second call only returns."""
        if not self._closed:
            self._closed = True
            self._ask(self._end_all, deadline_s)
            self._thread.join(deadline_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _changed(self, store: ParameterStore, names: Container[str] | None) -> None:
        """Log the parameters of these names; None: all, because the list has changed."""
        values = {row.name: store[row.name] for row in store.rows if names is None or row.name in names}
        self.folder.max_logs = int(store["SDLOG_DIRS_MAX"])
        self._put(lambda writer: writer.parameters(values, relisted=names is None))

    def _put(self, note: Note) -> None:
        # Notes are few; when thousands wait the disk is dead.
        if len(self._queue) < 2 * LONGEST_QUEUE:
            self._queue.append(note)

    def _drop(self, tick: int) -> None:
        self.dropped += 1
        self._gap = tick if self._gap is None else self._gap

    def _waited(self) -> bool:
        """Wait for room in lockstep; return whether there is some."""
        if not self.lockstep or self._closed:
            return False
        self._room.clear()
        if len(self._queue) < LONGEST_QUEUE:  # room was made just before, and who made it may have nothing left to do
            return True
        self._wake.set()
        return self._room.wait(LOCKSTEP_WAIT_S)

    def _ask(self, note: Note, deadline_s: float) -> None:
        done = threading.Event()

        def answered(writer: LogWriter) -> None:
            note(writer)
            done.set()

        self._queue.append(answered)
        self._wake.set()
        if not done.wait(deadline_s):
            raise LogError(
                f"the disk did not answer within {deadline_s:g} s", str(self.folder.path), "log to another disk"
            )

    def _end_all(self, writer: LogWriter) -> None:
        writer.end()
        self._ended = True

    def _serve(self) -> None:
        while not self._ended:
            self._wake.wait(_PAUSE_S)
            self._wake.clear()
            while self._queue and not self._ended:
                self._take()
                if len(self._queue) < LONGEST_QUEUE:
                    self._room.set()

    def _take(self) -> None:
        """Handle some of the queue."""
        rows: list[bytes] = []
        note: Note | None = None
        while self._queue and note is None and len(rows) < _AT_ONCE:
            item = self._queue.popleft()
            if isinstance(item, bytes):
                rows.append(item)
            else:
                note = item
        if rows:
            self._writer.rows(np.frombuffer(b"".join(rows), ROW))
        if note is not None:
            note(self._writer)


def _flush(writer: LogWriter) -> None:
    writer.flush(DEADLINE_S)
