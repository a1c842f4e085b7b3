"""The wide form of a log: a row for each time stamp, a column for each number of each channel.

The column `time [s]` comes first. The others are called as the channel and its unit, `theta [rad]`; a channel with
fields has a column for each of them, `gyr.y [rad/s]`. An empty cell says that the channel has no sample at that time.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.table.cells import numbers, stamps
from twodof.signals import unit_of

TIME = "time [s]"
TIME_COLUMN = "time"
"""What the column of time stamps is called, its unit left out, unless a reader is told another name."""

_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")


def headings(name: str, channel: Channel) -> list[str]:
    """What the columns of a channel are called."""
    width = 1 if channel.value.ndim == 1 else channel.value.shape[1]
    labels = channel.fields or (("",) if width == 1 else tuple(map(str, range(width))))
    unit = f" [{channel.unit}]" if channel.unit else ""
    return [f"{name}.{label}{unit}" if label else f"{name}{unit}" for label in labels]


def wide_table(log: FlightLog) -> pa.Table:
    """The table of a log, in order of time. Raises LogError for two columns of one name."""
    time = np.unique(np.concatenate([channel.time for channel in log.channels.values()]))
    columns: dict[str, Any] = {TIME: time}
    for name, channel in log.channels.items():
        at = np.searchsorted(time, channel.time)
        empty = np.ones(len(time), dtype=bool)
        empty[at] = False
        values = channel.value if channel.value.ndim == 2 else channel.value[:, None]
        for heading, value in zip(headings(name, channel), values.T, strict=True):
            if heading in columns:
                raise LogError(f"two columns would be called {heading!r}", log.source, "rename a channel or a field")
            cells = np.zeros(len(time))
            cells[at] = value
            columns[heading] = pa.array(cells, mask=empty)
    return pa.table(columns)


def is_wide(names: list[str], time: str = TIME_COLUMN) -> bool:
    """Whether columns of these names are a wide table: one is called `time`."""
    return any(time in (name, _split(name)[0]) for name in names)


def channels_of_wide(
    table: pa.Table,
    described: Mapping[str, dict[str, Any]],
    where: str,
    budget: MemoryBudget,
    time_column: str = TIME_COLUMN,
) -> dict[str, Channel]:
    """The channels of a wide table, by their `described` columns; each further column is a channel of its own.

    Raises LogError.
    """
    stamp = next(column for column in table.column_names if time_column in (column, _split(column)[0]))
    time = stamps(table, stamp, where)
    found = {}
    taken = {stamp}
    for name, row in described.items():
        columns = row.get("columns", [])
        missing = [column for column in columns if column not in table.column_names]
        if missing or not columns:
            raise LogError(f"column {missing[:1] or name} is missing", where, "write it again")
        found[name] = _channel(table, columns, time, (row["unit"], tuple(row["fields"])), f"{where}: {name}", budget)
        taken.update(columns)
    for column in table.column_names:
        name, unit = _split(column)
        if column in taken or not name:
            continue
        if name in found:
            raise LogError(f"two columns are called {name!r}", where, "rename one")
        found[name] = _channel(table, [column], time, (unit or unit_of(name), ()), f"{where}: {name}", budget)
    if not found:
        raise LogError("no column beside 'time'", where, "give a column per channel")
    return found


def _channel(
    table: pa.Table,
    columns: list[str],
    time: NDArray[np.float64],
    unit_and_fields: tuple[str, tuple[str, ...]],
    where: str,
    budget: MemoryBudget,
) -> Channel:
    there = np.asarray(table.column(columns[0]).is_valid())
    if any(not np.array_equal(there, np.asarray(table.column(column).is_valid())) for column in columns[1:]):
        raise LogError("its fields are not all there in each row", where, "fill the empty cells of a row, or all")
    budget.samples(int(there.sum()), len(columns))
    values = [numbers(table, column, where, nulls=True)[there] for column in columns]
    unit, fields = unit_and_fields
    return Channel(time[there], np.column_stack(values), unit, fields, where)


def _split(heading: str) -> tuple[str, str]:
    """Name and unit of a column's heading, such as `theta [rad]`."""
    match = _HEADING.fullmatch(heading)
    return (match["name"], match["unit"] or "") if match else (heading, "")
