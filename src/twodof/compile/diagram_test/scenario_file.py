"""Scenarios in a TOML file."""

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.blocks.declarations import NAME
from twodof.compile.diagram_test.assertions import assertion
from twodof.compile.diagram_test.run_scenarios import DT
from twodof.compile.diagram_test.scenario import (
    ConstantInput,
    ExpectedTable,
    InputSignal,
    InputValue,
    PointsInput,
    RampInput,
    Scenario,
    SignalTable,
    SineInput,
    StepInput,
    check_between,
    read_table,
    table_of_rows,
)
from twodof.errors import DiagramError, listed, shown


@dataclass(frozen=True, eq=False)
class ScenarioFile:
    """Scenarios of a file, at the base tick `dt` [s]."""

    path: Path
    dt: float
    integrator: str
    scenarios: tuple[Scenario, ...]


def read_scenarios(path: str | Path) -> ScenarioFile:
    """Read the scenarios in a TOML file. CSV files that it names are in its folder.

    Raises DiagramError, which names the place, for a file that cannot be read and for an unknown or wrong key.
    """
    path = Path(path)
    where = str(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DiagramError(f"cannot be read: {error.strerror}", where, "name a TOML file with tests") from error
    except (RecursionError, ValueError) as error:  # TOMLDecodeError and UnicodeDecodeError among them
        raise DiagramError(f"not TOML: {error!s:.200}", where, "correct it there") from error
    _known(document, ("dt", "integrator", "test"), where)
    dt = _real(document.get("dt", DT), f"{where}, dt")
    if not 1e-6 <= dt <= 1e3:
        raise DiagramError(f"dt = {dt:g} s", where, "give the base tick in seconds, 1e-6 to 1000")
    integrator = document.get("integrator", "rk4")
    if integrator not in ("rk4", "euler"):
        raise DiagramError(f"integrator = {shown(integrator)}", where, 'use "rk4" or "euler"')
    tests = document.get("test")
    if not isinstance(tests, list) or not tests:
        raise DiagramError("it has no tests", where, "write sections [[test]]")
    scenarios = tuple(_scenario(row, f"{where}, test {i + 1}", path.parent) for i, row in enumerate(tests))
    names = [s.name for s in scenarios]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise DiagramError(f"two tests are named {shown(twice)}", where, "give each a name of its own")
    return ScenarioFile(path, dt, integrator, scenarios)


def _scenario(row: Any, where: str, folder: Path) -> Scenario:
    row = _table(row, where)
    _known(row, ("name", "text", "duration", "parameters", "inputs", "checks", "table"), where)
    name, text, checks = row.get("name"), row.get("text", ""), row.get("checks", [])
    if not isinstance(name, str) or not name:
        raise DiagramError(f"name = {shown(name)}", where, "give it a name")
    where = f"{where} ({name})"
    if not isinstance(text, str):
        raise DiagramError("the text is not text", where, "write a sentence")
    if not isinstance(checks, list):
        raise DiagramError("checks is not a list", where, "write a list of texts")
    for check in checks:
        try:
            assertion(check, lambda signal, name: 0.0)  # names of members are known with the diagram
        except DiagramError as error:
            raise DiagramError(error.what, f"{where}, {error.where}", error.remedy) from error
    return Scenario(
        name,
        _real(row["duration"], f"{where}, duration") if "duration" in row else None,
        {key: _input(value, f"{where}, {key}", folder) for key, value in _table(row.get("inputs", {}), where).items()},
        dict(_parameters(row.get("parameters", {}), where)),
        tuple(checks),
        _expected(row["table"], f"{where}, table", folder) if "table" in row else None,
        text,
    )


def _parameters(value: Any, where: str, prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Yield paths and values: `rate.kp = 1` and `"rate.kp" = 1` say the same."""
    for key, one in _table(value, where).items():
        path = prefix + key
        if isinstance(one, dict):
            yield from _parameters(one, where, f"{path}.")
            continue
        for number in one if isinstance(one, list) else [one]:
            if not isinstance(number, (bool, int, float)) and not (isinstance(number, str) and NAME.fullmatch(number)):
                raise DiagramError(f"{shown(one)} is not a number", f"{where}, {path}", "give a number or a list")
        yield path, one


_SIGNALS: Mapping[str, tuple[str, ...]] = {
    "step": ("at", "from"),
    "ramp": ("start", "stop", "from"),
    "sine": ("hz", "phase", "offset"),
    "points": ("between",),
    "csv": ("column", "between"),
}
"""The first key of a signal says its kind; the others may come with it."""


def _input(value: Any, where: str, folder: Path) -> InputValue:
    if isinstance(value, list):
        return [_input(one, where, folder) for one in value]
    if isinstance(value, (bool, int, float)):
        return ConstantInput(float(value))
    if isinstance(value, str) and NAME.fullmatch(value):  # a member of an enumeration
        return value
    return _signal(_table(value, where), where, folder)


def _signal(row: Mapping[str, Any], where: str, folder: Path) -> InputSignal:
    kind = next((k for k in _SIGNALS if k in row), None)
    if kind is None:
        raise DiagramError(f"{shown(row)} is not a signal", where, f"give a number, or one of {', '.join(_SIGNALS)}")
    _known(row, (kind, *_SIGNALS[kind]), where)

    def number(key: str, default: float | None = None) -> float:
        if key not in row and default is None:
            raise DiagramError(f"{key} is missing", where, f"a {kind} has {', '.join(_SIGNALS[kind])}")
        return _real(row.get(key, default), f"{where}, {key}")

    if kind == "step":
        return StepInput(number("step"), number("at", 0.0), number("from", 0.0))
    if kind == "ramp":
        return RampInput(number("ramp"), number("start", 0.0), number("stop", math.inf), number("from", 0.0))
    if kind == "sine":
        return SineInput(number("sine"), number("hz"), number("phase", 0.0), number("offset", 0.0))
    between = check_between(row.get("between"), where)
    if kind == "points":
        points = row["points"]
        if not isinstance(points, list) or not all(isinstance(p, list) and len(p) == 2 for p in points):
            raise DiagramError("points is not a list of pairs", where, "write [[0.0, 1.0], [0.5, 2.0]]")
        return PointsInput([(_real(t, where), _real(v, where)) for t, v in points], between)
    column = row.get("column")
    if not isinstance(column, str):
        raise DiagramError("column is missing", where, "name the column of the CSV file")
    table = read_table(_beside(row["csv"], where, folder))
    if table.ticks:
        raise DiagramError("the rows are at ticks", where, 'name the first column "time", in seconds')
    rows, values = table.column(column)
    return PointsInput(list(zip(table.at[rows].tolist(), values.tolist(), strict=True)), between)


def _expected(value: Any, where: str, folder: Path) -> ExpectedTable:
    row = _table(value, where)
    _known(row, ("csv", "columns", "rows", "between", "absolute", "relative", "at"), where)
    if ("csv" in row) == ("rows" in row):
        raise DiagramError("it names a CSV file or has rows, one of both", where, "write csv = or columns = and rows =")
    if "absolute" not in row and "relative" not in row:
        raise DiagramError("it does not say a tolerance", where, "write absolute = or relative =; 0 is exact")
    table = read_table(_beside(row["csv"], where, folder)) if "csv" in row else _rows(row, where)
    absolute, relative = (_tolerance(row.get(key, 0.0), f"{where}, {key}") for key in ("absolute", "relative"))
    return ExpectedTable(table, check_between(row.get("between"), where), absolute, relative, row.get("at", "rows"))


def _rows(row: Mapping[str, Any], where: str) -> SignalTable:
    heads, rows = row.get("columns"), row["rows"]
    if not (isinstance(heads, list) and all(isinstance(h, str) for h in heads)):
        raise DiagramError("columns is not a list of names", where, 'write columns = ["time", "u", "y"]')
    if not (isinstance(rows, list) and all(isinstance(r, list) for r in rows)):
        raise DiagramError("rows is not a list of rows", where, "write rows = [[0.0, 1.0, 2.0]]")
    return table_of_rows(heads, rows, "table")


def _tolerance(value: Any, where: str) -> float | Mapping[str, float]:
    if isinstance(value, dict):
        return {str(key): _real(one, f"{where}, {key}") for key, one in value.items()}
    return _real(value, where)


def _beside(name: Any, where: str, folder: Path) -> Path:
    """Return a file in the folder of the tests; tests of others read nothing else."""
    place = (folder / str(name)).resolve()
    if not place.is_relative_to(folder.resolve()):
        raise DiagramError(f"{shown(name)} is not in the folder of the tests", where, "copy it beside the tests")
    return place


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise DiagramError(f"{shown(value)} is not a table", where, "write { key = value }, or a section")
    return value


def _real(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise DiagramError(f"{shown(value)} is not a number", where, "give a number")
    try:
        return float(value)
    except OverflowError as error:
        raise DiagramError("a number is too large", where, "write one that a float64 holds") from error


def _known(row: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    for key in row:
        if key not in keys:
            near = difflib.get_close_matches(key, keys, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise DiagramError(f"there is no key {shown(key)}", where, f"{hint}keys: {listed(keys)}")
