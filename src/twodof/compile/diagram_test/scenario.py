"""Scenario: the inputs of one test and its claims about the outputs, from Python or from a table of rows."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import pairwise
from math import inf, pi
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, Strict

from twodof.blocks.elementary.functions import sin
from twodof.blocks.enumeration import Enumeration
from twodof.blocks.expressions import numbers
from twodof.compile.diagram_test.assertions import Assertion, Judgement, first_tick, first_violation
from twodof.errors import DiagramError, listed, nearest, shown
from twodof.flightlog.provenance import separator_of, text_of

Array = NDArray[np.float64]
Number = Annotated[float, Strict()]
Between = Literal["hold", "interpolate"]
BETWEEN: tuple[Between, ...] = ("hold", "interpolate")
MAX_TIME = 1e9
"""Largest time of a row or point, in seconds or ticks."""
MAX_HZ = 1e9

INPUT, OUTPUT = "input ", "output "
"""Prefixes of a column's name, for a diagram with an input and an output of the same name."""


_KEYS = ConfigDict(extra="forbid")
"""A file of tests gives a signal's fields by their aliases, and no others."""


class InputSignal(Protocol):
    """Function of time with the same values on every machine: no platform's libm computes them."""

    def values(self, steps: int, dt: float, whole: bool = False) -> Array:
        """Return the values at the ticks 0 .. steps - 1 of `dt` [s]; `whole` for an integer or a bool."""


@dataclass(frozen=True)
class StepInput:
    """Step from the value `before` to the value `to`, at the first tick at or after `at` [s]."""

    __pydantic_config__: ClassVar[ConfigDict] = _KEYS
    to: Annotated[Number, Field(alias="step")]
    at: Number = 0.0
    before: Annotated[Number, Field(alias="from")] = 0.0

    def __post_init__(self) -> None:
        _check_finite("step", self.to, self.at, self.before)

    def values(self, steps: int, dt: float, whole: bool = False) -> Array:
        """Return the values at the ticks 0 .. steps - 1."""
        return np.where(np.arange(steps) >= first_tick(self.at, dt), float(self.to), float(self.before))


@dataclass(frozen=True)
class RampInput:
    """Ramp: the value `before` until `start` [s], then a change by `slope` [1/s] until `stop` [s]."""

    __pydantic_config__: ClassVar[ConfigDict] = _KEYS
    slope: Annotated[Number, Field(alias="ramp")]
    start: Number = 0.0
    stop: Number = inf
    before: Annotated[Number, Field(alias="from")] = 0.0

    def __post_init__(self) -> None:
        _check_finite("ramp", self.slope, self.start, self.before)
        if not self.stop >= self.start:
            raise DiagramError(
                f"it stops at {self.stop} s and starts at {self.start} s", "ramp", "stop after the start"
            )

    def values(self, steps: int, dt: float, whole: bool = False) -> Array:
        """Return the values at the ticks 0 .. steps - 1."""
        time = np.minimum(np.arange(steps) * dt, self.stop)
        with np.errstate(over="ignore"):
            found: Array = self.before + self.slope * np.maximum(time - self.start, 0.0)
        return np.floor(found) if whole else found


@dataclass(frozen=True)
class SineInput:
    """Sine: offset + amplitude sin(2 pi hz t + phase), `phase` in rad."""

    __pydantic_config__: ClassVar[ConfigDict] = _KEYS
    amplitude: Annotated[Number, Field(alias="sine")]
    hz: Number
    phase: Number = 0.0
    offset: Number = 0.0

    def __post_init__(self) -> None:
        _check_finite("sine", self.amplitude, self.hz, self.phase, self.offset)
        if abs(self.hz) > MAX_HZ:
            raise DiagramError(f"hz = {self.hz:g}", "sine", f"give at most {MAX_HZ:g} Hz")

    def values(self, steps: int, dt: float, whole: bool = False) -> Array:
        """Return the values at the ticks 0 .. steps - 1."""
        turns = np.arange(steps) * dt * self.hz
        angles = 2.0 * pi * (turns - np.floor(turns)) + self.phase
        with numbers.precision("float64"):
            waves = np.array([float(sin(a)) for a in angles.tolist()])
        found: Array = self.offset + self.amplitude * waves
        return np.floor(found) if whole else found


