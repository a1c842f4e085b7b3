"""Measures of fit in closed form; residual tests that pass on noise and fail on what is not noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from twodof.errors import IdentificationError
from twodof.identify.covariance import ResidualRows, robust_covariance
from twodof.identify.validate import comparison, cross_correlation, fit_percent, rmse, vaf, whiteness


def test_measures_in_closed_form() -> None:
    y = np.array([1.0, -1.0, 1.0, -1.0])
    assert fit_percent(y, y) == 100.0
    assert fit_percent(y, np.zeros(4)) == 0.0
    assert fit_percent(y, 0.5 * y) == pytest.approx(50.0)
    assert vaf(y, 0.5 * y) == pytest.approx(75.0)
    assert rmse(y, 0.5 * y) == pytest.approx(0.5)
    # An offset costs FIT and RMSE, VAF does not see it.
    assert fit_percent(y, y + 0.1) == pytest.approx(90.0)
    assert vaf(y, y + 0.1) == pytest.approx(100.0)


def test_the_first_lag_is_one_sample() -> None:
    # 1, -1, 1, ...: n - k products of (-1)^k at lag k, over n squares.
    found = whiteness(np.tile([1.0, -1.0], 50))
    assert found.lags[0] == 1
    assert found.value == pytest.approx([(-1.0) ** k * (100 - k) / 100.0 for k in range(1, 26)])


def test_white_residuals_pass_as_often_as_promised() -> None:
    # Over 400 seeds: a lag lies outside its 99 % bound 1 % of the time, and both verdicts hold nearly always.
    rng = np.random.default_rng(0)
    u = np.sign(rng.standard_normal(100)).repeat(10)
    white = [whiteness(e) for e in rng.standard_normal((400, 1000))]
    cross = [cross_correlation(e, u) for e in rng.standard_normal((400, 1000))]
    outside = np.mean([test.outside / 25 for test in white])
    # 10,000 lags: one per cent with a standard deviation of 0.1 %; the finite record makes the bound 2 % wide.
    assert outside == pytest.approx(0.01, abs=0.004)
    assert np.mean([test.passed for test in white]) > 0.95
    assert np.mean([test.outside / 51 for test in cross]) == pytest.approx(0.01, abs=0.008)
    assert np.mean([test.passed for test in cross]) > 0.93


def test_coloured_residuals_fail_whiteness_but_not_independence() -> None:
    rng = np.random.default_rng(1)
    u = np.sign(rng.standard_normal(200)).repeat(10)
    coloured = [lfilter([1.0], [1.0, -0.7], rng.standard_normal(2000)) for _ in range(100)]
    assert not any(whiteness(e).passed for e in coloured)
    assert np.mean([cross_correlation(e, u).passed for e in coloured]) > 0.85


def test_unexplained_input_shows_at_its_lag() -> None:
    rng = np.random.default_rng(2)
    u = np.sign(rng.standard_normal(2000))
    test = cross_correlation(0.3 * np.roll(u, 4) + rng.standard_normal(2000), u)
    assert not test.passed
    assert test.lags[np.argmax(test.value)] == 4


def test_a_comparison_carries_figures_and_tests() -> None:
    rng = np.random.default_rng(3)
    u = np.sign(rng.standard_normal(60)).repeat(10)
    y = np.cumsum(u) / 10.0
    measured = y + 0.1 * rng.standard_normal(600)
    one = comparison("r", "q", np.arange(600.0), measured, y, {"u": u, "held": np.ones(600)})
    assert one.rmse == pytest.approx(0.1, rel=0.1)
    assert one.whiteness is not None
    assert one.whiteness.passed
    assert set(one.inputs) == {"u"}
    assert one.to_json()["residual_white"] is True
    short = comparison("r", "q", np.arange(50.0), measured[:50], y[:50], {"u": u[:50]})
    assert short.whiteness is None


def test_what_cannot_be_judged_is_refused() -> None:
    with pytest.raises(IdentificationError, match="constant"):
        fit_percent(np.ones(5), np.zeros(5))
    with pytest.raises(IdentificationError, match="differ or are empty"):
        rmse(np.ones(5), np.zeros(4))
    with pytest.raises(IdentificationError, match="NaN"):
        vaf(np.array([1.0, np.nan]), np.zeros(2))
    with pytest.raises(IdentificationError, match="too few"):
        whiteness(np.ones(30))
    with pytest.raises(IdentificationError, match="all equal"):
        whiteness(np.ones(300))
    with pytest.raises(IdentificationError, match="input is constant"):
        cross_correlation(np.arange(300.0), np.ones(300))
    for level in (0.0, 1.0, np.nan):
        with pytest.raises(IdentificationError, match=r"the level is .*between 0 and 1"):
            whiteness(np.arange(300.0), level=level)


def test_robust_covariance_is_the_newey_west_sum() -> None:
    """(J'J)^-1 sum_st J_s' w(s - t) c(s - t) J_t (J'J)^-1 with Bartlett's weights (Newey and West, 1987)."""
    rng = np.random.default_rng(5)
    when = np.delete(np.arange(60), [7, 8, 30])
    n = when.size
    jacobian, residual = rng.standard_normal((n, 2)), np.convolve(rng.standard_normal(n + 4), np.ones(5), "valid")
    spread = np.zeros(60)
    spread[when] = residual
    reach = 16  # 2 sqrt(60), rounded up
    meat = np.zeros((2, 2))
    for s in range(n):
        for t in range(n):
            lag = abs(int(when[s]) - int(when[t]))
            if lag <= reach:
                correlation = float(spread[: 60 - lag] @ spread[lag:]) / n
                meat += (1.0 - lag / (reach + 1.0)) * correlation * np.outer(jacobian[s], jacobian[t])
    bread = np.linalg.inv(jacobian.T @ jacobian)
    expected = n / (n - 2) * bread @ meat @ bread
    found = robust_covariance(jacobian, residual, [ResidualRows(0, "y", slice(0, n), when)], spectral=False)
    assert found == pytest.approx(expected, rel=1e-9)
