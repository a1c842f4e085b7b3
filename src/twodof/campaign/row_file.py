"""File of a campaign: a head that names it and a row of figures for each run, one line of JSON each.

A row is on the disk before the next one is written. So a campaign that was killed goes on behind its last whole row.
"""

import fcntl
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from twodof.errors import ExperimentError, LogError
from twodof.flightlog.atomic import refused_places, sync_folder

Row = dict[str, Any]
"""Number, seed and parameters of a run, with its `figures` or the reason why it `failed`."""

MAX_ROW_BYTES = 1 << 14
"""Longest row. What comes back from a run are figures; signals stay where they were computed."""


def row_line(row: Mapping[str, Any]) -> bytes:
    """Return a row as its line in the file; NaN and infinity are null. Raises ExperimentError for a longer one."""
    try:
        line = json.dumps(_plain(row), allow_nan=False).encode() + b"\n"
    except TypeError as reason:
        remedy = "return numbers, text, lists and dicts"
        raise ExperimentError(f"the figures of a run are not JSON: {reason}", "campaign", remedy) from reason
    if len(line) > MAX_ROW_BYTES:
        what = f"a row of {len(line)} bytes is too long"
        raise ExperimentError(what, "campaign", f"return figures, at most {MAX_ROW_BYTES} bytes, and no signals")
    return line


def _plain(value: Any) -> Any:
    """Return a value with Python's numbers in place of numpy's, and None for NaN and infinity."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


class RowFile:
    """Rows of one campaign in the file `path`, opened by one process at a time. A torn last row is dropped.

    `head` says which campaign it is. `rows` are those that the file has. Raises LogError for a file of another
    campaign, for one that is open elsewhere, and where the file system refuses.
    """

    def __init__(self, path: str | Path, head: Mapping[str, Any]) -> None:
        self.path = Path(path)
        with refused_places(path):
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            self.rows: list[Row] = self._resumed(row_line(head))
        except BaseException:
            os.close(self._descriptor)
            raise

    def _resumed(self, head: bytes) -> list[Row]:
        """Lock the file, cut off a torn row, and return its rows; begin a new file."""
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as refusal:
            what = "another campaign is writing this file"
            raise LogError(what, str(self.path), "wait for its end, or name another file") from refusal
        with open(self._descriptor, "rb", closefd=False) as file:
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        if not whole and head.startswith(data):  # new, or killed while it was begun
            self._cut(0)
            self._write(head)
            sync_folder(self.path.resolve().parent)
            return []
        first, *lines = whole.splitlines() or [b""]
        if first + b"\n" != head:
            what = "is the file of another campaign, or of another version of twodof"
            raise LogError(what, str(self.path), "name another file, or replace it with --force")
        rows = []
        for number, line in enumerate(lines):
            try:
                row = json.loads(line)
            except ValueError:
                row = None
            if not isinstance(row, dict) or row.get("run") != number:
                raise LogError(f"line {number + 2} is not the row of run {number}", str(self.path), "replace the file")
            rows.append(row)
        self._cut(len(whole))
        return rows

    def append(self, line: bytes) -> None:
        """Write one row; on return it is on the disk. Raises LogError where the file system refuses."""
        self._write(line)
        self.rows.append(json.loads(line))

    def _cut(self, size: int) -> None:
        os.ftruncate(self._descriptor, size)
        os.lseek(self._descriptor, size, os.SEEK_SET)

    def _write(self, line: bytes) -> None:
        try:
            while line:
                line = line[os.write(self._descriptor, line) :]
            os.fsync(self._descriptor)
        except OSError as refusal:
            what = f"cannot be written: {refusal.strerror}"
            raise LogError(what, str(self.path), "make room, then start the campaign again: it goes on") from refusal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)
