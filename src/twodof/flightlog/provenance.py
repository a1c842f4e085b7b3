"""Where a log came from: the file read, its checksum, the files it was made from, the versions at work."""

import hashlib
import json
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import twodof
from twodof.errors import LogError
from twodof.flightlog.log import FlightLog

MAX_FILE_BYTES = 1 << 29
"""Largest log file that is read, in bytes."""


def versions() -> dict[str, str]:
    """The versions that a result depends on."""
    return {"twodof": twodof.__version__, "python": platform.python_version(), "numpy": np.__version__}


def read_bytes(path: str | Path) -> bytes:
    """A whole file. Raises LogError if it is missing, unreadable, empty or over MAX_FILE_BYTES."""
    try:
        size = Path(path).stat().st_size
        if size > MAX_FILE_BYTES:
            raise LogError(f"{size} bytes", str(path), f"a log of at most {MAX_FILE_BYTES} bytes is read")
        data = Path(path).read_bytes()
    except OSError as refusal:
        raise LogError(f"cannot be read: {refusal.strerror}", str(path), "check the name and the rights") from refusal
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
        raise LogError(
            f"provenance is not JSON: {reason}", where, "keep numbers, text, lists and dicts in it"
        ) from reason


def from_json(text: str, where: str) -> dict[str, Any]:
    """The reverse of `to_json`. Raises LogError."""
    try:
        kept = json.loads(text)
    except (ValueError, RecursionError) as reason:
        raise LogError(f"the provenance kept in the file is not JSON: {reason}", where) from reason
    if not isinstance(kept, dict) or not isinstance(kept.get("history", []), list):
        raise LogError("the provenance kept in the file is not a table of entries", where)
    return kept