@dataclass(frozen=True)
class PointsInput:
    """Pairs (time [s], value) in the order of time; the first value holds from the start.

    Between two points the value is that of the first ("hold"), or on the line through both ("interpolate").
    """

    __pydantic_config__: ClassVar[ConfigDict] = _KEYS
    points: Sequence[tuple[Number, Number]]
    between: Between

    def __post_init__(self) -> None:
        times = [time for time, _ in self.points]
        if not times or any(b <= a for a, b in pairwise(times)) or not max(map(abs, times)) <= MAX_TIME:
            raise DiagramError(f"the times do not increase to at most {MAX_TIME:g} s", "points", "sort them, each once")
        check_choice("between", self.between, BETWEEN, "points")

    def values(self, steps: int, dt: float, whole: bool = False) -> Array:
        """Return the values at the ticks 0 .. steps - 1."""
        rows = np.array(self.points, dtype=float)
        return between_rows(_whole_ticks(rows[:, 0] / dt), rows[:, 1], steps, "hold" if whole else self.between)


def _check_finite(what: str, *given: float) -> None:
    for number in given:
        if not abs(number) < inf:
            raise DiagramError(f"{shown(number)} is not a finite number", what, "give a number")


def check_choice(name: str, value: object, choices: Sequence[str], where: str) -> None:
    """Raise DiagramError unless `value` is one of `choices`."""
    if value not in choices:
        raise DiagramError(f"{name} = {shown(value)} is unknown", where, f"write {' or '.join(choices)}")


def _whole_ticks(ticks: Array) -> Array:
    """Return `ticks` with roundings taken out."""
    nearest_tick = np.rint(ticks)
    return np.where(np.abs(ticks - nearest_tick) < 1e-6, nearest_tick, ticks)


def between_rows(ticks: Array, values: Array, steps: int, between: Between) -> Array:
    """Return values at the ticks 0 .. steps - 1 from rows at increasing `ticks`; the outer rows hold beyond them."""
    k = np.arange(steps, dtype=float)
    if between == "interpolate":
        return np.asarray(np.interp(k, ticks, values), dtype=np.float64)
    return values[np.clip(np.searchsorted(ticks, k, side="right") - 1, 0, None)]


@dataclass(frozen=True, eq=False)
class SignalTable:
    """Rows at the times `at` [s], or at ticks if `ticks`, with the cells of each column by name.

    A cell is a number, None where it is empty, or the name of an enumeration's member. `name` is for messages.
    """

    name: str
    at: Array
    ticks: bool
    cells: Mapping[str, Sequence[float | str | None]]

    def ticks_of(self, dt: float) -> Array:
        """Return the rows' times in ticks of `dt` [s]; a time between two ticks is a fraction."""
        return self.at if self.ticks else _whole_ticks(self.at / dt)

    def column(self, name: str, enumeration: Enumeration | None = None) -> tuple[NDArray[np.int64], Array]:
        """Return the indices of the rows in which the column has a cell, and the numbers in these cells, (n,) each."""
        if name not in self.cells:
            there = f"there are: {nearest(name, self.cells)}"
            raise DiagramError(f"no column named {shown(name)}", self.name, there)
        given = {row: cell for row, cell in enumerate(self.cells[name]) if cell is not None}
        values = []
        for row, cell in given.items():
            where = f"{self.name}, row {row + 1}, {name}"
            if isinstance(cell, float):
                values.append(cell)
            elif enumeration is None:
                raise DiagramError(f"{shown(cell)} is not a number", where, "write a number")
            else:
                values.append(float(enumeration.plain(cell, where)))
        return np.array(list(given), dtype=np.int64), np.array(values, dtype=np.float64)


def table_of(columns: Mapping[str, Sequence[Any]], name: str = "table") -> SignalTable:
    """Return the table with these columns. Raises DiagramError for different lengths, and as `table_of_rows` does."""
    if len(set(map(len, columns.values()))) > 1:
        raise DiagramError("the lengths of the columns differ", name, "an empty cell may be None")
    return table_of_rows(list(columns), list(zip(*columns.values(), strict=True)), name)


