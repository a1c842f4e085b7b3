"""The tick of the wire, of the flight code and of the log are one."""

from twodof.flight import core
from twodof.flightlog import steps
from twodof.link import tick


def test_the_wire_counts_the_periods_of_the_flight_code() -> None:
    assert tick.TICK_S == core.PERIOD == steps.PERIOD


def test_all_units_say_the_same() -> None:
    for number in (tick.TICK_US * 1e-6, tick.TICK_MS * 1e-3, tick.TICK_NS / 1e9):
        assert abs(number - core.PERIOD) < 1e-12  # rounding of one product
    assert type(tick.TICK_MS) is type(tick.TICK_NS) is int  # stamps are whole numbers
