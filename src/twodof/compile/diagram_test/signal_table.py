"""SignalTable: rows of numbers at ticks or times, from a CSV file, a list of rows or columns."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.datatypes.enumeration import Enumeration
from twodof.blocks.declarations import NAME
from twodof.errors import DiagramError, nearest, shown

MAX_BYTES = 64 * 2**20
MAX_ROWS = 1_000_000
MAX_COLUMNS = 1000
MAX_CELLS = 10_000_000
MAX_AT = 1e9
"""In seconds or ticks."""
CLOCKS = ("time", "tick")
_UNIT = re.compile(r"\s*\s\[[^\]]*\]$")
_WORDS = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True, eq=False)
class SignalTable:
    """Rows at the times `at` [s], or at ticks if `ticks`. `columns` by name; NaN where `given` says False: left empty.

    All arrays have the shape (rows,). `name` is the file's, for messages. `words` are cells that are names, by column
    and row: they may name members of an enumeration. Until `with_members` has read them, their numbers are NaN.
    """

    name: str
    at: NDArray[np.float64]
    ticks: bool
    columns: Mapping[str, NDArray[np.float64]]
    given: Mapping[str, NDArray[np.bool_]]
    words: Mapping[str, Mapping[int, str]] = field(default_factory=dict)

    def with_members(self, enumerations: Mapping[str, Enumeration | None]) -> "SignalTable":
        """This table with the numbers of the named members; `enumerations` by column. DiagramError for other words."""
        columns = dict(self.columns)
        for column, cells in self.words.items():
            columns[column] = columns[column].copy()
            enumeration = enumerations.get(column)
            for row, word in cells.items():
                where = f"{self.name}, row {row + 1}, {column}"
                if enumeration is None:
                    raise DiagramError(f"{shown(word)} is not a number", where, "write a number")
                columns[column][row] = enumeration.plain(word, where)
        return replace(self, columns=columns, words={})

    def ticks_of(self, dt: float) -> NDArray[np.float64]:
        """Where the rows lie in ticks of `dt` [s]; not always whole numbers."""
        found = self.at if self.ticks else self.at / dt
        nearest = np.rint(found)
        return np.where(np.abs(found - nearest) < 1e-6, nearest, found)


def table_of(columns: Mapping[str, Sequence[Any]], name: str = "table") -> SignalTable:
    """The table with these columns, the first of them "time" [s] or "tick"; a cell that is None is empty.

    Raises DiagramError for columns of different lengths, a cell that is not a number, and times that do not increase.
    """
    lengths = {len(cells) for cells in columns.values()}
    if len(lengths) > 1:
        raise DiagramError("the columns have different lengths", name, "give each row all cells; None is an empty one")
    rows = [list(row) for row in zip(*columns.values(), strict=True)]
    return table_of_rows(list(columns), rows, name)


def table_of_rows(heads: Sequence[str], rows: Sequence[Sequence[Any]], name: str = "table") -> SignalTable:
    """The table with these heads and rows; see `table_of`. A head may carry a unit, `theta [rad]`, which is not read.

    Raises DiagramError as `table_of` does.
    """
    names = [_UNIT.sub("", str(head).strip()) for head in heads]
    if not names or names[0] not in CLOCKS:
        raise DiagramError(
            f"the first column is {shown(names[0]) if names else 'not there'}",
            name,
            'name it "time" (seconds) or "tick"',
        )
    if len(set(names)) < len(names) or len(names) > MAX_COLUMNS:
        raise DiagramError(
            f"{len(names)} columns, {len(set(names))} names", name, f"give each its own name, at most {MAX_COLUMNS}"
        )
    if not rows:
        raise DiagramError("it has no rows", name, "give at least one")
    if len(rows) > MAX_ROWS or len(rows) * len(names) > MAX_CELLS:
        raise DiagramError(f"{len(rows)} rows", name, f"at most {MAX_ROWS} rows and {MAX_CELLS} cells are read")
    data = np.empty((len(rows), len(names)))
    given = np.ones(data.shape, dtype=bool)
    words: dict[str, dict[int, str]] = {}
    for i, row in enumerate(rows):
        if len(row) != len(names):
            raise DiagramError(
                f"{len(row)} cells for {len(names)} columns",
                f"{name}, row {i + 1}",
                "fill each column; empty is allowed",
            )
        for j, cell in enumerate(row):
            number = _number(cell)
            if number is None and j and isinstance(cell, str) and NAME.fullmatch(cell.strip()):
                words.setdefault(names[j], {})[i] = cell.strip()
            elif number is None and not (cell is None or (isinstance(cell, str) and not cell.strip())):
                raise DiagramError(
                    f"{shown(cell)} is not a number", f"{name}, row {i + 1}, {names[j]}", "write a number"
                )
            data[i, j] = np.nan if number is None else number
            given[i, j] = number is not None or i in words.get(names[j], ())
    at = data[:, 0]
    ticks = names[0] == "tick"
    if not (at <= MAX_AT).all() or at[0] < 0 or (np.diff(at) <= 0).any() or (ticks and (at != np.rint(at)).any()):
        raise DiagramError(
            f"the column {names[0]} does not increase from 0 on to at most {MAX_AT:g}",
            name,
            "sort the rows, each time once; ticks are whole",
        )
    columns = {n: np.ascontiguousarray(data[:, j]) for j, n in enumerate(names)}
    mask = {n: np.ascontiguousarray(given[:, j]) for j, n in enumerate(names)}
    del columns[names[0]], mask[names[0]]
    return SignalTable(name, at, ticks, columns, mask, words)


def _number(cell: Any) -> float | None:
    if isinstance(cell, (bool, int, float, np.number, np.bool_)):
        return float(cell)
    if not isinstance(cell, str):
        return None
    text = cell.strip().lower()
    if text in _WORDS:
        return _WORDS[text]
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None


def read_table(path: str | Path) -> SignalTable:
    """The table in a CSV file (commas; the first line has the names); an empty cell is one that is not given.

    Raises DiagramError for a file that cannot be read, is too large (64 MiB, 10^6 rows) or is not such a table.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        text = content.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise DiagramError(f"cannot be read: {why}", str(path)[:200], "name a CSV file") from error
    if len(content) > MAX_BYTES:
        raise DiagramError(f"more than {MAX_BYTES} bytes", str(path)[:200], "give fewer rows or digits")
    if text.count("\n") > MAX_ROWS + 10:
        raise DiagramError("too many lines", str(path)[:200], f"at most {MAX_ROWS} rows are read")
    try:
        rows = [row for row in csv.reader(text.splitlines(), strict=True) if row]
    except csv.Error as error:
        raise DiagramError(f"not CSV: {error!s:.100}", str(path)[:200], "separate cells by commas") from error
    if not rows:
        raise DiagramError("it is empty", str(path)[:200], 'begin with a line of names, "time,..."')
    return table_of_rows(rows[0], rows[1:], path.name)


def column_of(table: SignalTable, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where one column's cells are given (times or ticks), and these. Raises DiagramError if it is not there."""
    if name not in table.columns:
        there = f"there are: {nearest(name, table.columns)}"
        raise DiagramError(f"there is no column {shown(name)}", table.name, there)
    table = table.with_members({})
    mask = table.given[name]
    return table.at[mask], table.columns[name][mask]
