"""The faults of a sensor that once drove the rig into its stops unseen, in the compiled loop on both rigs."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from tests.flight.failsafe.expr_arrays import tell
from tests.fmea.fly import AT_A_STOP, flown
from tests.fmea.rows import ROWS
from twodof.flight.failsafe.causes_and_actions import ACTIONS

pytestmark = pytest.mark.slow

WITHIN: Mapping[str, tuple[str, int]] = {
    "range: step of -0.16 m": ("descend", 320),
    "range: step of -0.2 m": ("descend", 320),
    "gyro_y: frozen": ("off", 130),
    "gyro_y: zero": ("off", 140),
    "gyro_y: frozen with noise": ("off", 1500),
}
"""Fault -> what is done, at the latest after how many ms. What is frozen is seen as soon as the drone is turned."""


LIKE_ANOTHER = ("range: step of -0.2 m", "gyro_y: zero")


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.soak] if name in LIKE_ANOTHER else []) for name in WITHIN]
)
def test_a_sensor_that_contradicts_the_others_stops_the_motors_before_they_press_against_a_stop(name: str) -> None:
    (row,) = (row for row in ROWS if row.name == name)
    action, within = WITHIN[name]
    for one in flown([row], range(1, 9)):
        tell(one.line())
        at = one.seen[f"{action}_at"]
        assert (at >= 0).all(), one.line()
        assert at.max() <= within, one.line()
        assert one.seen["on_after"].max() <= AT_A_STOP, one.line()
        assert one.seen["strongest"].min() >= ACTIONS.index(action), one.line()
