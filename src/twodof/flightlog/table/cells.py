"""Columns of a table as arrays, with what is wrong in a cell said in words."""

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from twodof.errors import LogError


def stamps(table: pa.Table, column: str, where: str) -> NDArray[np.float64]:
    """Time stamps, checked before they are compared, because NaN differs from itself. Raises LogError."""
    time = numbers(table, column, where)
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        k = int(bad[0])
        raise LogError(
            f"the time stamp is {time[k]!s} in row {k + 1} below the header, {bad.size} such in all",
            f"{where}: {column}",
            "give these rows a time or remove them; of a channel with fields, all rows of that time",
        )
    return time


def numbers(table: pa.Table, column: str, where: str, nulls: bool = False) -> NDArray[np.float64]:
    """A column of numbers, NaN for an empty cell where `nulls` allows one. Raises LogError."""
    cells = table.column(column)
    if cells.null_count and not nulls:
        raise LogError(f"{cells.null_count} empty cells in column {column!r}", where, "fill or remove the rows")
    try:
        return np.asarray(cells.cast(pa.float64()).to_numpy(), dtype=np.float64)
    except (pa.ArrowException, TypeError) as reason:
        raise LogError(f"column {column!r} is not of numbers: {first_line(reason)}", where) from reason


def first_line(reason: BaseException) -> str:
    """The first line of an error's text, or its type if the text is empty."""
    return str(reason).splitlines()[0][:200] if str(reason) else type(reason).__name__
