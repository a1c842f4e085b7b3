"""Flight logs as tables, for pandas, MATLAB, R, spreadsheets: Parquet and CSV.

Written is the tidy form, because every channel has its own time stamps: a row per number with the columns
`channel`, `field` (empty for a scalar), `time` [s] and `value`. Units and provenance travel as one line of
JSON: in Parquet's schema metadata, in CSV behind `#` in the first line. Both read back bit for bit.

Read is also the wide form that others write: a column `time` [s] and a column per channel, with a unit in
brackets (`theta [rad]`) if the name alone does not say it. An empty cell is no sample of its channel.
"""

import json
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.log import Channel, FlightLog
from twodof.signals import BY_MAT, unit_of

_META = "twodof.flightlog"
_VERSION = 1
_TIDY = ("channel", "field", "time", "value")
_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")

MAX_CELLS = 100_000_000
MAX_COLUMNS = 1000


def write_parquet(log: FlightLog, path: str | Path) -> None:
    """Writes a log as Parquet, atomically. Raises LogError."""
    table = _tidy(log).replace_schema_metadata({_META: _meta(log)})
    with atomic_write(path) as file:
        pq.write_table(table, file, write_page_checksum=True)


def write_csv(log: FlightLog, path: str | Path) -> None:
    """Writes a log as CSV, atomically. Raises LogError for a channel name with a quote or a line break."""
    table = _tidy(log)
    with atomic_write(path) as file:
        file.write(f"# {_META} {_meta(log)}\n".encode("ascii"))
        try:
            pa_csv.write_csv(table, file, pa_csv.WriteOptions(quoting_style="none"))
        except pa.ArrowInvalid as reason:
            raise LogError(f"a name cannot stand in CSV: {reason}", str(path), "rename the channel") from reason


def read_parquet(path: str | Path) -> FlightLog:
    """Reads a tidy or wide Parquet table. Raises LogError for what is no log, damaged or too large."""
    data = provenance.read_bytes(path)
    where = str(path)
    try:
        file = pq.ParquetFile(BytesIO(data), page_checksum_verification=True)
        _check_size(file.metadata.num_rows, file.metadata.num_columns, where)
        table = file.read()
        _check_names(table.column_names, where)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as reason:
        raise LogError(f"is no Parquet file or is damaged: {_line(reason)}", where, "write it again") from reason
    meta = (table.schema.metadata or {}).get(_META.encode())
    return _log(table, meta, provenance.of_file(path, data, "parquet"), where)


def read_csv(path: str | Path) -> FlightLog:
    """Reads a tidy or wide CSV table. Raises LogError for what is no log, damaged or too large."""
    data = provenance.read_bytes(path)
    where = str(path)
    comments, at, meta = 0, 0, None
    while data[at : at + 1] == b"#":
        end = data.find(b"\n", at) + 1 or len(data)
        if data[at:end].startswith(f"# {_META} ".encode()):
            meta = data[at + len(_META) + 3 : end]
        comments, at = comments + 1, end
    if meta is not None and not data.endswith(b"\n"):
        raise LogError("truncated: the last line has no end", where, "write it again")
    end = data.find(b"\n", at) + 1 or len(data)
    heading = data[at:end].decode("utf-8-sig", "replace").strip()
    names = [cell.strip().strip('"') for cell in heading.split(",")]
    _check_size(data.count(b"\n", end), len(names), where)
    _check_names(names, where)
    texts = {"channel": pa.string(), "field": pa.string()} if set(_TIDY) <= set(names) else {}
    try:
        table = pa_csv.read_csv(
            BytesIO(data),
            pa_csv.ReadOptions(skip_rows=comments + 1, column_names=names, use_threads=False),
            convert_options=pa_csv.ConvertOptions(
                column_types={name: texts.get(name, pa.float64()) for name in names},
                null_values=[""],
                strings_can_be_null=False,
            ),
        )
    except (pa.ArrowException, UnicodeDecodeError) as reason:
        raise LogError(
            f"is no table of numbers: {_line(reason)}", where, "give a header line and numbers below it"
        ) from reason
    return _log(table, meta, provenance.of_file(path, data, "csv"), where)


