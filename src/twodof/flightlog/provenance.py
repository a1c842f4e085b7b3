"""Where a log came from: the file read, its checksum, the files it was made from, the versions at work."""

import hashlib
import json
import os
import platform
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import twodof
from twodof.errors import LogError
from twodof.flightlog.log import FlightLog
from twodof.flightlog.memory_budget import MemoryBudget

MAX_FILE_BYTES = 1 << 29
"""Largest log file that is read, in bytes."""
MAX_DEPTH = 32
"""Deepest nesting of provenance: each level is indented where it is printed."""


def versions() -> dict[str, str]:
    """The versions that a result depends on."""
    return {"twodof": twodof.__version__, "python": platform.python_version(), "numpy": np.__version__}


def read_bytes(path: str | Path, most: int | None = None) -> bytes:
    """A whole file. Raises LogError for one that is missing, unreadable, empty, over `most` bytes, not regular."""
    most = MAX_FILE_BYTES if most is None else most
    try:
        # A pipe would wait for who writes to it, and a device has no end.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise LogError("is not a regular file", str(path), "name a file on a disk")
            if found.st_size > most:
                raise LogError(f"{found.st_size} bytes", str(path), f"at most {most} bytes are read")
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                data = file.read(found.st_size)
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as refusal:
        why = refusal.strerror if isinstance(refusal, OSError) else refusal  # a name with a null character
        raise LogError(f"cannot be read: {why}", str(path), "check the name and the rights") from refusal
    if not data:
        raise LogError("the file is empty", str(path), "record or download it again")
    return data


def of_file(path: str | Path, data: bytes, kind: str) -> dict[str, Any]:
    """The entry `file` of a log's provenance: name, format, size and checksum."""
    return {
        "name": Path(path).name,
        "format": kind,
        "bytes": len(data),
        "sha256": hashlib.sha256(data).hexdigest(),
    }


def to_json(log: FlightLog) -> str:
    """A log's provenance as it is kept in a file: what was read becomes the last entry of `history`.

    Raises LogError for a provenance that JSON cannot hold.
    """
    return kept_json(log.provenance, log.source)


def kept_json(entries: Mapping[str, Any], where: str) -> str:
    """Entries of provenance as JSON, with `file` moved to the end of `history`. Raises LogError."""
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


def from_json(text: str, where: str, budget: MemoryBudget) -> dict[str, Any]:
    """The reverse of `to_json`. Raises LogError."""
    budget.json(len(text))
    try:
        kept = json.loads(text)
    except (ValueError, RecursionError) as reason:
        raise LogError(f"the provenance kept in the file is not JSON: {reason}", where) from reason
    if not isinstance(kept, dict) or not isinstance(kept.get("history", []), list):
        raise LogError("the provenance kept in the file is not a table of entries", where)
    level: list[Any] = [kept]
    for _ in range(MAX_DEPTH):
        level = [list(one.values()) if isinstance(one, dict) else one for one in level]
        level = [inner for one in level if isinstance(one, list) for inner in one]
    if level:
        raise LogError(f"the provenance kept in the file is nested over {MAX_DEPTH} deep", where)
    return kept
