"""Scenarios in a TOML file."""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from twodof.blocks.declarations import NAME, located
from twodof.compile.diagram_test.assertions import assertion
from twodof.compile.diagram_test.run_scenarios import DT
from twodof.compile.diagram_test.scenario import (
    Between,
    ExpectedTable,
    InputSignal,
    InputValue,
    PointsInput,
    RampInput,
    Scenario,
    SineInput,
    StepInput,
    read_table,
    table_of_rows,
)
from twodof.errors import DiagramError, listed, nearest, shown
from twodof.flightlog.provenance import text_of


@dataclass(frozen=True, eq=False)
class ScenarioFile:
    """Scenarios of a file, at the base tick `dt` [s]."""

    path: Path
    dt: float
    integrator: str
    scenarios: tuple[Scenario, ...]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


M = TypeVar("M")


class _Csv(_Model):
    csv: str
    column: str
    between: Between


class _Table(_Model):
    csv: str | None = None
    columns: list[str] = Field(default_factory=list)
    rows: list[list[Any]] | None = None
    between: Between
    absolute: float | dict[str, float] | None = None
    relative: float | dict[str, float] | None = None
    at: str = "rows"


class _Test(_Model):
    name: str = Field(min_length=1, max_length=120)
    text: str = ""
    duration: float | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)
    inputs: dict[str, Any] = Field(default_factory=dict)
    checks: list[str] = Field(default_factory=list)
    table: dict[str, Any] | None = None


class _File(_Model):
    dt: float = Field(DT, ge=1e-6, le=1e3)
    integrator: Literal["rk4", "euler"] = "rk4"
    test: list[dict[str, Any]] = Field(min_length=1)


_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")


def _read(model: type[M], given: Any, where: str) -> M:
    """Return `given` as `model`. Raises DiagramError with the key that is unknown, missing or wrong."""
    try:
        with located(where, keep=True):
            return TypeAdapter(model).validate_python(given)
    except ValidationError as error:
        # A misspelt key is missing too: say first how it is spelt. The deepest place is the most exact one.
        wrong = min(error.errors(), key=lambda one: (one["type"] not in _UNKNOWN_KEY, -len(one["loc"])))
        place = ".".join(str(part + 1 if isinstance(part, int) else part) for part in wrong["loc"])
        keys = list(TypeAdapter(model).json_schema()["properties"])
        what, remedy = f"{wrong['msg']} (given: {shown(wrong['input'])})", "correct it there"
        if wrong["type"] == "missing":
            what, remedy = "it is missing", f"keys: {listed(keys)}"
        elif wrong["type"] in _UNKNOWN_KEY:
            what, remedy = "unknown key", f"keys: {nearest(place, keys)}"
        raise DiagramError(what, f"{where}, {place:.200}", remedy) from error


def read_scenarios(path: str | Path) -> ScenarioFile:
    """Read the scenarios in a TOML file. CSV files that it names are in its folder.

    Raises DiagramError, which names the place, for a file that cannot be read and for an unknown or wrong key.
    """
    path = Path(path)
    where = str(path)
    try:
        given = tomllib.loads(text_of(path.read_bytes()))
    except OSError as error:
        raise DiagramError(f"cannot be read: {error.strerror}", where, "name a TOML file with tests") from error
    except (RecursionError, ValueError) as error:  # TOMLDecodeError and UnicodeDecodeError among them
        raise DiagramError(f"the file is not TOML: {error!s:.200}", where, "correct it there") from error
    found = _read(_File, given, where)
    scenarios = tuple(_scenario(row, f"{where}, test {i}", path.parent) for i, row in enumerate(found.test, 1))
    names = [scenario.name for scenario in scenarios]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise DiagramError(f"two tests are named {shown(twice)}", where, "give each a name of its own")
    return ScenarioFile(path, found.dt, found.integrator, scenarios)


def _scenario(row: Mapping[str, Any], where: str, folder: Path) -> Scenario:
    test = _read(_Test, row, where)
    if not test.name.isprintable():
        raise DiagramError(f"name = {shown(test.name)}", where, "write it without control characters")
    where = f"{where} ({test.name})"
    for check in test.checks:
        with located(where, keep=True):
            assertion(check, lambda signal, name: 0.0)  # names of members are known with the diagram
    inputs = {key: _input(value, f"{where}, {key}", folder) for key, value in test.inputs.items()}
    table = None if test.table is None else _expected(test.table, f"{where}, table", folder)
    return Scenario(
        test.name, test.duration, inputs, dict(_parameters(test.parameters)), tuple(test.checks), table, test.text
    )


def _parameters(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield paths and values: `rate.kp = 1` and `"rate.kp" = 1` say the same."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _parameters(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


_SIGNALS: Mapping[str, type[Any]] = {
    "step": StepInput,
    "ramp": RampInput,
    "sine": SineInput,
    "points": PointsInput,
    "csv": _Csv,
}
"""Type of a signal's table, by its first key."""


def _input(value: Any, where: str, folder: Path) -> InputValue:
    if isinstance(value, list):
        return [_input(one, where, folder) for one in value]
    if isinstance(value, str) and NAME.fullmatch(value):
        return value
    if isinstance(value, (bool, int, float)):
        try:
            return float(value)
        except OverflowError as error:
            raise DiagramError("a number is too large", where, "write one that a float64 holds") from error
    kind = next((one for one in _SIGNALS if isinstance(value, dict) and one in value), None)
    if kind is None:
        remedy = f"give a number, or a table with one of {', '.join(_SIGNALS)}"
        raise DiagramError(f"{shown(value)} is not a signal", where, remedy)
    signal: InputSignal | _Csv = _read(_SIGNALS[kind], value, where)
    if not isinstance(signal, _Csv):
        return signal
    with located(where, keep=True):
        table = read_table(_beside(signal.csv, "csv", folder))
        if table.ticks:
            raise DiagramError("the rows have ticks in place of times", table.name, 'name the first column "time" [s]')
        rows, values = table.column(signal.column)
        return PointsInput(list(zip(table.at[rows].tolist(), values.tolist(), strict=True)), signal.between)


def _expected(value: Mapping[str, Any], where: str, folder: Path) -> ExpectedTable:
    given = _read(_Table, value, where)
    if (given.csv is None) == (given.rows is None):
        raise DiagramError("it needs either a CSV file or rows", where, "write csv =, or else columns = and rows =")
    if given.absolute is None and given.relative is None:
        raise DiagramError("it has no tolerance", where, "write absolute = or relative =; 0 is exact")
    with located(where, keep=True):
        if given.csv is None:
            table = table_of_rows(given.columns, given.rows or ())
        else:
            table = read_table(_beside(given.csv, "csv", folder))
        return ExpectedTable(table, given.between, given.absolute or 0.0, given.relative or 0.0, given.at)


def _beside(name: str, where: str, folder: Path) -> Path:
    """Return a file in the folder of the tests; tests of others read nothing else."""
    if "\0" in name or not (place := (folder / name).resolve()).is_relative_to(folder.resolve()):
        raise DiagramError(f"{shown(name)} is not in the folder of the tests", where, "copy it beside the tests")
    return place