def _meta(log: FlightLog) -> str:
    rows = [
        {"name": name, "unit": channel.unit, "fields": list(channel.fields), "samples": len(channel)}
        for name, channel in log.channels.items()
    ]
    kept = json.loads(provenance.to_json(log))
    return json.dumps({"version": _VERSION, "channels": rows, "provenance": kept}, allow_nan=False)


def _tidy(log: FlightLog) -> pa.Table:
    names, fields, times, values = [], [], [], []
    for name, channel in log.channels.items():
        columns = [channel.value] if channel.value.ndim == 1 else list(channel.value.T)
        labels = channel.fields or (("",) if len(columns) == 1 else tuple(map(str, range(len(columns)))))
        for label, column in zip(labels, columns, strict=True):
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


def _log(table: pa.Table, meta: bytes | None, file: dict[str, Any], where: str) -> FlightLog:
    names = table.column_names
    described, kept = _described(meta, where)
    if set(_TIDY) <= set(names):
        channels = _from_tidy(table, described, where)
    elif "time" in {_split(name)[0] for name in names}:
        channels = _from_wide(table, where)
    else:
        raise LogError(
            f"no column 'time' among: {', '.join(names)[:200]}", where, "name the column of time stamps 'time'"
        )
    for name, row in described.items():
        count = len(channels[name]) if name in channels else 0
        if count != row["samples"]:
            raise LogError(
                f"truncated: {count} of {row['samples']} samples of {name!r} are there", where, "write it again"
            )
    return FlightLog(channels, {**kept, "file": file})


