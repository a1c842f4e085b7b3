"""Flight logs as tables, for pandas, MATLAB, R, spreadsheets: Parquet and CSV.

Two forms are written and read. The *long* (tidy) form is the default, because every channel has its own time stamps. It
has a row for each number, with the columns `channel`, `field` (empty for a scalar), `time` and `value`. The *wide*
form, common among other programs, has a row for each time stamp. Its first column is `time [s]`. The other columns are
named after channel and unit, `theta [rad]`, or `gyr.y [rad/s]` for a channel with fields. An empty cell means that the
channel has no sample at that time.

Units and provenance travel as one line of JSON: in Parquet's schema metadata, in CSV behind `#` in the first line. Both
forms read back bit for bit.

Wide CSV of other programs may have semicolons or tabs between its columns, with decimal commas, a line of units below
the heading, comments above it, and text in UTF-16. Time stamps may be dates, or in the unit that their heading names.
"""

import codecs
import csv
import json
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc  # pyarrow would import it at the first cast: here once, not in each child of the fence
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.log import Channel, FlightLog, row_times
from twodof.flightlog.provenance import SEPARATORS, separator_of, text_of
from twodof.signals import BY_MAT, unit_of

COLUMNS = ("channel", "field", "time", "value")
"""The columns of the long form."""
TIME = "time [s]"
TIME_COLUMN = "time"
"""Name of the column of time stamps, without its unit, unless the caller gives another name."""
MAX_COLUMNS = 1000

_META = "twodof.flightlog"
_MARK = f"# {_META} ".encode()
_VERSION = 1
_NUMBER = re.compile(r"[-+]?[\d.,]*\d[-+\d.,:/TZeE ]*|nan|inf", re.IGNORECASE)
"""A number or a date in a cell of CSV."""
_DECIMAL_COMMA = re.compile(r" *[-+]?\d*,\d+(?:[eE][-+]?\d+)? *")
_NO_NUMBER = re.compile(
    r"In CSV column #(?P<column>\d+): Row #(?P<row>\d+): .*conversion error to double: invalid value '(?P<cell>.*)'"
)
_MISSING = ("", "NA", "N/A", "#N/A", "null", "NULL", "None", "-")
"""Cells without a number, as other programs write them."""
_NAN = ("nan", "NaN", "NAN")
"""The same in a wide table of another program, as MATLAB's `writetable`: in ours and in long ones they are damage."""
_PER_SECOND = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e3),
    **dict.fromkeys(("us", "usec", "microseconds", "\u00b5s", "\u03bcs"), 1e6),
    "ns": 1e9,
}
"""How many of a unit of time, as a heading names it, are a second."""
_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)(?:\s*\[(?P<unit>[^\[\]]*)\]|\s+\((?P<round>[^()]*)\))?\s*")


def write_parquet(log: FlightLog, path: str | Path, wide: bool = False) -> None:
    """Write a log as Parquet, in the long or the wide form, atomically. Raises LogError."""
    table, meta = _described_table(log, wide)
    table = table.replace_schema_metadata({_META: meta})
    with atomic_write(path) as file:
        pq.write_table(table, file, write_page_checksum=True)


def write_csv(log: FlightLog, path: str | Path, wide: bool = False) -> None:
    """Write a log as CSV, in the long or the wide form, atomically.

    Raises LogError for a name with a quote, a comma or a line break.
    """
    table, meta = _described_table(log, wide)
    labels = (label for name, channel in log.channels.items() for label in (name, *channel.fields))
    odd = [name for name in (table.column_names if wide else labels) if any(letter in name for letter in ',"\r\n')]
    if odd:
        raise LogError(f"a name cannot stand in CSV: {odd[0]!r:.80}", str(path), "rename the channel")
    with atomic_write(path) as file:
        file.write(f"# {_META} {meta}\n".encode("ascii"))
        pa_csv.write_csv(table, file, pa_csv.WriteOptions(quoting_style="none"))


def decode_parquet(data: bytes, where: str, time: str = TIME_COLUMN, period: str = "") -> FlightLog:
    """Return the log in a long or wide Parquet table; the column `time` of a wide one holds the time stamps [s].

    With a `period`, a number of seconds or the name of a constant column, its rows follow each other so.
    Raises LogError for a file that is not a log or is damaged.
    """
    heads = pq.read_metadata(BytesIO(data))
    # Names as a dictionary: a long name that is repeated is there once.
    names = [name for name in COLUMNS[:2] if name in heads.schema.names]
    _check_names(heads.schema.names, where)
    file = pq.ParquetFile(BytesIO(data), metadata=heads, page_checksum_verification=True, read_dictionary=names)
    table = file.read(use_threads=False)
    meta = (table.schema.metadata or {}).get(_META.encode())
    return _log(table, meta, provenance.of_file(where, data, "parquet"), where, time, period)


