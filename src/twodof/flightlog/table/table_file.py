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
from twodof.flightlog.log import MAX_NAME, Channel, FlightLog
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.table.parquet_check import check_pages
from twodof.signals import BY_MAT, unit_of

_META = "twodof.flightlog"
_VERSION = 1
_TIDY = ("channel", "field", "time", "value")
# The table, the columns and codes that are made of it, and what is sorted; of a tidy one its channels too.
_CELL_BYTES = 40
_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")

MAX_COLUMNS = 1000
MAX_COMMENTS = 1000


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
    budget = MemoryBudget(len(data), where)
    try:
        heads = pq.read_metadata(BytesIO(data))
        # Names as a dictionary: a long one that is repeated is there once.
        names = [name for name in _TIDY[:2] if name in heads.schema.names]
        file = pq.ParquetFile(BytesIO(data), metadata=heads, page_checksum_verification=True, read_dictionary=names)
        _check_size(file.metadata.num_rows, file.metadata.num_columns, where, budget)
        check_pages(file, data, where, budget)
        table = file.read(use_threads=False)
        _check_names(table.column_names, where)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as reason:
        raise LogError(f"is no Parquet file or is damaged: {_line(reason)}", where, "write it again") from reason
    meta = (table.schema.metadata or {}).get(_META.encode())
    return _log(table, meta, provenance.of_file(path, data, "parquet"), where, budget)


def read_csv(path: str | Path) -> FlightLog:
    """Reads a tidy or wide CSV table. Raises LogError for what is no log, damaged or too large."""
    data = provenance.read_bytes(path)
    where = str(path)
    budget = MemoryBudget(len(data), where)
    comments, at, meta = 0, 0, None
    while data[at : at + 1] == b"#":
        end = data.find(b"\n", at) + 1 or len(data)
        if data[at:end].startswith(f"# {_META} ".encode()):
            meta = data[at + len(_META) + 3 : end]
        comments, at = comments + 1, end
        if comments > MAX_COMMENTS:
            raise LogError(f"more than {MAX_COMMENTS} lines of comments", where, "remove them")
    if meta is not None and not data.endswith(b"\n"):
        raise LogError("truncated: the last line has no end", where, "write it again")
    end = data.find(b"\n", at) + 1 or len(data)
    if data.count(b",", at, end) >= MAX_COLUMNS:
        raise LogError(f"more than {MAX_COLUMNS} columns", where, "this is not a flight log")
    heading = data[at:end].decode("utf-8-sig", "replace").strip()
    names = [cell.strip().strip('"') for cell in heading.split(",")]
    _check_size(data.count(b"\n", end) + data.count(b"\r", end) + 1, len(names), where, budget)
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
    return _log(table, meta, provenance.of_file(path, data, "csv"), where, budget)


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


def _log(table: pa.Table, meta: bytes | None, file: dict[str, Any], where: str, budget: MemoryBudget) -> FlightLog:
    names = table.column_names
    described, kept = _described(meta, where, budget)
    if set(_TIDY) <= set(names):
        channels = _from_tidy(table, described, where)
    elif "time" in {_split(name)[0] for name in names}:
        channels = _from_wide(table, where, budget)
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


def _described(
    meta: bytes | None, where: str, budget: MemoryBudget
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Rows of channels by name and the provenance, from the line of JSON; empty without one."""
    if meta is None:
        return {}, {}
    head = provenance.from_json(meta.decode("utf-8", "replace"), where, budget)
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
    of_channel = dict(zip(channel_names, _groups(channel_code, len(channel_names)), strict=True))
    for name in dict.fromkeys([*described, *channel_names]):
        rows = of_channel.get(name, np.empty(0, np.intp))
        of_field = zip(field_names, _groups(field_code[rows], len(field_names)), strict=True)
        columns = {label: rows[at] for label, at in sorted(of_field, key=_first) if at.size}
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


def _from_wide(table: pa.Table, where: str, budget: MemoryBudget) -> dict[str, Channel]:
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
        budget.samples(int(there.sum()))
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
        coded = _dictionary(cells)
        names = [str(name)[: MAX_NAME + 1] for name in coded.dictionary[: MAX_COLUMNS + 1].to_pylist()]
    except (pa.ArrowException, UnicodeDecodeError) as reason:
        raise LogError(f"column {column!r} is not of names: {_line(reason)}", where) from reason
    if len(names) > MAX_COLUMNS or len(set(names)) < len(names):
        raise LogError(f"more than {MAX_COLUMNS} names in column {column!r}", where, "this is not a flight log")
    return np.asarray(coded.indices, dtype=np.intp), names


def _dictionary(cells: pa.ChunkedArray) -> pa.DictionaryArray:
    """Names as codes and the names, each once."""
    if pa.types.is_dictionary(cells.type):
        return pa.chunked_array(cells.unify_dictionaries().chunks, cells.type).combine_chunks()
    return cells.cast(pa.string()).combine_chunks().dictionary_encode()


def _groups(codes: NDArray[np.intp], count: int) -> list[NDArray[np.intp]]:
    """For each code from 0 to `count` - 1 the places where it stands, in order."""
    order = np.argsort(codes, kind="stable")
    return np.split(order, np.searchsorted(codes[order], np.arange(1, count))) if count else []


def _first(field: tuple[str, NDArray[np.intp]]) -> int:
    return int(field[1][0]) if field[1].size else -1


def _split(heading: str) -> tuple[str, str]:
    """Name and unit of a column's heading, such as `theta [rad]`."""
    match = _HEADING.fullmatch(heading)
    return (match["name"], match["unit"] or "") if match else (heading, "")


def _check_names(names: Sequence[str], where: str) -> None:
    if len(set(names)) != len(names):
        raise LogError(f"two columns have one name: {', '.join(names)[:200]}", where, "rename one")


def _check_size(rows: int, columns: int, where: str, budget: MemoryBudget) -> None:
    if columns > MAX_COLUMNS:
        raise LogError(f"{columns} columns", where, f"at most {MAX_COLUMNS} are read")
    budget.take(_CELL_BYTES * rows * columns)


def _line(reason: BaseException) -> str:
    return str(reason).splitlines()[0][:200] if str(reason) else type(reason).__name__
