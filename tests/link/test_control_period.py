"""The tick of the wire is the control period, in each unit."""

from twodof import signals as control_period
from twodof.signals import PERIOD


def test_the_wire_counts_the_periods_of_the_flight_code() -> None:
    assert control_period.TICK_S == PERIOD


def test_all_units_say_the_same() -> None:
    for number in (control_period.TICK_US * 1e-6, control_period.TICK_MS * 1e-3, control_period.TICK_NS / 1e9):
        assert abs(number - PERIOD) < 1e-12  # rounding of one product
    assert type(control_period.TICK_MS) is type(control_period.TICK_NS) is int  # stamps are whole numbers
