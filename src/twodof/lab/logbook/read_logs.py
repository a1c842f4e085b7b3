"""Logs as the server reads them: by name for whoever asks, the last ones kept; lives in the process that reads."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

from twodof.errors import LogError
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog

MOST_BYTES = 96 << 20
"""Of the files whose logs are kept; in memory a log is 5 to 12 times its file."""

_KEPT: OrderedDict[tuple[str, int, int], FlightLog] = OrderedDict()


def named_log(path: str) -> FlightLog:
    """The log in a file. Raises LogError, which names the file alone: in which folder it is, is the server's matter."""
    name = Path(path).name
    try:
        return read_log(path)
    except LogError as reason:
        said = (text.replace(path, name) for text in (reason.what, reason.where, reason.remedy))
        raise LogError(*said) from reason


def kept_log(path: str) -> FlightLog:
    """The log in a file, read anew where the file has changed. Raises LogError."""
    try:
        found = Path(path).stat()
    except OSError as reason:  # deleted since it was asked for
        raise LogError("is not there any more", Path(path).name, "choose one of the list") from reason
    key = (path, found.st_mtime_ns, found.st_size)
    if key in _KEPT:
        _KEPT.move_to_end(key)
        return _KEPT[key]
    while _KEPT and sum(size for *_, size in _KEPT) + found.st_size > MOST_BYTES:
        _KEPT.popitem(last=False)
    log = named_log(path)
    if found.st_size <= MOST_BYTES:
        _KEPT[key] = log
    return log
