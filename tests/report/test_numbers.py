"""Numbers carry the digits their standard deviation supports."""

import math

import pytest

from twodof.report.content import Uncertain
from twodof.report.numbers import deviation, plain, power_of_ten, with_sigma


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (3.43721, 0.0123, "3.437 ± 0.012"),
        (358.512, 7.96, "358.5 ± 8.0"),
        (358.512, 79.6, "359 ± 80"),
        (0.0836, 0.00996, "0.084 ± 0.010"),
        (-4.748, 0.0999, "−4.75 ± 0.10"),
        (1.0, math.nan, "1.000"),
        (1.0, 0.0, "1.000"),
    ],
)
def test_sigma_has_two_digits_and_the_value_ends_where_it_does(value: float, sigma: float, text: str) -> None:
    assert with_sigma(Uncertain(value, sigma)) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(358.5, "358.5"), (0.0836, "0.08360"), (20.0, "20.00"), (0.0, "0"), (-1.5, "−1.500"), (math.inf, "–")],
)
def test_plain_numbers_have_four_significant_digits(value: float, text: str) -> None:
    assert plain(value) == text


def test_deviation_is_in_percent_and_in_standard_deviations() -> None:
    assert deviation(Uncertain(102.0, 4.0), 100.0) == "+2.0 %, 0.5 σ"
    assert deviation(Uncertain(98.0), 100.0) == "−2.0 %"


def test_small_numbers_have_a_power_of_ten() -> None:
    assert power_of_ten(4.94e-8) == "4.9·10⁻⁸"
    assert power_of_ten(-2.5e3) == "−2.5·10³"
    assert power_of_ten(0.0) == "0"
