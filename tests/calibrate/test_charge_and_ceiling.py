"""The charge that a flight shows, and the FIT that gusts leave, on flights of the virtual rig."""

import pytest

from twodof.calibrate import estimate_charge, gust_ceiling, gust_fits
from twodof.errors import IdentificationError
from twodof.experiment.flight import Laboratory
from twodof.rig.parameters import lab
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.flight_segment import default_window
from twodof.sim.resimulation import LoggedFlight, resimulation_loop

pytestmark = pytest.mark.slow

RIG = lab().snapshot()


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return resimulation_loop()


@pytest.fixture(scope="module")
def steps() -> LoggedFlight:
    log = Laboratory("lab").fly("attitude-steps").log
    return LoggedFlight(log, window=default_window(log))


def test_the_charge_that_was_flown_is_found(loop: ClosedLoop, steps: LoggedFlight) -> None:
    for charge in (0.3, 0.7):
        steps.logged = steps.simulate(loop, RIG, {"charge_start": charge})
        found = estimate_charge(steps, loop, RIG)
        assert found.charge == pytest.approx(charge, abs=2e-3)  # twice the search's tolerance
        assert not found.at_bound


def test_gusts_blur_the_charge_as_its_deviation_says(loop: ClosedLoop, steps: LoggedFlight) -> None:
    steps.logged = steps.simulate(loop, RIG, {"charge_start": 0.5, "noise": 1.0, "seed": 4})
    found = estimate_charge(steps, loop, RIG)
    assert 0.0 < found.deviation < 0.5
    assert abs(found.charge - 0.5) < 3.0 * found.deviation


def test_too_much_thrust_ends_at_the_bound(loop: ClosedLoop, steps: LoggedFlight) -> None:
    steps.logged = steps.simulate(loop, RIG | {"pair_thrust": 1.1 * RIG["pair_thrust"]})
    found = estimate_charge(steps, loop, RIG)
    assert found.charge == pytest.approx(1.0, abs=2e-3)
    assert found.at_bound


def test_a_battery_without_sag_has_no_charge(loop: ClosedLoop, steps: LoggedFlight) -> None:
    with pytest.raises(IdentificationError, match="no trace"):
        estimate_charge(steps, loop, RIG | {"voltage_empty": RIG["voltage_full"]})


def test_the_ceiling_falls_with_the_gusts(loop: ClosedLoop, steps: LoggedFlight) -> None:
    ceilings = [
        gust_ceiling(steps, loop, RIG | {"gust": share * RIG["gust"]}, seeds=3)["theta"] for share in (0.0, 1.0, 2.0)
    ]
    # Without gusts the sensors' noise remains: below 2 % of the pitch.
    assert 98.0 < ceilings[0] < 100.0
    assert ceilings[0] > ceilings[1] + 1.0
    # The deviation from the noise-free flight grows about in proportion to the gusts.
    assert 100.0 - ceilings[2] == pytest.approx(2.0 * (100.0 - ceilings[1]), rel=0.25)
    fits = gust_fits(steps, loop, RIG, seeds=3)["theta"]
    assert fits.shape == (3,)
    assert sorted(fits)[1] == ceilings[1]
    with pytest.raises(IdentificationError, match="at least one"):
        gust_ceiling(steps, loop, RIG, seeds=0)