def decode_csv(data: bytes, where: str, time: str = TIME_COLUMN, period: str = "") -> FlightLog:
    """Return the log in a long or wide CSV table; `time` and `period` as in `decode_parquet`.

    Raises LogError for a file that is not a log or is damaged.
    """
    file = provenance.of_file(where, data, "csv")
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            data = text_of(data).encode()
        except UnicodeError as reason:
            raise LogError("is not text in UTF-16", where, "save it as CSV in UTF-8") from reason
    data = data.removeprefix(codecs.BOM_UTF8)
    if b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    names, separator, start, meta = _heading(data, where)
    _check_names(names, where)
    words: list[str] = []
    if meta is not None or _is_long(names):
        # As dictionaries: a name that is repeated is there once.
        texts = dict.fromkeys(COLUMNS[:2], pa.dictionary(pa.int32(), pa.string())) if _is_long(names) else {}
        table = _parsed(data, start, names, separator, texts, where, _MISSING)
    else:
        stamps = [name for name in names if not period and _is_time(name, time)]
        table, words = _without_words(data, start, names, separator, stamps, where)
    return _log(table, meta, file, where, time, period, words)


def _parsed(
    data: bytes,
    start: int,
    names: list[str],
    separator: str,
    types: Mapping[str, pa.DataType | None],
    where: str,
    missing: Sequence[str],
    decimal: str = ".",
) -> pa.Table:
    """Return the rows from byte `start` on: float64, except `types`, where None lets pyarrow find the type.

    They are read with a decimal comma once a cell asks for it; a comma in a note does not.
    """
    try:
        return pa_csv.read_csv(
            pa.BufferReader(pa.py_buffer(data)[start:]),
            pa_csv.ReadOptions(column_names=names, use_threads=False),
            pa_csv.ParseOptions(delimiter=separator),
            pa_csv.ConvertOptions(
                column_types={n: kind for n in names if (kind := types.get(n, pa.float64())) is not None},
                null_values=list(missing),
                strings_can_be_null=False,
                decimal_point=decimal,
            ),
        )
    except (pa.ArrowException, UnicodeDecodeError) as reason:
        found = _NO_NUMBER.search(str(reason))
        if decimal == "." and separator != "," and found and _DECIMAL_COMMA.fullmatch(found["cell"]):
            return _parsed(data, start, names, separator, types, where, missing, ",")
        what = f"is not a table of numbers: {str(reason).partition(chr(10))[0]:.200}"
        remedy = (
            "give a header line and below it numbers, without separators of thousands: columns between commas, or "
            "between semicolons or tabs, where a comma may be the decimal mark"
        )
        raise LogError(what, where, remedy) from reason


def _without_words(
    data: bytes, start: int, names: list[str], separator: str, stamps: list[str], where: str
) -> tuple[pa.Table, list[str]]:
    """Return the rows without columns of words, and the first word of each. The columns `stamps` may hold dates."""
    types: dict[str, pa.DataType | None] = {}
    words: dict[str, str] = {}
    while True:
        try:
            rows = _parsed(data, start, names, separator, types, where, (*_MISSING, *_NAN))
            table = rows.drop_columns(list(words))
            return table, [f"{name} ({first})" for name, first in words.items()]
        except LogError as error:
            found = _NO_NUMBER.search(error.what)
            name = names[int(found["column"])] if found else ""
            if found and name in stamps and name not in types:
                types[name] = None
            elif found and name not in types and found["cell"][:1].isalpha() and len(words) + 2 < len(names):
                types[name] = pa.string()
                words[name] = f"words, {found['cell']!r:.40} in row {found['row']}"
            else:
                raise


