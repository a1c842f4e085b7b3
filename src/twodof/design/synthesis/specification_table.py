"""What the tables of a specification share: how they are read from a TOML file, and that their figures can be."""

import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from twodof.errors import LogError, ParameterError, listed, nearest, shown
from twodof.flightlog.provenance import read_bytes

MAX_BYTES = 1 << 20
TABLES = ("pitch", "rail")
"""The tables of a file; each is read by itself."""


def check_figures(figures: Mapping[str, object], bounds: Mapping[str, tuple[float, float]], always: str) -> None:
    """Whether each figure is a number within its bounds, or None; `always` may not be None. Raises ParameterError."""
    for name, (low, high) in bounds.items():
        value = figures[name]
        if value is None and name != always:
            continue
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
        if not low <= number <= high:
            raise ParameterError(f"{name} = {shown(value)}", "specification", f"give {low:g} to {high:g}")


def table_of(data: object, table: str, known: Iterable[str], where: str) -> dict[str, Any]:
    """One of `TABLES` of a parsed file. Raises ParameterError where it is missing, and for an unknown name."""
    found = data.get(table) if isinstance(data, Mapping) else None
    if not isinstance(data, Mapping) or not isinstance(found, Mapping) or set(data) - set(TABLES):
        raise ParameterError(
            f"it has {listed(data) if isinstance(data, Mapping) else shown(data)}", where, f"give a table [{table}]"
        )
    names = tuple(known)
    for name in found:
        if name not in names:
            raise ParameterError(f"nothing is called {shown(name)}", where, f"there are: {nearest(name, names)}")
    return dict(found)


def read_tables(path: str | Path, table: str, line: str) -> dict[str, Any]:
    """The parsed TOML file; `table` is what it should have, `line` one of its lines.

    Raises ParameterError for a file that cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(read_bytes(path, MAX_BYTES).decode("utf-8"))
    except LogError as reason:
        raise ParameterError(reason.what, str(path), f"name a TOML file with a table [{table}]") from reason
    except (ValueError, RecursionError) as reason:
        raise ParameterError(
            f"it is not TOML: {reason!s:.80}", str(path), f"write [{table}], and below it lines as: {line}"
        ) from reason
