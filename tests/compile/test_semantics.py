"""When parts act, what they hold and when they start afresh: the reference against loops written out in Python.

That all targets do as the reference is in test_targets.py.
"""

import pytest

from tests.compile.differential import DT, reference_run
from tests.compile.semantics import resetting
from tests.compile.typed_signals import TOLD
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.compile.program.check import check

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", TOLD)
def test_the_reference_does_what_the_loop_says(name: str, precision: str) -> None:
    told = TOLD[name]()
    found = reference_run(told.case, precision, "rk4").signals
    assert found.keys() == told.expected[0].keys()
    for k, row in enumerate(told.expected):
        assert {n: found[n][k].tolist() for n in row} == row, k


@pytest.mark.parametrize("name", TOLD)
def test_its_json_means_the_same_and_stays_the_same(name: str) -> None:
    told = TOLD[name]()
    text = to_json(told.case.diagram)
    again = from_json(text)
    assert to_json(again) == text
    machine = Reference(again, DT).machine()
    assert [machine.step(row) for row in told.case.rows] == told.expected
    assert check(again, DT).fine


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_continuous_integrator_starts_afresh_to_the_bit(precision: str) -> None:
    told = resetting(precision)
    found = reference_run(told.case, precision, "rk4").signals
    assert any(row["rising"] != row["falling"] for row in told.expected)
    for k, row in enumerate(told.expected):
        assert {n: found[n][k].item() for n in row} == row, k
