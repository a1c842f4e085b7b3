"""Reading and writing of log files in every format, by the suffix of the name. Files are read behind the fence."""

import importlib
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from io import RawIOBase
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import fence
from twodof.flightlog.atomic import check_free, partial_of, refused_places
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mcap_encoder import Attachment
from twodof.flightlog.provenance import naming_file

_MODULES: Mapping[str, str] = MappingProxyType(
    {
        ".mat": "twodof.flightlog.mat_file",
        ".mcap": "twodof.flightlog.mcap_file",
        ".parquet": "twodof.flightlog.table_file",
        ".csv": "twodof.flightlog.table_file",
        ".ulg": "twodof.flightlog.ulog_file",
    }
)
"""The modules of the formats by suffix, each with a function to decode logs and one to write them, such as `write_csv`.

They are imported when they are used: scipy.io and pyarrow take longer than all others together.
"""
_WIDE = (".parquet", ".csv")
_TABLES = (".mat", *_WIDE)
_TEXTS = (".txt", ".tsv", ".dat")
"""Tables as text, read as .csv is: the separator is looked for."""


def read_log(path: str | Path, topics: bool = False) -> FlightLog:
    """Read a log from a .mat, .mcap, .parquet, .csv or .ulg file. Raises LogError.

    With `topics`, a .ulg has a channel `TOPIC/FIELD` for each field of each topic as well.
    """
    suffix = _check(path)
    return _read(path, ".ulg_topics" if topics and suffix == ".ulg" else suffix)


def read_columns(path: str | Path, time: str = "", period: str | float = "") -> FlightLog:
    """Read a table (.csv, .txt, .tsv, .dat, .parquet), or the vectors of a .mat file, with time stamps [s] in `time`.

    Data without time stamps have a `period` instead: seconds from row to row, or the name of a number in the file. The
    other columns become channels under their own names; the bracket of a heading such as `speed [m/s]` is the unit.
    Raises LogError for another suffix, a missing column, and a file that is damaged or no table.
    """
    if bool(time) == bool(period):
        raise LogError("time stamps come from a column or from a period", str(path), "give one of --time and --period")
    suffix = Path(path).suffix.lower()
    if suffix in _TEXTS:
        suffix = ".csv"
    if suffix not in _TABLES:
        raise LogError(f"no table has the suffix {suffix!r:.40}", str(path), f"use {', '.join((*_TABLES, *_TEXTS))}")
    return _read(path, suffix, time, str(period))


def _read(path: str | Path, form: str, *clock: str) -> FlightLog:
    with naming_file(path):
        return log_of(*fence.read(_decoded, path, form, *clock, needs=_module(form)))


def attachments(path: str | Path) -> list[Attachment]:
    """Return the files kept in an MCAP recording. Raises LogError."""
    with naming_file(path):
        named, contents = fence.read(_attachments, path, needs=_MODULES[".mcap"])
    rows = zip(named, contents, strict=True)
    return [Attachment(name, media_type, data.tobytes(), time_ns) for (name, media_type, time_ns), data in rows]


def log_of(plain: dict[str, Any], arrays: Sequence[NDArray[Any]]) -> FlightLog:
    """Return the log whose parts `answer_of` returned. Raises LogError."""
    channels = {
        name: Channel(time, value, unit, tuple(fields), name)
        for (name, unit, fields), time, value in zip(plain["channels"], arrays[::2], arrays[1::2], strict=True)
    }
    return FlightLog(channels, plain["provenance"])


def answer_of(log: FlightLog) -> fence.Answer:
    """Return the parts of a log, JSON values and arrays, in which a reader behind the fence answers."""
    rows = [[name, channel.unit, channel.fields] for name, channel in log.channels.items()]
    arrays = [array for channel in log.channels.values() for array in (channel.time, channel.value)]
    return {"channels": rows, "provenance": log.provenance}, arrays


def _decoded(data: bytes, where: str, suffix: str, *clock: str) -> fence.Answer:
    """Decode a log; `clock` are a column of time stamps and a period. Runs behind the fence."""
    return answer_of(_function("decode", suffix)(data, where, *clock))