def table_of_rows(heads: Sequence[str], rows: Sequence[Sequence[Any]], name: str = "table") -> SignalTable:
    """Return the table with these heads and rows; the first column is "time" [s] or "tick", and None an empty cell.

    A unit in a head, as in `theta [rad]`, is not read. Raises DiagramError for a row of another length, for two columns
    of one name, and for times that do not increase.
    """
    for i, row in enumerate(rows, 1):
        if len(row) != len(heads):
            what = f"{len(row)} cells for {len(heads)} columns"
            raise DiagramError(what, f"{name}, row {i}", "fill each column; empty is allowed")
    names = [re.sub(r"\s*\s\[[^\]]*\]$", "", head.strip()) for head in heads]
    if len(set(names)) < len(names):
        raise DiagramError("two columns have the same name", name, "give each column its own name")
    cells = {one: [_cell(row[j]) for row in rows] for j, one in enumerate(names)}
    first = next(iter(cells), "")
    if first not in ("time", "tick"):
        raise DiagramError(f"the first column is {shown(first)}", name, 'name it "time" (seconds) or "tick"')
    at = np.array([cell if isinstance(cell, float) else np.nan for cell in cells.pop(first)])
    rising = len(at) and at[0] >= 0.0 and (np.diff(at) > 0.0).all() and at[-1] <= MAX_TIME
    if not rising or (first == "tick" and (at != np.rint(at)).any()):
        what = f"the column {first} does not increase from 0 on to at most {MAX_TIME:g}"
        raise DiagramError(what, name, "sort the rows, each time once; ticks are whole")
    return SignalTable(name, at, first == "tick", cells)


def _cell(cell: Any) -> float | str | None:
    """Return a cell as a number, as None if it is empty, and else as its text."""
    text = str(cell).strip() if cell is not None else ""
    if text.lower() in ("true", "false"):
        return float(text.lower() == "true")
    try:
        return float(text) if "_" not in text else text
    except ValueError:
        return text or None


