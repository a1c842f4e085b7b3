"""Numbers as a reader wants them: as many digits as their standard deviation supports."""

import math

from twodof.report.content import Uncertain


def plain(value: float, digits: int = 4) -> str:
    """`value` to `digits` significant digits, without an exponent, or an en dash for NaN."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}".replace("-", "−")


def with_sigma(estimate: Uncertain) -> str:
    """`3.437 ± 0.012`: sigma to two significant digits, the value to the same place."""
    if not math.isfinite(estimate.sigma) or estimate.sigma <= 0.0:
        return plain(estimate.value)
    decimals = max(0, 1 - math.floor(math.log10(estimate.sigma)))
    # 0.0996 rounds up to 0.10, which has its two digits one place earlier.
    decimals = max(0, 1 - math.floor(math.log10(float(f"{estimate.sigma:.{decimals}f}"))))
    value = f"{estimate.value:.{decimals}f}".replace("-", "−")
    return f"{value} ± {estimate.sigma:.{decimals}f}"


def deviation(estimate: Uncertain, truth: float) -> str:
    """How far an estimate is from the truth in percent and, if its sigma claims to cover that, in sigmas."""
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


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
