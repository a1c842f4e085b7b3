"""Scenarios in a file: TOML, bounded before it is used, from which nothing is executed."""

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.blocks.declarations import NAME
from twodof.compile.diagram_test.assertions import Assertion, assertion
from twodof.compile.diagram_test.input_signals import (
    ConstantInput,
    InputSignal,
    PointsInput,
    RampInput,
    SineInput,
    StepInput,
    check_between,
)
from twodof.compile.diagram_test.run_scenarios import DT
from twodof.compile.diagram_test.scenario import ExpectedTable, InputValue, Scenario
from twodof.compile.diagram_test.signal_table import SignalTable, column_of, read_table, table_of_rows
from twodof.errors import DiagramError, listed, shown

MAX_BYTES = 256 * 1024
MAX_DOTS = 200
"""In a line. The parser's time for a key a.b.c... grows with the square of its parts."""
MAX_SCENARIOS = 1000
MAX_CHECKS = 1000


@dataclass(frozen=True, eq=False)
class ScenarioFile:
    """What a file of tests says: its scenarios, at the base tick `dt` [s]."""

    path: Path
    dt: float
    integrator: str
    scenarios: tuple[Scenario, ...]


def read_scenarios(path: str | Path) -> ScenarioFile:
    """The scenarios in a TOML file. CSV files that it names are beside it or in a folder beside it.

    Raises DiagramError for a file that cannot be read, is larger than 256 KiB or does not say what scenarios say; the
    message names the place.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        text = content.decode("utf-8")
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise DiagramError(f"cannot be read: {why}", str(path)[:200], "name a TOML file with tests") from error
    return ScenarioFile(path, *_file(text, str(path)[:200], path.parent))


def _file(text: str, where: str, folder: Path) -> tuple[float, str, tuple[Scenario, ...]]:
    if len(text) > MAX_BYTES:
        raise DiagramError(f"more than {MAX_BYTES} bytes", where, "split it, or put tables into CSV files")
    if any(line.count(".") > MAX_DOTS for line in text.split("\n")):
        raise DiagramError(f"a line has more than {MAX_DOTS} dots", where, "write lists over several lines")
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise DiagramError(f"not TOML: {error!s:.200}", where, "correct it there") from error
    _known(document, ("dt", "integrator", "test"), where)
    dt = _real(document.get("dt", DT), f"{where}, dt")
    if not 1e-6 <= dt <= 1e3:
        raise DiagramError(f"dt = {dt:g} s", where, "give the base tick in seconds, 1e-6 to 1000")
    integrator = document.get("integrator", "rk4")
    if integrator not in ("rk4", "euler"):
        raise DiagramError(f"integrator = {shown(integrator)}", where, 'use "rk4" or "euler"')
    tests = document.get("test")
    if not isinstance(tests, list) or not tests or len(tests) > MAX_SCENARIOS:
        raise DiagramError("it has no tests", where, f"write 1 to {MAX_SCENARIOS} sections [[test]]")
    scenarios = tuple(_scenario(row, f"{where}, test {i + 1}", folder) for i, row in enumerate(tests))
    names = [s.name for s in scenarios]
    if len(set(names)) < len(names):
        raise DiagramError(
            f"two tests are named {shown(max(names, key=names.count))}", where, "give each a name of its own"
        )
    return dt, integrator, scenarios


def _scenario(row: Any, where: str, folder: Path) -> Scenario:
    row = _table(row, where)
    _known(row, ("name", "text", "duration", "parameters", "inputs", "checks", "table"), where)
    name = row.get("name")
    if not isinstance(name, str) or not 0 < len(name) <= 120 or not name.isprintable():
        raise DiagramError(f"name = {shown(name)}", where, "give it a name of 1 to 120 letters")
    where = f"{where} ({name})"
    text = row.get("text", "")
    if not isinstance(text, str) or len(text) > 10_000:
        raise DiagramError("the text is not text", where, "write a sentence")
    checks = row.get("checks", [])
    if not isinstance(checks, list) or len(checks) > MAX_CHECKS:
        raise DiagramError("checks is not a list", where, f"write at most {MAX_CHECKS} texts")
    return Scenario(
        name,
        _real(row["duration"], f"{where}, duration") if "duration" in row else None,
        {key: _input(value, f"{where}, {key}", folder) for key, value in _table(row.get("inputs", {}), where).items()},
        {path: _parameter(value, f"{where}, {path}") for path, value in _parameters(row.get("parameters", {}), where)},
        tuple(_check(text, where) for text in checks),
        _expected(row["table"], f"{where}, table", folder) if "table" in row else None,
        text,
    )


def _parameters(value: Any, where: str, prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Paths and values: `rate.kp = 1` and `"rate.kp" = 1` say the same."""
    for key, one in _table(value, where).items():
        if isinstance(one, dict):
            yield from _parameters(one, where, f"{prefix}{key}.")
        else:
            yield prefix + key, one