def _heading(data: bytes, where: str) -> tuple[list[str], str, int, bytes | None]:
    """Return names of columns, their separator, the byte at which the rows begin, and the line of JSON if there is one.

    Comments (# or %), empty lines and Excel's `sep=;` may stand above the names, a line of units below them.
    """
    end, row, separator, meta = 0, b"", "", None
    while end < len(data) and (not row or row[:1] in b"#%" or row.startswith(b"sep=")):
        at, end = end, data.find(b"\n", end) + 1 or len(data)
        row = data[at:end].strip()
        if row.startswith(b"sep="):
            separator = row[4:].decode("ascii", "replace") or "\t"
        elif row.startswith(_MARK):
            meta = data[at + len(_META) + 3 : end]
    line = row.decode("utf-8", "replace")
    if meta is not None and not data.endswith(b"\n"):
        raise LogError("truncated: the last line has no end", where, "write it again")
    separator = separator if separator and separator in SEPARATORS else separator_of(line)
    names = _cells(line, separator)
    after = data.find(b"\n", end) + 1 or len(data)
    units = _cells(data[end:after].decode("utf-8", "replace"), separator)
    if meta is None and len(units) == len(names) and any(units) and not any(map(_NUMBER.fullmatch, units)):
        if not _is_long(names):
            names = [
                f"{name} [{unit.strip('[]()')}]" if unit else name for name, unit in zip(names, units, strict=True)
            ]
            end = after
    return names, separator, end, meta


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line of CSV."""
    cells = next(csv.reader([line.strip("\r\n")], delimiter=separator, skipinitialspace=True), [])
    return [cell.strip() for cell in cells] or [""]


def _is_time(column: str, time: str) -> bool:
    return time in (column, _name_and_unit(column)[0])


def _log(
    table: pa.Table,
    meta: bytes | None,
    file: dict[str, Any],
    where: str,
    time: str,
    period: str,
    words: Sequence[str] = (),
) -> FlightLog:
    names = table.column_names
    described, kept = _described(meta, where)
    if _is_long(names):
        channels = _channels_of_long(table, described, where)
    elif period:
        stamps = row_times(len(table), period, lambda name: _constant(table, name, where), where)
        channels = _channels_of_wide(table, described, where, stamps, "")
    elif stamp := next((name for name in names if _is_time(name, time)), ""):
        channels = _channels_of_wide(table, described, where, _times(table, stamp, where), stamp)
    else:
        what = f"no column {time!r:.80} among: {', '.join(names)[:200]}"
        remedy = "call the column of time stamps 'time', or name it: --time COLUMN; without one: --period SECONDS"
        headless = all(map(_NUMBER.fullmatch, names))
        raise LogError(what, where, "write the names of the columns above the numbers" if headless else remedy)
    for name, row in described.items():
        count = len(channels[name]) if name in channels else 0
        if count != row["samples"]:
            what = f"truncated: {count} of {row['samples']} samples of {name!r} are there"
            raise LogError(what, where, "write it again")
    ignored = {"ignored": words} if words else {}
    return FlightLog(channels, {**kept, **ignored, "file": file})


def _described_table(log: FlightLog, wide: bool) -> tuple[pa.Table, str]:
    """Return the table and the line of JSON that goes with it."""
    rows: list[dict[str, Any]] = [
        {"name": name, "unit": channel.unit, "fields": list(channel.fields), "samples": len(channel)}
        for name, channel in log.channels.items()
    ]
    for row in rows if wide else ():
        row["columns"] = _headings(row["name"], log[row["name"]])
    kept = json.loads(provenance.to_json(log))
    meta = json.dumps({"version": _VERSION, "channels": rows, "provenance": kept}, allow_nan=False)
    return _wide_table(log) if wide else _long_table(log), meta


def _described(meta: bytes | None, where: str) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Return rows of channels by name and the provenance, from the line of JSON; empty without one."""
    if meta is None:
        return {}, {}
    head = provenance.from_json(meta.decode("utf-8", "replace"), where)
    if head.get("version") != _VERSION:
        raise LogError(f"has the layout version {head.get('version')!r}, not {_VERSION}", where, "use a newer twodof")
    match head:
        case {"channels": list(rows), "provenance": dict(kept)} if all(map(_is_row, rows)):
            return {row["name"]: row for row in rows}, kept
    remedy = "write it again; a CSV file can be read without that line"
    raise LogError("its line of units and provenance is damaged", where, remedy)


def _is_row(row: object) -> bool:
    """Return True for a channel's row in the line of JSON."""
    match row:
        case {"name": str(), "unit": str(), "samples": int(), "fields": list(fields), **more}:
            columns = more.get("columns", [])
            return isinstance(columns, list) and all(isinstance(one, str) for one in (*fields, *columns))
    return False


def _is_long(names: Sequence[str]) -> bool:
    return set(COLUMNS) <= set(names)


def _check_names(names: Sequence[str], where: str) -> None:
    if len(names) > MAX_COLUMNS:
        raise LogError(f"more than {MAX_COLUMNS} columns", where, "this is not a flight log: give another file")
    if len(set(names)) != len(names):
        raise LogError(f"two columns have one name: {', '.join(names)[:200]}", where, "rename one of them")


