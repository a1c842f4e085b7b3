"""Scenario: what one test feeds in and what it claims of what comes out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile.diagram_test.assertions import Assertion
from twodof.compile.diagram_test.input_signals import Between, InputSignal, between_rows, check_between
from twodof.compile.diagram_test.judgement import Judgement, first_violation
from twodof.compile.diagram_test.signal_table import SignalTable
from twodof.errors import DiagramError, listed, shown

INPUT, OUTPUT = "input ", "output "
"""A column's name may begin with one of these, where the diagram has an input and an output of one name."""

InputValue = InputSignal | float | str | Sequence[Any]
"""What an input can be fed with: a signal, a number (a bool), or a member's name; of an array one for each element."""


@dataclass(frozen=True, eq=False)
class ExpectedTable:
    """Columns of a table that are inputs, and those that are outputs (or paths of signals), which are expected.

    `between` says what inputs are between two rows; bools and integers are held in any case. A value v is as expected
    if |v - e| <= absolute + relative * |e|; both may be a mapping by column. NaN and infinity are as expected
    only if they are expected. `at` is where expected values are compared: "rows", at the rows only, or "ticks", at each
    tick from the first row to the last.
    """

    table: SignalTable
    between: Between = "hold"
    absolute: float | Mapping[str, float] = 0.0
    relative: float | Mapping[str, float] = 0.0
    at: str = "rows"

    def __post_init__(self) -> None:
        check_between(self.between, self.table.name)
        if self.at not in ("rows", "ticks"):
            raise DiagramError(f"at = {shown(self.at)}", self.table.name, 'compare at "rows" or "ticks"')
        for given in (self.absolute, self.relative):
            for column in given if isinstance(given, Mapping) else ():
                if column not in self.table.columns:
                    raise DiagramError(
                        f"a tolerance of {shown(column)}, which is not a column",
                        self.table.name,
                        f"columns: {listed(self.table.columns)}",
                    )

    def tolerance(self, column: str) -> tuple[float, float]:
        """The absolute and relative tolerance of a column. Raises DiagramError if one is not a number >= 0."""
        found = []
        for what, given in (("absolute", self.absolute), ("relative", self.relative)):
            value = given.get(column, 0.0) if isinstance(given, Mapping) else given
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < np.inf:
                raise DiagramError(f"{what} = {shown(value)}", f"{self.table.name}, {column}", "give a number >= 0")
            found.append(float(value))
        return found[0], found[1]


@dataclass(frozen=True, eq=False)
class ExpectedColumn:
    """An output that must be as in a table: `expected` at `ticks`, both of shape (n,), within the tolerance."""

    text: str
    signal: str
    ticks: NDArray[np.int64]
    expected: NDArray[np.float64]
    absolute: float
    relative: float

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Whether the signal's `values`, one for each tick of `dt` [s] from 0, are as expected."""
        found, expected = values[self.ticks], self.expected
        with np.errstate(invalid="ignore"):
            room = self.absolute + self.relative * np.abs(expected)
            near = np.isfinite(expected) & (np.abs(found - expected) <= room)  # the room around infinity is infinite
        fine = near | (found == expected) | (np.isnan(found) & np.isnan(expected))
        if fine.all():
            with np.errstate(invalid="ignore"):
                far = np.nan_to_num(np.abs(found - expected))
            worst = int(np.argmax(far))
            text = f"{len(found)} values, the farthest off by {far[worst]:.3g} at {self.ticks[worst] * dt:.6g} s"
            return Judgement(self.text, self.signal, True, text)
        wrong = np.flatnonzero(~fine)
        room = np.where(np.isfinite(room), room, 0.0)[wrong]
        limits = expected[wrong] + np.where(found[wrong] > expected[wrong], room, -room)
        return first_violation(self.text, self.signal, found[wrong], limits, self.ticks[wrong], dt)


@dataclass(frozen=True, eq=False)
class Scenario:
    """One test. An input that is not named is 0 (false). `duration` [s]: the ticks from 0 to it, both included.

    `checks` are assertions, or their texts (see `assertions`). `table` feeds inputs and expects outputs; without a
    `duration` the scenario ends with its last row. A parameter that is not named has its default.
    """

    name: str
    duration: float | None = None
    inputs: Mapping[str, InputValue] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    checks: Sequence[Assertion | str] = ()
    table: ExpectedTable | None = None
    text: str = ""


def expected_column(
    given: ExpectedTable, column: str, signal: str, whole: bool, steps: int, dt: float
) -> ExpectedColumn:
    """What the table expects of `signal` in its `column`. `whole`: of an integer or a bool, which is held.

    Raises DiagramError for a row that is not at a tick, or after the scenario's end.
    """
    table, mask = given.table, given.table.given[column]
    ticks, values = table.ticks_of(dt)[mask], table.columns[column][mask]
    where = f"{table.name}, {column}"
    if not len(ticks):
        raise DiagramError("nothing is expected in this column", where, "fill a cell, or leave the column out")
    absolute, relative = given.tolerance(column)
    off = f" {absolute:g}" if not relative else f" {absolute:g} + {relative:g} |expected|"
    text = f"{signal} as in {table.name}, within{off}"
    if given.at == "rows" and (ticks != np.rint(ticks)).any():
        time = ticks[ticks != np.rint(ticks)][0] * dt
        raise DiagramError(
            f"the row at {time:g} s is between two ticks of {dt:g} s", where, 'move it, or compare at = "ticks"'
        )
    if ticks[-1] > steps - 1:
        raise DiagramError(
            f"the scenario ends before the last row, at {(steps - 1) * dt:g} s", where, "let it last longer"
        )
    if given.at == "rows":
        return ExpectedColumn(text, signal, ticks.astype(np.int64), values, absolute, relative)
    every = between_rows(ticks, values, steps, "hold" if whole else given.between)
    first, last = int(np.ceil(ticks[0])), int(np.floor(ticks[-1]))
    if last < first:
        raise DiagramError("no tick lies between its rows", where, "add rows")
    return ExpectedColumn(text, signal, np.arange(first, last + 1), every[first : last + 1], absolute, relative)
