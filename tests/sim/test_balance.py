"""The push along the rail that a log shows before the window, on flights of the virtual rig."""

from __future__ import annotations

import pytest

from twodof.experiment.flight import Laboratory
from twodof.flight.gains import DEFAULT
from twodof.flightlog.log import FlightLog
from twodof.rig.parameters import lab
from twodof.rig.steady_state import rail_force
from twodof.sim.flight_segment import read_segment


@pytest.mark.parametrize("push", [0.15, -0.1])
def test_the_push_of_a_rail_is_found_from_the_flight_before_the_window(push: float) -> None:
    """The sweep moves the cart, so friction is on both sides and what is left of the mean is the push.

    Gusts leave .01 rad of pitch, .03 N; dry friction, which is taken off the push, is .03 N.
    """
    log = Laboratory("lab", conditions={"rail_force": push}).fly("position-sweep", seed=2).log
    flown = read_segment(log, DEFAULT, (log.armed()[0][1] - 1.0, log.armed()[0][1]))
    found = rail_force(lab(), *flown.balance)
    assert found == pytest.approx(push, abs=0.05)
    assert found * push > 0.0


def test_a_short_flight_before_the_window_says_nothing() -> None:
    log = Laboratory("lab", conditions={"rail_force": 0.15}).fly("velocity-doublets", seed=2).log
    start = log.armed()[0][0]
    assert read_segment(log, DEFAULT, (start + 4.9, start + 6.0)).balance == (0.0, 0.0, 0.0)
    assert read_segment(log, DEFAULT, (start + 5.5, start + 7.0)).balance != (0.0, 0.0, 0.0)


def test_nothing_after_the_windows_start_is_used() -> None:
    log = Laboratory("lab").fly("velocity-doublets", seed=2).log
    window = (log.armed()[0][0] + 8.0, log.armed()[0][1])
    cut = FlightLog({name: channel.slice(0.0, window[0] + 0.2) for name, channel in log.channels.items()})
    whole = read_segment(log, DEFAULT, window).balance
    assert read_segment(cut, DEFAULT, (window[0], window[0] + 0.1)).balance == pytest.approx(whole, abs=1e-9)