def _long_table(log: FlightLog) -> pa.Table:
    names, fields, times, values = [], [], [], []
    for name, channel in log.channels.items():
        columns = [channel.value] if channel.value.ndim == 1 else list(channel.value.T)
        for label, column in zip(_labels(channel), columns, strict=True):
            names.append(pa.repeat(pa.scalar(name), len(column)))
            fields.append(pa.repeat(pa.scalar(label), len(column)))
            times.append(channel.time)
            values.append(np.ascontiguousarray(column))
    return pa.table(
        {
            "channel": pa.chunked_array(names, pa.string()),
            "field": pa.chunked_array(fields, pa.string()),
            "time": np.concatenate(times),
            "value": np.concatenate(values),
        }
    ).combine_chunks()


def _channels_of_long(table: pa.Table, described: Mapping[str, dict[str, Any]], where: str) -> dict[str, Channel]:
    """Return the channels of a long table, rows in any order; units and fields as described, else from TOPICS."""
    time, value = _numbers(table, "time", where), _numbers(table, "value", where)
    channel_code, channel_names = _codes(table, "channel", where)
    field_code, field_names = _codes(table, "field", where)
    group = channel_code * len(field_names) + field_code
    order = np.argsort(group, kind="stable")
    rows_of: dict[str, dict[str, NDArray[np.intp]]] = {name: {} for name in (*described, *channel_names)}
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        if rows.size:
            rows_of[channel_names[channel_code[rows[0]]]][field_names[field_code[rows[0]]]] = rows
    found = {}
    for name, of_field in rows_of.items():
        columns = dict(sorted(of_field.items(), key=lambda item: int(item[1][0])))
        unit, fields = _unit_and_fields(name, set(columns), described)
        chosen = [columns.pop(label, order[:0]) for label in fields or tuple(columns) or ("",)]
        shared = time[chosen[0]]
        if columns or any(not np.array_equal(time[one], shared, equal_nan=True) for one in chosen):
            raise LogError(f"the fields of {name!r} differ in their time stamps", where, "write it again")
        values = np.column_stack([value[one] for one in chosen])
        found[name] = Channel(shared, values, unit, fields, f"{where}: {name}")
    return found


def _unit_and_fields(
    name: str, labels: set[str], described: Mapping[str, dict[str, Any]]
) -> tuple[str, tuple[str, ...]]:
    if name in described:
        return described[name]["unit"], tuple(described[name]["fields"])
    known = BY_MAT[name].fields if name in BY_MAT else ()
    return unit_of(name), known if set(known) == labels else ()


def _codes(table: pa.Table, column: str, where: str) -> tuple[NDArray[np.intp], list[str]]:
    """Return a column of names as codes, and the names, each once. Raises LogError for an empty cell."""
    cells = table.column(column)
    if cells.null_count:
        raise LogError(f"{cells.null_count} empty cells in column {column!r}", where, "write it again")
    if not pa.types.is_dictionary(cells.type):
        cells = cells.cast(pa.string()).dictionary_encode()
    coded = pa.chunked_array(cells.unify_dictionaries().chunks, cells.type).combine_chunks()
    return np.asarray(coded.indices, dtype=np.intp), coded.dictionary.to_pylist()


def _headings(name: str, channel: Channel) -> list[str]:
    """Return the names of a channel's columns in the wide form."""
    unit = f" [{channel.unit}]" if channel.unit else ""
    return [f"{name}.{label}{unit}" if label else f"{name}{unit}" for label in _labels(channel)]


def _labels(channel: Channel) -> tuple[str, ...]:
    """Return a label for each column of a channel: its field, else its number, "" for a scalar."""
    width = 1 if channel.value.ndim == 1 else channel.value.shape[1]
    return channel.fields or (("",) if width == 1 else tuple(map(str, range(width))))


def _wide_table(log: FlightLog) -> pa.Table:
    """Return the table of a log, in order of time. Raises LogError for two columns of one name."""
    time = np.unique(np.concatenate([channel.time for channel in log.channels.values()]))
    columns: dict[str, Any] = {TIME: time}
    for name, channel in log.channels.items():
        at = np.searchsorted(time, channel.time)
        empty = np.ones(len(time), dtype=bool)
        empty[at] = False
        values = channel.value if channel.value.ndim == 2 else channel.value[:, None]
        for heading, value in zip(_headings(name, channel), values.T, strict=True):
            if heading in columns:
                raise LogError(f"two columns would be called {heading!r}", log.source, "rename a channel or a field")
            cells = np.zeros(len(time))
            cells[at] = value
            columns[heading] = pa.array(cells, mask=empty)
    return pa.table(columns)