def _parameter(value: Any, where: str) -> Any:
    values = value if isinstance(value, list) else [value]
    if not all(isinstance(v, (bool, int, float)) or (isinstance(v, str) and NAME.fullmatch(v)) for v in values):
        raise DiagramError(f"{shown(value)} is not a number", where, "give a number or a list of numbers")
    return value


def _check(text: Any, where: str) -> Assertion | str:
    """An assertion; as its text if it names members of an enumeration, which are known with the diagram."""
    named: list[str] = []

    def noted(_: str, name: str) -> float:
        named.append(name)
        return 0.0

    try:
        found = assertion(text, noted)
        return str(text) if named else found
    except DiagramError as error:
        raise DiagramError(error.what, f"{where}, {error.where}", error.remedy) from error


def _input(value: Any, where: str, folder: Path) -> InputValue:
    if isinstance(value, list):
        return [_input(one, where, folder) for one in value]
    return _signal(value, where, folder)


_SIGNALS: Mapping[str, tuple[str, ...]] = {
    "step": ("at", "from"),
    "ramp": ("start", "stop", "from"),
    "sine": ("hz", "phase", "offset"),
    "points": ("between",),
    "csv": ("column", "between"),
}
"""The first key of a signal says its kind, and these may come with it."""


def _signal(value: Any, where: str, folder: Path) -> InputSignal | str:
    if isinstance(value, (bool, int, float)):
        return ConstantInput(float(value))
    if isinstance(value, str) and NAME.fullmatch(value):  # of a member of an enumeration
        return value
    row = _table(value, where)
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
    times, values = column_of(table, column)
    return PointsInput(list(zip(times.tolist(), values.tolist(), strict=True)), between)


def _expected(value: Any, where: str, folder: Path) -> ExpectedTable:
    row = _table(value, where)
    _known(row, ("csv", "columns", "rows", "between", "absolute", "relative", "at"), where)
    if ("csv" in row) == ("rows" in row):
        raise DiagramError("it names a CSV file or has rows, one of both", where, "write csv = or columns = and rows =")
    if "absolute" not in row and "relative" not in row:
        raise DiagramError("it does not say a tolerance", where, "write absolute = or relative =; 0 is exact")
    table = read_table(_beside(row["csv"], where, folder)) if "csv" in row else _rows(row, where)
    return ExpectedTable(
        table,
        check_between(row.get("between"), where),
        _tolerance(row.get("absolute", 0.0), where),
        _tolerance(row.get("relative", 0.0), where),
        row.get("at", "rows"),
    )


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
    """A file in the folder of the tests; a stranger's tests read nothing else."""
    if not isinstance(name, str) or len(name) > 1000 or "\0" in name:
        raise DiagramError(f"{shown(name)} is not a file's name", where, "name a CSV file beside the tests")
    place = (folder / name).resolve()
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
            near = difflib.get_close_matches(key[:200], keys, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise DiagramError(f"there is no key {shown(key)}", where, f"{hint}keys: {listed(keys)}")
