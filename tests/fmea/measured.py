"""What the rows measured, as the file measured.csv: `python -m tests.fmea.measured` writes it, then tools/tables.py."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from tests.fmea.expected import EXPECTED, Expected
from tests.fmea.fly import Flown, flown
from tests.fmea.rows import ROWS
from twodof.flight.causes import ACTIONS, named_causes

FILE = Path(__file__).with_name("measured.csv")

SEEDS = (1, 2)
"""Those of which the figures are the worst."""

COLUMNS = (
    "component",
    "fault",
    "expected",
    "flown",
    "rig",
    "least",
    "most",
    "within_ms",
    "first",
    "theta",
    "x",
    "impact_q",
    "impact_v",
    "at_stop_ms",
    "on_after_ms",
)
"""Of the file: the weakest and the strongest action of the seeds, the latest time of the strongest, its first causes,
and the largest of the rest."""


def record(one: Flown) -> tuple[str, ...]:
    """A line of the file."""
    seen = one.seen
    acted = seen["strongest"] > 0
    first = int(np.bitwise_or.reduce(seen["first_reason"]))
    return (
        one.row.component,
        one.row.text,
        told(EXPECTED[one.row.name]),
        one.situation,
        one.rig,
        ACTIONS[seen["strongest"].min()],
        ACTIONS[seen["strongest"].max()],
        str(seen["strongest_at"].max()) if acted.any() else "",
        " ".join(named_causes(first)),
        *(f"{seen[name].max():.{digits}f}" for name, digits in (("theta", 2), ("x", 3), ("impact_q", 1), ("impact_v", 2))),
        str(seen["at_stop"].max()),
        str(seen["on_after"].max()),
    )


def told(expected: Expected) -> str:
    """What is expected, in words."""
    if expected.why:
        return f"cannot be seen: {expected.why}"
    return f"{expected.action} within {expected.within} ms" if expected.action else "safe"


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
    write(records(flown(ROWS, SEEDS)))
