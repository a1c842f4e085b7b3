"""One door for every file format: the suffix of the name decides."""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from twodof.errors import LogError
from twodof.flightlog.atomic import check_free, partial_of
from twodof.flightlog.log import FlightLog
from twodof.flightlog.mat.mat_file import read_mat, write_mat
from twodof.flightlog.mcap.mcap_file import read_mcap, write_mcap
from twodof.flightlog.table.table_file import read_csv, read_parquet, write_csv, write_parquet
from twodof.flightlog.ulog.export import write_ulg
from twodof.flightlog.ulog.ulog_file import read_ulog

_Function = TypeVar("_Function")
_READERS: Mapping[str, Callable[[str | Path], FlightLog]] = MappingProxyType(
    {".mat": read_mat, ".mcap": read_mcap, ".parquet": read_parquet, ".csv": read_csv, ".ulg": read_ulog}
)


def _write_ulog(log: FlightLog, path: str | Path) -> None:
    """By way of a file beside it: `write_ulg` writes new files only, and as it goes."""
    begun = partial_of(path)
    try:
        write_ulg(log, begun)
        begun.replace(Path(path).resolve())
    finally:
        begun.unlink(missing_ok=True)


_WRITERS: Mapping[str, Callable[[FlightLog, str | Path], None]] = MappingProxyType(
    {".mat": write_mat, ".mcap": write_mcap, ".parquet": write_parquet, ".csv": write_csv, ".ulg": _write_ulog}
)

_TABLES: Mapping[str, Callable[[FlightLog, str | Path], None]] = MappingProxyType(
    {".parquet": partial(write_parquet, wide=True), ".csv": partial(write_csv, wide=True)}
)


def read_log(path: str | Path) -> FlightLog:
    """Reads a log from a .mat, .mcap, .parquet, .csv or .ulg file. Raises LogError."""
    return _check(path, _READERS)(path)


def write_log(log: FlightLog, path: str | Path, wide: bool = False, overwrite: bool = False) -> None:
    """Writes a log to a .mat, .mcap, .parquet, .csv or .ulg file, atomically. Raises LogError, also if it is there.

    A .ulg holds the signals of TOPICS; channels of other names are left out.

    `wide` writes a table (.parquet, .csv) with one row for each time stamp and a column for each signal, in place of
    one row for each number.
    """
    write = _check(path, _TABLES if wide else _WRITERS)
    check_free(path, overwrite)
    write(log, path)


def check_place(path: str | Path, overwrite: bool = False) -> None:
    """Whether `write_log` can write there, before what it is to hold is made: a known suffix, a folder that lets us in.

    Raises LogError.
    """
    _check(path, _WRITERS)
    check_folder(path, overwrite)


def check_folder(path: str | Path, overwrite: bool = False) -> None:
    """Whether a file of any kind can be written there, before what it is to hold is made. Raises LogError."""
    target = Path(path).resolve()
    if target.is_dir():
        raise LogError("is a directory", str(path), "name a file")
    if not target.parent.is_dir():
        raise LogError("its folder is not there", str(path), f"make it: mkdir -p {target.parent}")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise LogError("its folder may not be written", str(path), "choose another one")
    check_free(path, overwrite)


def convert(src: str | Path, dst: str | Path, wide: bool = False, overwrite: bool = False) -> FlightLog:
    """Reads `src` and writes it as `dst` (see `write_log`); returns the log.

    Raises LogError before anything is written.
    """
    _check(dst, _TABLES if wide else _WRITERS)
    if Path(dst).exists() and Path(src).exists() and Path(dst).samefile(src):
        raise LogError("would be written over itself", str(src), "name another file to write")
    check_free(dst, overwrite)
    log = read_log(src)
    write_log(log, dst, wide, overwrite)
    return log


def _check(path: str | Path, known: Mapping[str, _Function]) -> _Function:
    """What `known` has for the suffix of a name. Raises LogError."""
    suffix = Path(path).suffix.lower()
    if known is _TABLES and suffix in _WRITERS and suffix not in known:
        what = f"{suffix} logs are not tables"
        raise LogError(what, str(path), f"write {', '.join(known)}, or leave the wide form out")
    if suffix not in known:
        raise LogError(f"no log format has the suffix {Path(path).suffix!r}", str(path), f"use {', '.join(known)}")
    return known[suffix]