def read_table(path: str | Path) -> SignalTable:
    """Return the table in a CSV file with the columns' names in the first line. Cells may be empty.

    Columns are separated by commas, or by semicolons or tabs; then a comma may be the decimal mark.
    Raises DiagramError for a file that cannot be read or is not such a table.
    """
    try:
        text = text_of(Path(path).read_bytes())
        separator = separator_of(text.partition("\n")[0])
        rows = [row for row in csv.reader(StringIO(text, newline=""), strict=True, delimiter=separator) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DiagramError(f"cannot be read: {error}", str(path), "name a CSV file in UTF-8, with commas") from error
    if separator != ",":
        rows[1:] = [[cell.replace(",", ".") for cell in row] for row in rows[1:]]
    return table_of_rows(rows[0] if rows else (), rows[1:], Path(path).name)


@dataclass(frozen=True, eq=False)
class ExpectedTable:
    """Table whose columns are values of inputs, and expected values of outputs or of signals inside, by path.

    Between two rows inputs "hold" or "interpolate", as `between` tells; bools and integers hold in any case. A value v
    is as expected if |v - e| <= absolute + relative * |e|; both tolerances may be mappings by column. NaN and infinity
    match only themselves. Expected values are compared `at` the "rows", or at all "ticks" from the first row to the
    last.
    """

    table: SignalTable
    between: Between = "hold"
    absolute: float | Mapping[str, float] = 0.0
    relative: float | Mapping[str, float] = 0.0
    at: str = "rows"

    def __post_init__(self) -> None:
        check_choice("between", self.between, BETWEEN, self.table.name)
        check_choice("at", self.at, ("rows", "ticks"), self.table.name)
        for given in (self.absolute, self.relative):
            for column, value in given.items() if isinstance(given, Mapping) else [("", given)]:
                if column and column not in self.table.cells:
                    what = f"a tolerance is given for {shown(column)}, which is not a column"
                    raise DiagramError(what, self.table.name, f"columns: {listed(self.table.cells)}")
                if not 0.0 <= value < inf:
                    raise DiagramError(
                        f"the tolerance {shown(value)} is not valid", self.table.name, "give a number >= 0"
                    )

    def tolerance(self, column: str) -> tuple[float, float]:
        """Return the absolute and relative tolerance of a column."""
        absolute, relative = (
            float(given.get(column, 0.0) if isinstance(given, Mapping) else given)
            for given in (self.absolute, self.relative)
        )
        return absolute, relative

    def expected(
        self, column: str, signal: str, whole: bool, steps: int, dt: float, enumeration: Enumeration | None = None
    ) -> "ExpectedColumn":
        """Return the expected values of `signal`, in the table's `column`; `whole` is true for an integer or a bool.

        Raises DiagramError for a row that is not at a tick, or after the scenario's end.
        """
        rows, values = self.table.column(column, enumeration)
        ticks, where = self.table.ticks_of(dt)[rows], f"{self.table.name}, {column}"
        if self.at == "ticks" and len(ticks):
            every = between_rows(ticks, values, steps, "hold" if whole else self.between)
            within = np.arange(np.ceil(ticks[0]), np.floor(ticks[-1]) + 1.0)
            values = every[within[within < steps].astype(np.int64)]
            ticks = within
        odd = ticks[ticks != np.rint(ticks)]
        if len(odd):
            what = f"the row at {odd[0] * dt:g} s is between two ticks of {dt:g} s"
            raise DiagramError(what, where, 'move it, or compare at = "ticks"')
        if not len(ticks):
            raise DiagramError("nothing is expected in this column", where, "fill a cell, or leave the column out")
        if ticks[-1] > steps - 1:
            what = f"the scenario ends before the last row, at {(steps - 1) * dt:g} s"
            raise DiagramError(what, where, "give a longer duration")
        absolute, relative = self.tolerance(column)
        off = f"{absolute:g}" if not relative else f"{absolute:g} + {relative:g} |expected|"
        text = f"{signal} as in {self.table.name}, within {off}"
        return ExpectedColumn(text, signal, ticks.astype(np.int64), values, absolute, relative)


@dataclass(frozen=True, eq=False)
class ExpectedColumn:
    """Expectation of one signal: `expected` at `ticks`, both of shape (n,), within the tolerance."""

    text: str
    signal: str
    ticks: NDArray[np.int64]
    expected: Array
    absolute: float
    relative: float

    def judge(self, values: Array, dt: float) -> Judgement:
        """Judge the signal's `values`, one for each tick of `dt` [s] from 0."""
        found, expected = values[self.ticks], self.expected
        with np.errstate(invalid="ignore"):
            off = np.abs(found - expected)
            room = self.absolute + self.relative * np.abs(expected)
            near = np.isfinite(expected) & (off <= room)  # the room around infinity is infinite
        wrong = np.flatnonzero(~(near | (found == expected) | (np.isnan(found) & np.isnan(expected))))
        if not len(wrong):
            worst = int(np.argmax(np.nan_to_num(off)))
            far, time = np.nan_to_num(off)[worst], self.ticks[worst] * dt
            text = f"{len(found)} values, the farthest off by {far:.3g} at {time:.6g} s"
            return Judgement(self.text, self.signal, True, text)
        room = np.where(np.isfinite(room), room, 0.0)[wrong]
        limits = expected[wrong] + np.where(found[wrong] > expected[wrong], room, -room)
        return first_violation(self.text, self.signal, found[wrong], limits, self.ticks[wrong], dt)


InputValue = InputSignal | float | str | Sequence[Any]
"""Value of an input: a signal, a number, a bool or the name of an enumeration's member; of an array a list of these."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """One test, from 0 to `duration` [s], both ends included. An input that is not named is 0 (false).

    `checks` are assertions, or their texts (see `assertions`). `table` has values of inputs and expected values of
    outputs; without a `duration` the scenario ends with its last row. A parameter that is not named has its default.
    """

    name: str
    duration: float | None = None
    inputs: Mapping[str, InputValue] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    checks: Sequence[Assertion | str] = ()
    table: ExpectedTable | None = None
    text: str = ""


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """Result of one scenario: `time` [s] (n,), and `signals` (n,) by name, with further axes for an array.

    `expected` holds the times [s] (m,) and values (m,) that a table expects, by the judgement's `check`.
    """

    name: str
    judgements: tuple[Judgement, ...]
    time: Array
    signals: Mapping[str, NDArray[Any]]
    expected: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """True if all assertions hold."""
        return not self.failed

    @property
    def failed(self) -> tuple[Judgement, ...]:
        """Judgements of the assertions that do not hold."""
        return tuple(j for j in self.judgements if not j.passed)

    def __str__(self) -> str:
        """Return a line for each failed assertion, as pytest shows it for `assert result.passed, result`."""
        lines = [f"{self.name}: {j.check}: {j.text}" for j in self.failed]
        return "\n".join(lines) or f"{self.name}: all {len(self.judgements)} assertions hold"
