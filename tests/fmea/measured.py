"""Measurements of the rows in measured.csv: `python -m tests.fmea.measured` writes it, then tools/tables.py."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from tests.fmea.expected import EXPECTED, Expected
from tests.fmea.fly import Flown, flown
from tests.fmea.rows import ROWS
from twodof.flight.failsafe.causes_and_actions import ACTIONS, named_causes

FILE = Path(__file__).with_name("measured.csv")

COLUMNS = (
    "component",
    "fault",
    "expected",
    "why",
    "flown",
    "rig",
    "first",
    "first_ms",
    "least",
    "most",
    "most_ms",
    "theta",
    "x",
    "impact_q",
    "impact_v",
    "at_stop_ms",
    "on_after_ms",
)
"""Of the file: the causes of the first action and its latest time, the weakest and the strongest of the
actions in which they end, the latest time of the strongest, and the largest of the rest."""


def record(one: Flown) -> tuple[str, ...]:
    """A line of the file."""
    seen = one.seen
    most = ACTIONS[seen["strongest"].max()]
    first = int(np.bitwise_or.reduce(seen["first_reason"]))
    return (
        one.row.component,
        one.row.text,
        told(EXPECTED[one.row.name]),
        EXPECTED[one.row.name].why,
        one.situation,
        one.rig,
        " ".join(named_causes(first)),
        str(seen["level_at"].max()) if most != "none" else "",
        ACTIONS[seen["strongest"].min()],
        most,
        str(seen[f"{most}_at"].max()) if most != "none" else "",
        *(
            f"{seen[name].max():.{digits}f}"
            for name, digits in (("theta", 2), ("x", 3), ("impact_q", 1), ("impact_v", 2))
        ),
        str(seen["at_stop"].max()),
        str(seen["on_after"].max()),
    )


def told(expected: Expected) -> str:
    """Return the expected action in words."""
    return f"{expected.action} within {expected.within} ms" if expected.action else ""


def records(flights: Iterable[Flown]) -> Iterator[tuple[str, ...]]:
    """All lines, the head first."""
    yield COLUMNS
    yield from (record(one) for one in flights)


def kept() -> list[tuple[str, ...]]:
    """The lines of the file."""
    with FILE.open(encoding="utf-8", newline="") as file:
        return [tuple(line) for line in csv.reader(file)]


def write(lines: Iterable[Sequence[str]]) -> None:
    """Writes the file."""
    with FILE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)


if __name__ == "__main__":
    write(records(flown(ROWS, (0,))))
