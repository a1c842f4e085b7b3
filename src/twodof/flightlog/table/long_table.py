"""The long (tidy) form of a log: a row for each number, with `channel`, `field` (empty for a scalar), `time`, `value`.

It is the form that is written by default, because every channel has its own time stamps.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.log import MAX_NAME, Channel, FlightLog
from twodof.flightlog.table.cells import first_line, numbers, stamps
from twodof.signals import BY_MAT, unit_of

COLUMNS = ("channel", "field", "time", "value")
MAX_NAMES = 1000


def long_table(log: FlightLog) -> pa.Table:
    """The table of a log, channel by channel."""
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


def channels_of_long(table: pa.Table, described: Mapping[str, dict[str, Any]], where: str) -> dict[str, Channel]:
    """The channels of a long table, rows in any order; units and fields as `described`, else from TOPICS, else none.

    Raises LogError.
    """
    time, value = stamps(table, "time", where), numbers(table, "value", where)
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
        if columns or any(not np.array_equal(time[one], shared) for one in chosen):
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
    """A column of names as codes, and the names, each once."""
    cells = table.column(column)
    if cells.null_count:
        raise LogError(f"{cells.null_count} empty cells in column {column!r}", where, "write it again")
    try:
        if pa.types.is_dictionary(cells.type):
            coded = pa.chunked_array(cells.unify_dictionaries().chunks, cells.type).combine_chunks()
        else:
            coded = cells.cast(pa.string()).combine_chunks().dictionary_encode()
        names = [str(name)[: MAX_NAME + 1] for name in coded.dictionary[: MAX_NAMES + 1].to_pylist()]
    except (pa.ArrowException, UnicodeDecodeError) as reason:
        raise LogError(f"column {column!r} is not of names: {first_line(reason)}", where) from reason
    if len(names) > MAX_NAMES or len(set(names)) < len(names):
        raise LogError(f"more than {MAX_NAMES} names in column {column!r}", where, "this is not a flight log")
    return np.asarray(coded.indices, dtype=np.intp), names
