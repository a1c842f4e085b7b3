"""The hazard analysis: each row puts its fault into the compiled closed loop, on both rigs, and is judged."""

from collections.abc import Sequence

import pytest

from tests.flight.failsafe.expr_arrays import tell
from tests.fmea.expected import EXPECTED, Expected
from tests.fmea.fly import AT_A_STOP, Flown, flown
from tests.fmea.measured import COLUMNS, kept, records
from tests.fmea.rows import ROWS
from twodof.rig.parameters import NAMES

pytestmark = pytest.mark.slow

LEAST_FAULTS = 120
"""Rows in their situations that are flown on each rig, at least."""


def judge(flights: Sequence[Flown]) -> list[str]:
    """Return a line for each difference from the expected result."""
    wrong = []
    for one in flights:
        expected = EXPECTED[one.row.name]
        if one.seen["early"].any():
            wrong.append(f"it acts before the fault: {one.line()}")
        if one.breaks and not expected.why:
            wrong.append(f"motors on for more than {AT_A_STOP} ms after a stop was met: {one.line()}")
        if expected.action and not in_time(one, expected):
            wrong.append(f"not {expected.action} within {expected.within} ms: {one.line()}")
    return wrong


def in_time(one: Flown, expected: Expected) -> bool:
    """Return True if the expected action or a stronger one is taken in time with each seed."""
    if expected.action == "none":
        return not one.seen["strongest"].any() and bool((one.seen["touched_at"] < 0).all())
    at = one.seen[f"{expected.action}_at"]
    return bool(((at >= 0) & (at <= expected.within)).all())


def test_each_row_states_what_is_expected_and_there_are_enough_of_them() -> None:
    assert list(EXPECTED) == [row.name for row in ROWS]
    faults = sum(len(row.situations) for row in ROWS if row.component != "no fault")
    tell(f"{len(ROWS)} rows, {faults} faults on each of {len(NAMES)} rigs")
    assert faults >= LEAST_FAULTS


@pytest.mark.long
def test_each_fault_ends_as_expected_with_the_figures_that_are_kept() -> None:
    """In its action, in its time, and not at a stop with motors on; where nothing fails nothing acts.

    The figures are the same bits on all machines; the table in docs/explanation/safety.md is made of them.
    """
    flights = list(flown(ROWS, (0,)))
    wrong = judge(flights)
    assert not wrong, "\n".join(wrong)
    now, before = list(records(flights)), kept()
    assert now == before, "run `python -m tests.fmea.measured` and `python tools/tables.py`"


def test_a_fault_that_is_said_to_be_beyond_help_does_end_at_a_stop_with_motors_on() -> None:
    """Where it no longer does, tests/fmea/expected.py is to say what happens instead."""
    component, text, on = (COLUMNS.index(name) for name in ("component", "fault", "on_after_ms"))
    broken = {f"{line[component]}: {line[text]}" for line in kept()[1:] if int(line[on]) > AT_A_STOP}
    assert {name for name, expected in EXPECTED.items() if expected.why and not expected.rarely} == broken


@pytest.mark.soak
def test_it_holds_over_a_hundred_thousand_flights() -> None:
    """A hundred for each row, in each situation, on each rig."""
    wrong: list[str] = []
    broken: set[str] = set()
    for begin in range(1, 101, 5):
        flights = list(flown(ROWS, range(begin, begin + 5)))
        wrong += judge(flights)
        broken |= {one.row.name for one in flights if one.breaks}
    assert not wrong, "\n".join(wrong)
    assert broken == {row.name for row in ROWS if EXPECTED[row.name].why}