def _times(table: pa.Table, stamp: str, where: str) -> NDArray[np.float64]:
    """Return the time stamps (n,) [s] of a column; those of dates and times of day begin at 0. Raises LogError."""
    cells = table.column(stamp)
    kind = cells.type
    if pa.types.is_string(kind):
        remedy = "write seconds with one decimal mark, or dates as 2026-01-31T12:00:00.000"
        raise LogError(f"the time stamps in column {stamp!r:.80} are {cells[0].as_py()!r:.40}", where, remedy)
    if pa.types.is_temporal(kind) and not cells.null_count:
        exact = pa.time64("ns") if pa.types.is_time(kind) else pa.timestamp("ns", getattr(kind, "tz", None))
        counted = cells.cast(exact).cast(pa.int64()).to_numpy()
        return np.asarray((counted - counted[:1]) / 1e9, dtype=np.float64)
    name, unit = _name_and_unit(stamp)
    unit = unit or name.rpartition("_")[2] * name.endswith(("_ms", "_us", "_ns"))
    if unit.lower() not in _PER_SECOND:
        raise LogError(f"the time stamps are in {unit!r:.40}", where, "write seconds, or name ms, us or ns")
    return _numbers(table, stamp, where) / _PER_SECOND[unit.lower()]


def _constant(table: pa.Table, name: str, where: str) -> float:
    """Return the number in all rows of a column. Raises LogError."""
    column = next((one for one in table.column_names if _is_time(one, name)), "")
    values = np.unique(_numbers(table, column, where, nulls=True)) if column else np.empty(0)
    values = values[np.isfinite(values)]
    if values.size != 1:
        what = f"column {name!r:.80} has {values.size} different values" if column else f"no column {name!r:.80}"
        raise LogError(what, where, "give seconds, as --period 0.02")
    return float(values[0])


def _channels_of_wide(
    table: pa.Table, described: Mapping[str, dict[str, Any]], where: str, time: NDArray[np.float64], stamp: str
) -> dict[str, Channel]:
    """Return the channels of a wide table by their described columns; each further column is a channel of its own.

    `time` are the times of its rows, from the column `stamp` ("" if there is none).
    """
    found = {}
    taken = {stamp}
    for name, row in described.items():
        columns = row.get("columns", [])
        missing = [column for column in columns if column not in table.column_names]
        if missing or not columns:
            raise LogError(f"column {[*missing, name][0]!r} is missing", where, "write the table again")
        found[name] = _channel(table, columns, time, (row["unit"], tuple(row["fields"])), f"{where}: {name}")
        taken.update(columns)
    for column in table.column_names:
        name, unit = _name_and_unit(column)
        if column in taken or not name:
            continue
        if name in found:
            raise LogError(f"two columns are called {name!r}", where, "rename one of them")
        found[name] = _channel(table, [column], time, (unit or unit_of(name), ()), f"{where}: {name}")
    if not found:
        raise LogError("the table has only the column of the time", where, "give a column for each channel")
    return found


def _channel(
    table: pa.Table,
    columns: list[str],
    time: NDArray[np.float64],
    unit_and_fields: tuple[str, tuple[str, ...]],
    where: str,
) -> Channel:
    there = np.asarray(table.column(columns[0]).is_valid())
    if any(not np.array_equal(there, np.asarray(table.column(column).is_valid())) for column in columns[1:]):
        raise LogError("a row has only some of its fields", where, "fill all its fields in the row, or leave all empty")
    values = [_numbers(table, column, where, nulls=True)[there] for column in columns]
    unit, fields = unit_and_fields
    return Channel(time[there], np.column_stack(values), unit, fields, where)


def _name_and_unit(heading: str) -> tuple[str, str]:
    """Return name and unit of a column's heading, such as `theta [rad]` or `theta (rad)`."""
    match = _HEADING.fullmatch(heading)
    return (match["name"], match["unit"] or match["round"] or "") if match else (heading, "")


def _numbers(table: pa.Table, column: str, where: str, nulls: bool = False) -> NDArray[np.float64]:
    """Return a column of numbers, NaN for an empty cell where `nulls` allows one. Raises LogError."""
    cells = table.column(column)
    if cells.null_count and not nulls:
        raise LogError(f"{cells.null_count} empty cells in column {column!r}", where, "fill or remove the rows")
    try:
        return np.asarray(pc.cast(cells, pa.float64()).to_numpy(), dtype=np.float64)
    except pa.ArrowException as reason:
        what = f"column {column!r} holds something other than numbers: {reason!s:.200}"
        raise LogError(what, where, "remove the column, or write numbers only") from reason