def _described(meta: bytes | None, where: str) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Rows of channels by name and the provenance, from the line of JSON; empty without one."""
    if meta is None:
        return {}, {}
    head = provenance.from_json(meta.decode("utf-8", "replace"), where)
    if head.get("version") != _VERSION:
        raise LogError(f"is of layout version {head.get('version')!r}, not {_VERSION}", where, "use a newer twodof")
    rows = head.get("channels")
    kept = head.get("provenance")
    if not isinstance(rows, list) or not isinstance(kept, dict) or not all(_is_row(row) for row in rows):
        raise LogError("its line of units and provenance is damaged", where, "write it again")
    return {row["name"]: row for row in rows}, kept


def _is_row(row: Any) -> bool:
    return (
        isinstance(row, dict)
        and isinstance(row.get("name"), str)
        and isinstance(row.get("unit"), str)
        and isinstance(row.get("samples"), int)
        and isinstance(row.get("fields"), list)
        and all(isinstance(field, str) for field in row["fields"])
    )


def _from_tidy(table: pa.Table, described: Mapping[str, dict[str, Any]], where: str) -> dict[str, Channel]:
    time, value = _stamps(table, "time", where), _numbers(table, "value", where)
    channel_code, channel_names = _codes(table, "channel", where)
    field_code, field_names = _codes(table, "field", where)
    found = {}
    for name in dict.fromkeys([*described, *channel_names]):
        code = channel_names.index(name) if name in channel_names else -1
        rows = np.flatnonzero(channel_code == code)
        codes = list(dict.fromkeys(field_code[rows].tolist()))
        columns = {field_names[one]: rows[field_code[rows] == one] for one in codes}
        unit, fields = _unit_and_fields(name, set(columns), described)
        chosen = [columns.pop(label, rows[:0]) for label in fields or tuple(columns) or ("",)]
        stamps = time[chosen[0]]
        if columns or any(not np.array_equal(time[one], stamps) for one in chosen):
            raise LogError(f"the fields of {name!r} differ in their time stamps", where, "write it again")
        values = np.column_stack([value[one] for one in chosen])
        found[name] = Channel(stamps, values, unit, fields, f"{where}: {name}")
    return found


def _unit_and_fields(
    name: str, labels: set[str], described: Mapping[str, dict[str, Any]]
) -> tuple[str, tuple[str, ...]]:
    """From the line of JSON, else from TOPICS, else none."""
    if name in described:
        return described[name]["unit"], tuple(described[name]["fields"])
    known = BY_MAT[name].fields if name in BY_MAT else ()
    return unit_of(name), known if set(known) == labels else ()


def _from_wide(table: pa.Table, where: str) -> dict[str, Channel]:
    heads = {column: _split(column) for column in table.column_names}
    stamp = next(column for column, (name, _) in heads.items() if name == "time")
    time = _stamps(table, stamp, where)
    found = {}
    for column, (name, unit) in heads.items():
        if column == stamp or not name:
            continue
        if name in found:
            raise LogError(f"two columns are called {name!r}", where, "rename one")
        value = _numbers(table, column, where, nulls=True)
        there = np.asarray(table.column(column).is_valid())
        found[name] = Channel(time[there], value[there], unit or unit_of(name), (), f"{where}: {name}")
    if not found:
        raise LogError("no column beside 'time'", where, "give a column per channel")
    return found


def _stamps(table: pa.Table, column: str, where: str) -> NDArray[np.float64]:
    """Time stamps, checked before they are compared: NaN differs from itself."""
    time = _numbers(table, column, where)
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        k = int(bad[0])
        raise LogError(
            f"the time stamp is {time[k]!s} in row {k + 1} below the header, {bad.size} such in all",
            f"{where}: {column}",
            "give these rows a time or remove them; of a channel with fields, all rows of that time",
        )
    return time


def _numbers(table: pa.Table, column: str, where: str, nulls: bool = False) -> NDArray[np.float64]:
    cells = table.column(column)
    if cells.null_count and not nulls:
        raise LogError(f"{cells.null_count} empty cells in column {column!r}", where, "fill or remove the rows")
    try:
        return np.asarray(cells.cast(pa.float64()).to_numpy(), dtype=np.float64)
    except (pa.ArrowException, TypeError) as reason:
        raise LogError(f"column {column!r} is not of numbers: {_line(reason)}", where) from reason


def _codes(table: pa.Table, column: str, where: str) -> tuple[NDArray[np.intp], list[str]]:
    cells = table.column(column)
    if cells.null_count:
        raise LogError(f"{cells.null_count} empty cells in column {column!r}", where, "write it again")
    try:
        coded = cells.cast(pa.string()).combine_chunks().dictionary_encode()
        names = coded.dictionary[: MAX_COLUMNS + 1].to_pylist()
    except (pa.ArrowException, UnicodeDecodeError) as reason:
        raise LogError(f"column {column!r} is not of names: {_line(reason)}", where) from reason
    if len(names) > MAX_COLUMNS:
        raise LogError(f"more than {MAX_COLUMNS} names in column {column!r}", where, "this is no flight log")
    return np.asarray(coded.indices, dtype=np.intp), names


def _split(heading: str) -> tuple[str, str]:
    """Name and unit of a column's heading, such as `theta [rad]`."""
    match = _HEADING.fullmatch(heading)
    return (match["name"], match["unit"] or "") if match else (heading, "")


def _check_names(names: Sequence[str], where: str) -> None:
    if len(set(names)) != len(names):
        raise LogError(f"two columns have one name: {', '.join(names)[:200]}", where, "rename one")


def _check_size(rows: int, columns: int, where: str) -> None:
    if columns > MAX_COLUMNS or rows * columns > MAX_CELLS:
        raise LogError(f"{rows} rows of {columns} columns", where, f"at most {MAX_CELLS} cells are read")


def _line(reason: BaseException) -> str:
    return str(reason).splitlines()[0][:200] if str(reason) else type(reason).__name__
