"""Each parameter of the flight code is one row, from which its block's default and bounds come."""

import pytest

from twodof.compile.program.lower import lower
from twodof.flight.core import core
from twodof.flight.estimator import POSITION_FILTERS
from twodof.parameters import TUNABLES
from twodof.signals import PERIOD


@pytest.mark.parametrize("position_filter", POSITION_FILTERS)
def test_every_parameter_of_the_flight_code_is_as_its_row_says(position_filter: str) -> None:
    declared = lower(core(position_filter=position_filter, failsafe=True), PERIOD).parameters
    assert declared.keys() <= TUNABLES.keys(), "a parameter has no row"
    for path, parameter in declared.items():
        row, param = TUNABLES[path], parameter.declared
        assert (param.value, param.text) == (row.default, row.text), path
        assert param.kind == "bool" or (param.low, param.high) == (row.low, row.high), path


def test_every_row_is_a_parameter_of_the_flight_code() -> None:
    codes = (lower(core(position_filter=name, failsafe=True), PERIOD).parameters for name in POSITION_FILTERS)
    assert set(TUNABLES) == {path for code in codes for path in code}
