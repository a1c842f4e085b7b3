"""How long a set-point takes, from what was sent and what the motors did."""

import math

import pytest

from bench.stack.latency import lateness


def test_a_set_point_is_as_late_as_the_first_change_by_it() -> None:
    sent = {0.1: 1_000_000, 0.2: 9_000_000}
    changes = [(500_000, 0.0), (3_000_000, 0.1), (4_000_000, 0.1), (14_000_000, 0.2)]
    assert lateness(sent, changes) == pytest.approx([2_000.0, 5_000.0])


def test_one_that_was_overtaken_is_late_until_the_later_one_acts_and_else_for_ever() -> None:
    sent = {0.1: 1_000_000, 0.2: 2_000_000, 0.3: 30_000_000}
    assert lateness(sent, [(6_000_000, 0.2)]) == pytest.approx([4_000.0, 5_000.0, math.inf])
