"""The last logs that were read, kept for the next question about them; lives in the process that reads."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog

MOST_BYTES = 96 << 20
"""Of the files whose logs are kept; in memory a log is 5 to 12 times its file."""

_KEPT: OrderedDict[tuple[str, int, int], FlightLog] = OrderedDict()


def kept_log(path: str) -> FlightLog:
    """The log in a file, read anew where the file has changed. Raises LogError."""
    found = Path(path).stat()
    key = (path, found.st_mtime_ns, found.st_size)
    if key in _KEPT:
        _KEPT.move_to_end(key)
        return _KEPT[key]
    while _KEPT and sum(size for *_, size in _KEPT) + found.st_size > MOST_BYTES:
        _KEPT.popitem(last=False)
    log = read_log(path)
    if found.st_size <= MOST_BYTES:
        _KEPT[key] = log
    return log
