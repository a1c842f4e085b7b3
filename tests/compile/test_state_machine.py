"""State machines: the reference against an interpreter of tables. That all targets do as it is in test_targets.py."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.compile.differential import Case, reference_run, same
from tests.compile.machine_cases import array_case, machine_case
from tests.compile.random_machines import told_by_the_table
from twodof.blocks.schema import from_json, to_json

pytestmark = pytest.mark.slow

STEPS = 30


@settings(max_examples=4, deadline=None)
@given(st.randoms(use_true_random=False), st.sampled_from(("float64", "float32")))
def test_a_machine_does_what_its_table_says(r: random.Random, precision: str) -> None:
    case, table = machine_case(r, "machine", STEPS)
    found = reference_run(case, precision, "rk4").signals
    for k, row in enumerate(told_by_the_table(table, case.rows)):
        assert {n: found[f"inner.machine.{n}"][k].item() for n in row} == row, k


def test_the_random_machines_take_nearly_all_their_transitions() -> None:
    there = taken = 0
    for seed in range(20):
        case, table = machine_case(random.Random(seed), "machine", 120)
        seen: set[int] = set()
        for _ in told_by_the_table(table, case.rows, seen):
            pass
        there, taken = there + len(table.transitions), taken + len(seen)
    assert taken > 0.6 * there


@pytest.mark.parametrize("case", [machine_case(random.Random(3), "machine", STEPS)[0], array_case(STEPS)])
def test_its_json_means_the_same_and_stays_the_same(case: Case) -> None:
    text = to_json(case.diagram)
    again = Case(from_json(text), case.paths, case.rows, {})
    assert to_json(again.diagram) == text
    one, other = (reference_run(c, "float32", "rk4") for c in (case, again))
    assert one.states == other.states
    assert all(same(values, other.signals[path]).all() for path, values in one.signals.items())
