"""Scenarios in a TOML file."""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twodof.blocks.declarations import NAME
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
from twodof.errors import DiagramError, shown


@dataclass(frozen=True, eq=False)
class ScenarioFile:
    """Scenarios of a file, at the base tick `dt` [s]."""

    path: Path
    dt: float
    integrator: str
    scenarios: tuple[Scenario, ...]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Table(_Model):
    csv: str = ""
    columns: list[str] = Field(default_factory=list)
    rows: list[list[Any]] = Field(default_factory=list)
    between: Between
    absolute: float | dict[str, float] | None = None
    relative: float | dict[str, float] | None = None
    at: str = "rows"


class _Test(_Model):
    name: str = Field(min_length=1)
    text: str = ""
    duration: float | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)
    inputs: dict[str, Any] = Field(default_factory=dict)
    checks: list[str] = Field(default_factory=list)
    table: _Table | None = None


class _File(_Model):
    dt: float = Field(DT, ge=1e-6, le=1e3)
    integrator: Literal["rk4", "euler"] = "rk4"
    test: list[_Test] = Field(min_length=1)


def read_scenarios(path: str | Path) -> ScenarioFile:
    """Read the scenarios in a TOML file. CSV files that it names are in its folder.

    Raises DiagramError, which names the place, for a file that cannot be read and for an unknown or wrong key.
    """
    path = Path(path)
    where = str(path)
    try:
        found = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise DiagramError(f"cannot be read: {error.strerror}", where, "name a TOML file with tests") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part + 1 if isinstance(part, int) else part) for part in first["loc"])
        what = {"missing": "it is missing", "extra_forbidden": "there is no such key"}.get(
            first["type"], f"{first['msg']} (given: {shown(first['input'])})"
        )
        raise DiagramError(what, f"{where}, {place}", "correct it there") from error
    except (RecursionError, ValueError) as error:  # TOMLDecodeError and UnicodeDecodeError among them
        raise DiagramError(f"not TOML: {error!s:.200}", where, "correct it there") from error
    names = [test.name for test in found.test]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise DiagramError(f"two tests are named {shown(twice)}", where, "give each a name of its own")
    scenarios = tuple(_scenario(test, f"{where}, {test.name}", path.parent) for test in found.test)
    return ScenarioFile(path, found.dt, found.integrator, scenarios)


def _scenario(test: _Test, where: str, folder: Path) -> Scenario:
    for check in test.checks:
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


_SIGNALS: Mapping[str, tuple[type[InputSignal], tuple[str, ...]]] = {
    "step": (StepInput, ("step", "at", "from")),
    "ramp": (RampInput, ("ramp", "start", "stop", "from")),
    "sine": (SineInput, ("sine", "hz", "phase", "offset")),
    "points": (PointsInput, ("points", "between")),
}
"""Class and keys of a signal, in the order of the class's fields, by the first key."""


def _input(value: Any, where: str, folder: Path) -> InputValue:
    if isinstance(value, list):
        return [_input(one, where, folder) for one in value]
    if isinstance(value, (bool, int, float)) or (isinstance(value, str) and NAME.fullmatch(value)):
        return value
    row = dict(value) if isinstance(value, dict) else {}
    if "csv" in row:
        table = read_table(_beside(row.pop("csv"), where, folder))
        if table.ticks:
            raise DiagramError("the rows are at ticks", where, 'name the first column "time", in seconds')
        rows, values = table.column(row.pop("column", ""))
        row["points"] = list(zip(table.at[rows].tolist(), values.tolist(), strict=True))
    kind = next((k for k in _SIGNALS if k in row), "")
    if not kind:
        kinds = ", ".join((*_SIGNALS, "csv"))
        raise DiagramError(f"{shown(value)} is not a signal", where, f"give a number, or a table with one of {kinds}")
    signal, keys = _SIGNALS[kind]
    names = dict(zip(keys, (field.name for field in fields(signal)), strict=True))  # type: ignore[arg-type]
    try:
        return signal(**{names[key]: one for key, one in row.items()})
    except (KeyError, TypeError, ValueError) as error:
        what = f"{shown(value)} is not a {kind}: {error}"
        raise DiagramError(what, where, f"its keys are {', '.join(keys)}") from error


def _expected(given: _Table, where: str, folder: Path) -> ExpectedTable:
    if bool(given.csv) == bool(given.rows):
        raise DiagramError("it names a CSV file or has rows, one of both", where, "write csv = or columns = and rows =")
    if given.absolute is None and given.relative is None:
        raise DiagramError("it does not say a tolerance", where, "write absolute = or relative =; 0 is exact")
    table = read_table(_beside(given.csv, where, folder)) if given.csv else table_of_rows(given.columns, given.rows)
    return ExpectedTable(table, given.between, given.absolute or 0.0, given.relative or 0.0, given.at)


def _beside(name: Any, where: str, folder: Path) -> Path:
    """Return a file in the folder of the tests; tests of others read nothing else."""
    place = (folder / str(name)).resolve()
    if not place.is_relative_to(folder.resolve()):
        raise DiagramError(f"{shown(name)} is not in the folder of the tests", where, "copy it beside the tests")
    return place
