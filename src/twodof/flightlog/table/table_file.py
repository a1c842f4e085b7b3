"""Flight logs as tables, for pandas, MATLAB, R, spreadsheets: Parquet and CSV.

Two forms are written and read: the long one (`long_table`), which is the default, and the wide one (`wide_table`),
which others write too. Units and provenance travel as one line of JSON: in Parquet's schema metadata, in CSV behind `#`
in the first line. Both forms read back bit for bit.
"""

import json
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.log import FlightLog
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.table.cells import first_line
from twodof.flightlog.table.long_table import COLUMNS, channels_of_long, long_table
from twodof.flightlog.table.parquet_check import check_pages
from twodof.flightlog.table.wide_table import TIME_COLUMN, channels_of_wide, headings, is_wide, wide_table

_META = "twodof.flightlog"
_VERSION = 1
# What a cell costs. Of a long table: it, the columns and codes made of it, what is sorted, and its channels. Of a wide
# one: it and one column; its channels are charged when they are made.
_LONG_CELL_BYTES, _WIDE_CELL_BYTES = 40, 24

MAX_COLUMNS = 1000
MAX_COMMENTS = 1000


def write_parquet(log: FlightLog, path: str | Path, wide: bool = False) -> None:
    """Writes a log as Parquet, in the long or the wide form, atomically. Raises LogError."""
    table, meta = _described_table(log, wide)
    table = table.replace_schema_metadata({_META: meta})
    with atomic_write(path) as file:
        pq.write_table(table, file, write_page_checksum=True)


def write_csv(log: FlightLog, path: str | Path, wide: bool = False) -> None:
    """Writes a log as CSV, in the long or the wide form, atomically.

    Raises LogError for a name with a quote, a comma or a line break.
    """
    table, meta = _described_table(log, wide)
    odd = [name for name in table.column_names if any(letter in name for letter in ',"\r\n')]
    if odd:
        raise LogError(f"{odd[0]!r:.80} cannot head a column of CSV", str(path), "rename the channel")
    with atomic_write(path) as file:
        file.write(f"# {_META} {meta}\n".encode("ascii"))
        try:
            pa_csv.write_csv(table, file, pa_csv.WriteOptions(quoting_style="none"))
        except pa.ArrowInvalid as reason:
            raise LogError(f"a name cannot stand in CSV: {reason}", str(path), "rename the channel") from reason


def read_parquet(path: str | Path, time: str = TIME_COLUMN) -> FlightLog:
    """Reads a long or wide Parquet table; the column `time` of a wide one holds the time stamps [s].

    Raises LogError for a file that is not a log, is damaged or too large.
    """
    data = provenance.read_bytes(path)
    where = str(path)
    budget = MemoryBudget(len(data), where)
    try:
        heads = pq.read_metadata(BytesIO(data))
        # Names as a dictionary: a long one that is repeated is there once.
        names = [name for name in COLUMNS[:2] if name in heads.schema.names]
        file = pq.ParquetFile(BytesIO(data), metadata=heads, page_checksum_verification=True, read_dictionary=names)
        _check_size(file.metadata.num_rows, heads.schema.names, where, budget)
        check_pages(file, data, where, budget)
        table = file.read(use_threads=False)
        _check_names(table.column_names, where)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as reason:
        raise LogError(f"is no Parquet file or is damaged: {first_line(reason)}", where, "write it again") from reason
    meta = (table.schema.metadata or {}).get(_META.encode())
    return _log(table, meta, provenance.of_file(path, data, "parquet"), where, budget, time)


def read_csv(path: str | Path, time: str = TIME_COLUMN) -> FlightLog:
    """Reads a long or wide CSV table; the column `time` of a wide one holds the time stamps [s].

    Raises LogError for a file that is not a log, is damaged or too large.
    """
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
    _check_size(data.count(b"\n", end) + data.count(b"\r", end) + 1, names, where, budget)
    _check_names(names, where)
    texts = {"channel": pa.string(), "field": pa.string()} if _is_long(names) else {}
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
        what = f"is not a table of numbers: {first_line(reason)}"
        raise LogError(what, where, "give a header line and numbers below it") from reason
    return _log(table, meta, provenance.of_file(path, data, "csv"), where, budget, time)


def _described_table(log: FlightLog, wide: bool) -> tuple[pa.Table, str]:
    """The table, and the line of JSON that goes with it."""
    rows: list[dict[str, Any]] = [
        {"name": name, "unit": channel.unit, "fields": list(channel.fields), "samples": len(channel)}
        for name, channel in log.channels.items()
    ]
    for row in rows if wide else ():
        row["columns"] = headings(row["name"], log[row["name"]])
    kept = json.loads(provenance.to_json(log))
    meta = json.dumps({"version": _VERSION, "channels": rows, "provenance": kept}, allow_nan=False)
    return wide_table(log) if wide else long_table(log), meta


def _is_long(names: Sequence[str]) -> bool:
    return set(COLUMNS) <= set(names)


def _log(
    table: pa.Table, meta: bytes | None, file: dict[str, Any], where: str, budget: MemoryBudget, time: str
) -> FlightLog:
    names = table.column_names
    described, kept = _described(meta, where, budget)
    if _is_long(names):
        channels = channels_of_long(table, described, where)
    elif is_wide(names, time):
        channels = channels_of_wide(table, described, where, budget, time)
    else:
        what = f"no column {time!r:.80} among: {', '.join(names)[:200]}"
        raise LogError(what, where, "call the column of time stamps 'time', or name it: --time COLUMN")
    for name, row in described.items():
        count = len(channels[name]) if name in channels else 0
        if count != row["samples"]:
            what = f"truncated: {count} of {row['samples']} samples of {name!r} are there"
            raise LogError(what, where, "write it again")
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
    if not isinstance(row, dict) or not isinstance(row.get("samples"), int):
        return False
    texts = [row.get("name"), row.get("unit")]
    for key in ("fields", "columns"):
        texts += row.get(key, []) if isinstance(row.get(key, []), list) else [None]
    return "fields" in row and all(isinstance(text, str) for text in texts)


def _check_names(names: Sequence[str], where: str) -> None:
    if len(set(names)) != len(names):
        raise LogError(f"two columns have one name: {', '.join(names)[:200]}", where, "rename one")


def _check_size(rows: int, names: Sequence[str], where: str, budget: MemoryBudget) -> None:
    if len(names) > MAX_COLUMNS:
        raise LogError(f"{len(names)} columns", where, f"at most {MAX_COLUMNS} are read")
    budget.take((_LONG_CELL_BYTES if _is_long(names) else _WIDE_CELL_BYTES) * rows * len(names))
