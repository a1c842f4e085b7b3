"""Names of logs: which may come in from outside, and where those of a request are, never outside their folders."""

from __future__ import annotations

import re
from pathlib import Path

from twodof.errors import LogError

SUFFIXES = (".mcap", ".mat", ".parquet", ".csv", ".ulg")
"""Of logs that are read."""
LONGEST = 120
_NEW = re.compile(r"[A-Za-z0-9][A-Za-z0-9_. +-]*")


def is_log(name: str) -> bool:
    """Whether a file of that name is shown: a suffix of a log, not hidden, of letters that can be printed."""
    return (
        len(name) <= 2 * LONGEST
        and not name.startswith(".")
        and name.isprintable()
        and not set(name) & {"/", "\\"}
        and Path(name).suffix.lower() in SUFFIXES
    )


def new_name(name: str) -> str:
    """A name under which a log is taken in. Raises LogError with what is wrong with it."""
    if Path(name).suffix.lower() not in SUFFIXES:
        what = f"no log format has the suffix {Path(name).suffix[:20]!r}"
        raise LogError(what, name[:80], f"use {', '.join(SUFFIXES)}")
    if len(name) > LONGEST or not _NEW.fullmatch(name) or ".." in name:
        remedy = f"use letters, digits, spaces, _ . + and -, at most {LONGEST} of them"
        raise LogError("is not a name for a log", name[:80], remedy)
    return name
