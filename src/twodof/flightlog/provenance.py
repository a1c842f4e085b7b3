"""Reading of files: their size, their text; and the provenance of a log: file, checksum, history, versions."""

import codecs
import hashlib
import json
import os
import platform
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

import twodof
from twodof.errors import LogError
from twodof.flightlog.log import FlightLog

MAX_FILE_BYTES = 1 << 29
"""Largest log file that is read, in bytes."""
MAX_DEPTH = 32
"""Deepest nesting of provenance: each level is indented where it is printed."""
RECOVER = "get what is sound with: twodof log recover"
"""The remedy for a file that was cut off or damaged; `naming_file` adds the file's name."""
_AGAIN = "write the log again from its source"
SEPARATORS = ",;\t"
"""What may stand between the columns of a table; with the last two, a comma may be the decimal mark."""


@dataclass(frozen=True)
class Loss:
    """A part of a file that cannot be used: `size` bytes from byte `at` on."""

    at: int
    size: int
    why: str


@contextmanager
def naming_file(path: str | Path) -> Iterator[None]:
    """Add the name of the file to the remedy RECOVER of a LogError, so that the command can be copied."""
    try:
        yield
    except LogError as reason:
        if reason.remedy != RECOVER:
            raise
        raise LogError(reason.what, reason.where, f"{RECOVER} {quote(str(path))}") from reason


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    return {"twodof": twodof.__version__, "python": platform.python_version(), "numpy": np.__version__}


@contextmanager
def open_file(path: str | Path, most: int | None = None) -> Iterator[int]:
    """Open a file and yield its descriptor. Raises LogError for one that is missing, unreadable, empty, not regular.

    A file of more than `most` bytes, MAX_FILE_BYTES by default, is refused too.
    """
    most = MAX_FILE_BYTES if most is None else most
    try:
        # Without O_NONBLOCK a pipe would wait for its writer. A device has no end.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as refusal:
        why = refusal.strerror if isinstance(refusal, OSError) else refusal  # a name with a null character
        raise LogError(f"cannot be read: {why}", str(path), "check the name and the rights") from refusal
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise LogError("is not a regular file", str(path), "name a file on a disk")
        if found.st_size > most:
            raise LogError(f"{found.st_size} bytes are too many", str(path), f"at most {most} bytes are read")
        if not found.st_size:
            raise LogError("the file is empty", str(path), "record or download it again")
        yield descriptor
    finally:
        os.close(descriptor)


def read_bytes(path: str | Path, most: int | None = None) -> bytes:
    """Return the content of a file. Raises LogError as `open_file` does."""
    with open_file(path, most) as descriptor:
        try:
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                return file.read(os.fstat(descriptor).st_size)
        except OSError as refusal:
            what = f"cannot be read: {refusal.strerror}"
            raise LogError(what, str(path), "check the disk") from refusal


def text_of(data: bytes) -> str:
    """Return the text of a file: UTF-8, or UTF-16 behind a byte order mark, which is left out.

    Raises UnicodeDecodeError.
    """
    is_utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return data.decode("utf-16" if is_utf_16 else "utf-8-sig")


def separator_of(heading: str) -> str:
    """Return the separator of columns in a table's heading; a comma if there is none."""
    return max(SEPARATORS, key=heading.count)


def of_file(path: str | Path, data: bytes, kind: str) -> dict[str, Any]:
    """Return the entry `file` of a log's provenance: name, format, size and checksum."""
    return {"name": Path(path).name, "format": kind, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def to_json(log: FlightLog) -> str:
    """Return a log's provenance as JSON for a new file: the file that was read becomes the last entry of `history`.

    Raises LogError for a provenance that JSON cannot hold.
    """
    return kept_json(log.provenance, log.source)


def kept_json(entries: Mapping[str, Any], where: str) -> str:
    """Return entries of provenance as JSON, with `file` moved to the end of `history`. Raises LogError."""
    kept = {key: value for key, value in entries.items() if key not in ("file", "history")}
    history = [*entries.get("history", [])]
    if "file" in entries:
        history.append(entries["file"])
    if history:
        kept["history"] = history
    kept.setdefault("versions", versions())
    try:
        return json.dumps(kept, allow_nan=False)
    except (TypeError, ValueError) as reason:
        what = f"provenance is not JSON: {reason}"
        raise LogError(what, where, "keep numbers, text, lists and dicts in it") from reason


def from_json(text: str, where: str) -> dict[str, Any]:
    """Return the entries that `to_json` wrote. Raises LogError."""
    try:
        kept = json.loads(text)
    except (ValueError, RecursionError) as reason:
        raise LogError(f"the provenance kept in the file is not JSON: {reason}", where, _AGAIN) from reason
    if not isinstance(kept, dict) or not isinstance(kept.get("history", []), list):
        raise LogError("the provenance kept in the file is not a table of entries", where, _AGAIN)
    level: list[Any] = [kept]
    for _ in range(MAX_DEPTH):
        level = [list(one.values()) if isinstance(one, dict) else one for one in level]
        level = [inner for one in level if isinstance(one, list) for inner in one]
    if level:
        raise LogError(f"the provenance kept in the file is nested over {MAX_DEPTH} deep", where, _AGAIN)
    return kept


def noted(kept: dict[str, Any], counts: dict[str, dict[str, int]]) -> dict[str, Any]:
    """Return provenance with the counts of `sanitise` by channel under "left_out", without empty ones."""
    some = {name: row for name, row in counts.items() if row}
    return {**kept, "left_out": some} if some else kept
