"""Which modes and transitions of a state machine tests took, with the interpreter of tables as the judge."""

from __future__ import annotations

import random

import pytest

from tests.compile.machine_cases import array_case, machine_case
from tests.compile.random_machines import told_by_the_table
from twodof.blocks.schema import from_json, to_json
from twodof.compile.diagram_test import PointsInput, Scenario
from twodof.compile.diagram_test.coverage.coverage import measure_coverage

DT = 0.01


@pytest.mark.parametrize("seed", [1, 2])
def test_what_was_taken_is_what_the_table_takes(seed: int) -> None:
    case, table = machine_case(random.Random(seed), "machine", 60)
    names = case.diagram.inputs
    points = {n: PointsInput([(k * DT, float(row[n])) for k, row in enumerate(case.rows)], "hold") for n in names}
    diagram = from_json(to_json(case.diagram)) if seed == 1 else case.diagram
    found = measure_coverage(diagram, [Scenario("all", 0.59, points, checks=["inner.machine.mode never below 0"])], DT)
    taken: set[int] = set()
    modes = {row["mode"] for row in told_by_the_table(table, case.rows, taken)}
    sides = {d: bool(s) for d, s in found.taken.items() if d.kind in ("mode", "transition")}
    assert {d.number for d, entered in sides.items() if d.kind == "mode" and entered} == modes
    assert {d.number for d, there in sides.items() if d.kind == "transition" and there} == taken
    assert len(sides) == len(table.leaves) + len(table.transitions)
    assert {d.kind for d in found.taken if d.path == "inner.machine"} == {"mode", "transition"}


def test_what_was_never_taken_is_named_with_its_guard_and_line() -> None:
    found = measure_coverage(
        array_case(1).diagram, [Scenario("still", 0.1, checks=["inner.machine.norm never below -1e9"])], DT
    )
    missing = {d.text: d for d, _ in found.missing if d.kind in ("mode", "transition")}
    assert {"b", "last", "b -> around: (u.b > 2) | (t.elapsed > 4)", "last -> around"} < missing.keys()
    assert missing["b -> around: (u.b > 2) | (t.elapsed > 4)"].place.startswith("machine_cases.py:")
    assert "a" not in missing
