"""Words and numbers of the report: the files in `templates/`, and numbers with the digits that sigma supports."""

import functools
import math
import tomllib
from importlib import resources
from string import Template
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twodof.report.content import Uncertain

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def fill(template: str, **fields: object) -> str:
    """Return the filled text of a file in `templates/`. Raises KeyError for a field of it that is not given."""
    return Template(text(template)).substitute(**fields)


def say(key: str, **fields: object) -> str:
    """Return a text of `words.toml` with its fields filled in."""
    words: str = table("words.toml")[key]
    return words.format(**fields)


@functools.cache
def table(name: str) -> dict[str, Any]:
    """Return the tables of a TOML file in `templates/`."""
    return tomllib.loads(text(name))


@functools.cache
def text(name: str) -> str:
    """Return the text of a file in `templates/` as it is."""
    return resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8")


_DIGITS = 5
"""Digits of a value that a reader compares at a glance."""


def plain(value: float, digits: int = 4) -> str:
    """Return `value` to `digits` significant digits, without an exponent, or an en dash for NaN."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}".replace("-", "−")


def with_sigma(estimate: "Uncertain") -> str:
    """Return `3.437 ± 0.012`: sigma to two significant digits, the value to the same place.

    A value has five digits at most: 3.4370 ± 0.00002 stands beside figures of real flights.
    """
    if not math.isfinite(estimate.sigma) or estimate.sigma <= 0.0:
        return plain(estimate.value)
    decimals = max(0, 1 - math.floor(math.log10(estimate.sigma)))
    # 0.0996 rounds up to 0.10, which has its two digits one place earlier.
    decimals = max(0, 1 - math.floor(math.log10(float(f"{estimate.sigma:.{decimals}f}"))))
    most = _DIGITS - 1 - math.floor(math.log10(abs(estimate.value))) if estimate.value else decimals
    if decimals > most:
        return f"{plain(estimate.value, _DIGITS)} ± {plain(estimate.sigma, 1)}"
    value = f"{estimate.value:.{decimals}f}".replace("-", "−")
    return f"{value} ± {estimate.sigma:.{decimals}f}"


def deviation(estimate: "Uncertain", truth: float) -> str:
    """Return the deviation of an estimate from the truth in percent and, if it has a sigma, in sigmas."""
    percent = f"{100.0 * (estimate.value - truth) / truth:+.1f} %".replace("-", "−")
    if not math.isfinite(estimate.sigma) or estimate.sigma <= 0.0:
        return percent
    return f"{percent}, {abs(estimate.value - truth) / estimate.sigma:.1f} σ"


def power_of_ten(value: float) -> str:
    """Return a small number as `4.9·10⁻⁸`."""
    if not math.isfinite(value) or value == 0.0:
        return plain(value)
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}".replace("-", "−")