def _attachments(data: bytes, where: str) -> fence.Answer:
    """Return the attachments of a recording. Runs behind the fence."""
    found = importlib.import_module("twodof.flightlog.mcap_decoder").scan(data, where).attachments
    return [[one.name, one.media_type, one.time_ns] for one in found], [np.frombuffer(one.data, "u1") for one in found]


def write_log(log: FlightLog, path: str | Path, wide: bool = False, overwrite: bool = False) -> None:
    """Write a log to a .mat, .mcap, .parquet, .csv or .ulg file, atomically. Raises LogError, also if the file exists.

    A .ulg holds the signals of TOPICS; channels of other names are left out.

    `wide` writes a table (.parquet, .csv) with one row for each time stamp and a column for each signal, in place of
    one row for each number.
    """
    suffix = _check(path, wide)
    check_free(path, overwrite)
    write = _function("write", suffix)
    if wide:
        write(log, path, wide=True)
    elif suffix != ".ulg":
        write(log, path)
    else:
        # It writes new files only, and as it goes: beside its place.
        begun = partial_of(path)
        try:
            write(log, begun)
            begun.replace(Path(path).resolve())
        finally:
            begun.unlink(missing_ok=True)


def check_place(path: str | Path, overwrite: bool = False) -> None:
    """Raise LogError if `write_log` cannot write to `path`, for its suffix, its folder or an existing file."""
    _check(path)
    check_folder(path, overwrite)


def check_folder(path: str | Path, overwrite: bool = False) -> None:
    """Raise LogError if no file can be written to `path`; for checks before a long computation."""
    with refused_places(path):
        target = Path(path).resolve()
        if target.is_dir():
            raise LogError("is a directory", str(path), "name a file")
        if not target.parent.is_dir():
            raise LogError("its folder is not there", str(path), f"make it: mkdir -p {shlex.quote(str(target.parent))}")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise LogError("its folder may not be written", str(path), "choose another folder")
    check_free(path, overwrite)


def convert(src: str | Path, dst: str | Path, wide: bool = False, overwrite: bool = False) -> FlightLog:
    """Read `src` and write it as `dst` (see `write_log`); return the log.

    Raises LogError before anything is written.
    """
    _check(dst, wide)
    with suppress(OSError, ValueError):  # one of them is not there
        if Path(dst).samefile(src):
            raise LogError("would be written over itself", str(src), "name another file to write")
    check_free(dst, overwrite)
    log = read_log(src)
    write_log(log, dst, wide, overwrite)
    return log


def _function(verb: str, suffix: str) -> Callable[..., Any]:
    function: Callable[..., Any] = getattr(importlib.import_module(_module(suffix)), f"{verb}_{suffix[1:]}")
    return function


def _module(form: str) -> str:
    """Return the module of a suffix, or of a suffix with a kind of reading: ".ulg_topics"."""
    return _MODULES[form.partition("_")[0]]


def _check(path: str | Path, wide: bool = False) -> str:
    """Return the suffix of a name, which says the format. Raises LogError."""
    suffix = Path(path).suffix.lower()
    if suffix not in _MODULES:
        raise LogError(f"no log format has the suffix {suffix!r:.40}", str(path), f"use {', '.join(_MODULES)}")
    if wide and suffix not in _WIDE:
        what = f"{suffix} logs are not tables"
        raise LogError(what, str(path), f"write {', '.join(_WIDE)}, or leave the wide form out")
    return suffix


class _Pieces(RawIOBase):
    """End of a zip file that is sent as it is written."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []

    def write(self, piece: Any, /) -> int:
        self._pieces.append(bytes(piece))
        return len(self._pieces[-1])

    def take(self) -> bytes:
        taken, self._pieces = b"".join(self._pieces), []
        return taken


PIECE = 1 << 18
"""Bytes of a file in one piece of `zipped`."""


def zipped(files: Mapping[str, Path]) -> Iterator[bytes]:
    """Yield a zip file of `files` by their names in it, piece by piece. Most logs are compressed: nothing is here.

    Raises OSError for a file that cannot be read.
    """
    pieces = _Pieces()
    with ZipFile(pieces, "w") as archive:
        for name, path in files.items():
            with path.open("rb") as file, archive.open(ZipInfo.from_file(path, name), "w", force_zip64=True) as entry:
                while piece := file.read(PIECE):
                    entry.write(piece)
                    yield pieces.take()
    yield pieces.take()
