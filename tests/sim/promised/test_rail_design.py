"""The search for gains of the velocity and position loops: what it finds is what a promise then says."""

from dataclasses import replace

import pytest

from tests.sim.promised.test_rail_promise import FAMILY
from twodof.design.specification import Specification
from twodof.errors import ParameterError
from twodof.flight.gains import STUDENT
from twodof.sim.promised.rail_design import rail_design
from twodof.sim.promised.rail_promise import check_rail, rail_promise

pytestmark = pytest.mark.slow

FEW = 40


@pytest.mark.long
def test_gains_that_are_found_meet_what_the_first_ones_miss() -> None:
    """Repeat the promise from the gains alone; loops outside the specification keep their gains."""
    wanted = Specification(loop="velocity", overshoot=0.12, rise_time=0.6)
    before = check_rail(wanted, FAMILY, STUDENT, promised=rail_promise(FAMILY, gains=STUDENT, members=FEW))
    assert not all(row.met for row in before)
    shares: list[float] = []
    found = rail_design(wanted, FAMILY, STUDENT, FEW, progress=shares.append)
    assert found.met
    promised = rail_promise(FAMILY, gains=found.gains, members=FEW)
    assert check_rail(wanted, FAMILY, found.gains, promised=promised) == found.requirements
    assert replace(found.gains, velocity=STUDENT.velocity) == STUDENT
    assert shares == sorted(shares)
    assert 0.0 < shares[0] <= shares[-1] <= 1.0


@pytest.mark.soak
def test_what_cannot_be_met_comes_as_near_as_it_can() -> None:
    """A rise in 50 ms takes more than the motors give: all gains miss it, and the first ones miss it by more."""
    wanted = Specification(loop="velocity", rise_time=0.05)
    (before,) = check_rail(wanted, FAMILY, STUDENT, promised=rail_promise(FAMILY, gains=STUDENT, members=FEW))
    found = rail_design(wanted, FAMILY, STUDENT, FEW)
    (after,) = found.requirements
    assert not found.met
    assert 0.05 < after.got < before.got


def test_refuses_a_specification_that_asks_for_nothing() -> None:
    with pytest.raises(ParameterError, match="asks for no figure"):
        rail_design(Specification(loop="velocity"), FAMILY)


@pytest.mark.soak
@pytest.mark.parametrize(
    "wanted",
    [
        Specification(
            loop="velocity", velocity_bandwidth=5.0, position_bandwidth=2.0, phase_margin_deg=60.0, peak_sensitivity=1.5
        ),
        Specification(loop="velocity", overshoot=0.12, rise_time=0.6, velocity_bandwidth=3.0),
        Specification(overshoot=0.12, rise_time=2.5, position_bandwidth=1.5, loop="position"),
    ],
)
def test_other_members_keep_what_was_searched(wanted: Specification) -> None:
    """Members, gusts and noise of another seed than the search's."""
    found = rail_design(wanted, FAMILY, STUDENT)
    assert found.met
    fresh = rail_promise(FAMILY, wanted.loop, gains=found.gains, goal=wanted.step, seed=77)
    rows = check_rail(wanted, FAMILY, found.gains, promised=fresh)
    # the far end of an interval is told by the 10 outermost of 400 members: to 10 % where its tail is long
    assert all(row.met or abs(row.got / row.asked - 1.0) < 0.1 for row in rows), [row.text for row in rows]
