"""Append-only file of a log: a kill of the writer loses nothing acknowledged. One thread writes it, part by part.

A part is acknowledged when fsync has returned: from then on it is on the disk, and no later part can take it back.
The producer never waits for the disk unless it asks to; its buffer is bounded, and what does not fit is counted.
"""

import os
import threading
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from twodof.errors import LogError, RecordingError
from twodof.flightlog.atomic import create, partial_of, sync_folder

Full = Literal["drop", "wait"]
MAX_CAPACITY_BYTES = 1 << 24
"""Largest buffer [byte]. It becomes one chunk of the file, which readers inflate to 2.7 times its size."""
DEADLINE_S = 10.0
"""A disk that does not answer for so long is taken for dead."""


@dataclass(frozen=True)
class Acknowledged:
    """Part of a recording that is on the disk: its first `position` bytes with the first `samples` accepted samples."""

    position: int = 0
    samples: int = 0


class AppendOnlyFile(ABC):
    """Writer of a new file that only grows. A subclass defines its samples and how they are encoded.

    Waiting samples are written and synced every `flush_s` [s], or as soon as `part_bytes` wait. At most
    `capacity_bytes` wait; beyond, `full` decides whether a sample is dropped and counted, or waits for the disk.
    Safe to use from several threads; after a fork only the parent may use it. With `overwrite` the file is begun under
    another name, and replaces an existing file once its head is on the disk.
    """

    def __init__(
        self,
        path: str | Path,
        flush_s: float,
        capacity_bytes: int,
        full: Full,
        part_bytes: int = 1 << 18,
        overwrite: bool = False,
    ) -> None:
        if not 0.0 < flush_s <= 60.0 or not 0 < capacity_bytes <= MAX_CAPACITY_BYTES or full not in ("drop", "wait"):
            what = f"one of flush_s {flush_s!r}, capacity_bytes {capacity_bytes!r} and full {full!r} is out of range"
            remedy = f"give 0 < flush_s <= 60, at most {MAX_CAPACITY_BYTES} bytes and 'drop' or 'wait'"
            raise LogError(what, str(path), remedy)
        self.path = Path(path)
        self._begun = partial_of(path) if overwrite else self.path  # where it is until its head is written
        self._flush_s, self._capacity, self._full, self._part_bytes = flush_s, capacity_bytes, full, part_bytes
        self._changed = threading.Condition()
        self._waiting_bytes = 0
        self.accepted = 0
        """Samples taken so far; samples that are not acknowledged yet wait in memory."""
        self.acknowledged = Acknowledged()
        """Part that is on the disk, and stays readable from now on."""
        self.failure: RecordingError | None = None
        """Reason for an end before the recording was closed; None while it goes on."""
        self._asked = 0
        self._closing = self._ended = self._fine = False
        self._descriptor = create(self._begun, self.path)  # never in the place of another recording
        self._thread = threading.Thread(target=self._run, name=f"spool {self.path.name}", daemon=True)

    @abstractmethod
    def _take(self) -> object:
        """Empty the buffer and return its content, None for nothing. Called with the lock held."""

    @abstractmethod
    def _encode(self, taken: object) -> bytes:
        """Return the next bytes of the file. Called without the lock."""

    def _ending(self) -> bytes:
        """Return the last bytes of the file, which follow what is acknowledged."""
        return b""

    def flush(self, deadline_s: float = DEADLINE_S) -> Acknowledged:
        """Wait until all samples accepted so far are on the disk. Raises RecordingError, also after `deadline_s`."""
        with self._changed:
            goal = self.accepted
            self._asked = max(self._asked, goal)
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._ended or self.acknowledged.samples >= goal, deadline_s)
            self._check()
            if self.acknowledged.samples < goal:
                raise self._silent(deadline_s)
            return self.acknowledged

    def close(self, deadline_s: float = DEADLINE_S) -> Acknowledged:
        """Write the waiting samples and the file's end. Raises RecordingError; a second call only returns."""
        with self._changed:
            if self._closing:
                return self.acknowledged
            self._closing = True
            self._changed.notify_all()
        self._thread.join(deadline_s)
        if self._thread.is_alive():
            raise self._silent(deadline_s)
        self._check()
        return self.acknowledged

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except RecordingError:
            # The exception of the block says more; `failure` still has this one.
            if kind is None:
                raise

    def _admit(self, size: int) -> bool:
        """Return True if `size` more bytes may wait. Raises RecordingError after the end. Called with the lock held."""
        self._check()
        if self._closing:
            raise RecordingError("the recording is closed", str(self.path), "start another one")
        if self._waiting_bytes + size > self._capacity:
            if size > self._capacity:
                what = f"{size} bytes at once are more than the buffer of {self._capacity}"
                raise LogError(what, str(self.path), "write them in smaller parts")
            if self._full == "drop":
                return False
            self._changed.notify_all()
            if not self._changed.wait_for(
                lambda: self._ended or self._closing or self._waiting_bytes + size <= self._capacity, DEADLINE_S
            ):
                raise self._silent(DEADLINE_S)
            return self._admit(size)
        self._waiting_bytes += size
        if self._waiting_bytes >= self._part_bytes > self._waiting_bytes - size:
            self._changed.notify_all()
        return True

    def _check(self) -> None:
        if self.failure is not None:
            failure = self.failure
            raise RecordingError(failure.what, failure.where, failure.remedy) from failure.__cause__

    def _silent(self, deadline_s: float) -> RecordingError:
        return RecordingError(
            f"the disk did not answer within {deadline_s:g} s; {self.acknowledged.samples} of {self.accepted} "
            "samples are on it",
            str(self.path),
            "record to another disk",
        )

    def _start(self, head: bytes) -> None:
        """Write the head and the folder's entry through to the disk, then start the thread. Raises RecordingError."""
        try:
            self._write(head)
            if self._begun != self.path:
                self._begun.replace(self.path.resolve())
            sync_folder(self.path.resolve().parent)
        except (OSError, LogError) as refusal:
            os.close(self._descriptor)
            self._begun.unlink(missing_ok=True)
            why = refusal.strerror if isinstance(refusal, OSError) else refusal.what
            remedy = "make room or choose another folder; nothing was recorded"
            raise RecordingError(f"cannot be written: {why}", str(self.path), remedy) from refusal
        self.acknowledged = Acknowledged(len(head), 0)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            os.close(self._descriptor)
            with self._changed:
                if self.failure is None and not self._fine:
                    self.failure = RecordingError("the writer ended by a fault of its own", str(self.path), "report it")
                self._ended = True
                self._changed.notify_all()

    def _serve(self) -> None:
        due = time.monotonic() + self._flush_s
        while True:
            with self._changed:
                self._changed.wait_for(self._is_urgent, max(0.0, due - time.monotonic()))
                closing = self._closing
                taken, samples = self._take(), self.accepted
                self._waiting_bytes = 0
                self._changed.notify_all()
            due = time.monotonic() + self._flush_s
            try:
                if taken is not None:
                    self._append(self._encode(taken), samples)
                if closing:
                    self._append(self._ending(), samples)
                    self._fine = True
                    return
            except OSError as refusal:
                self._fail(refusal, samples)
                return

    def _is_urgent(self) -> bool:
        return (
            self._closing
            or self._waiting_bytes >= min(self._part_bytes, self._capacity)
            or self._asked > self.acknowledged.samples
        )

    def _append(self, part: bytes, samples: int) -> None:
        self._write(part)
        with self._changed:
            self.acknowledged = Acknowledged(self.acknowledged.position + len(part), samples)
            self._changed.notify_all()

    def _write(self, part: bytes) -> None:
        rest = memoryview(part)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
        os.fsync(self._descriptor)

    def _fail(self, refusal: OSError, samples: int) -> None:
        """Remove the part that did not fit and, where the disk allows it, write the end of the file."""
        there = self.acknowledged
        failure = RecordingError(
            f"the disk refused: {refusal.strerror}; {there.samples} of {samples} samples are in the file",
            str(self.path),
            "make room and start another recording",
        )
        failure.__cause__ = refusal
        for part in (self._ending(), b""):
            try:
                os.ftruncate(self._descriptor, there.position)
                os.lseek(self._descriptor, there.position, os.SEEK_SET)
                self._write(part)
            except OSError:
                continue  # the second round only takes back what the first one wrote
            break
        with self._changed:
            self.failure = failure
            self._changed.notify_all()
