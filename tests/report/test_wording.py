"""Numbers carry the digits their standard deviation supports; colours are those of the page in the browser."""

import math
import re
from pathlib import Path

import pytest

from tools.design_tokens import COPIES, SOURCE, render
from twodof.report.content import Uncertain
from twodof.report.plots.canvas import design_colours, on_paper, style
from twodof.report.wording import deviation, plain, power_of_ten, text, with_sigma


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (3.43721, 0.0123, "3.437 ± 0.012"),
        (358.512, 7.96, "358.5 ± 8.0"),
        (358.512, 79.6, "359 ± 80"),
        (0.0836, 0.00996, "0.084 ± 0.010"),
        (-4.748, 0.0999, "−4.75 ± 0.10"),
        (3.437003, 2.1e-5, "3.4370 ± 0.00002"),
        (12.5, 3e-4, "12.500 ± 0.0003"),
        (1.0, math.nan, "1.000"),
        (1.0, 0.0, "1.000"),
    ],
)
def test_sigma_has_two_digits(value: float, sigma: float, text: str) -> None:
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


@pytest.mark.parametrize("copy", COPIES, ids=lambda path: path.parent.name)
def test_a_copy_is_the_source(copy: Path) -> None:
    assert copy.read_text(encoding="utf-8") == render(), "run: python -m tools.design_tokens"


def test_report_has_every_colour_of_the_page() -> None:
    named = set(re.findall(r"--([\w-]+):[^;]*#", SOURCE.read_text(encoding="utf-8")))
    assert set(design_colours()) == named
    light, dark = style().split("@media", 1)
    for name, shades in design_colours().items():
        assert f"--{name}: {shades.light};" in light
        assert f"--{name}: {shades.dark};" in dark


def test_colours_in_use_are_defined() -> None:
    used = set(re.findall(r"var\(--([\w-]+)\)", text("style.css")))
    assert used <= {*design_colours(), "paper"}
    assert on_paper()["paper"] == design_colours()["truth"].light
