"""Autoregressions: against the covariance matrix of the process, and back from data to the process."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov, toeplitz

from twodof.identify.disturbance.autoregression import Autoregression, autoregression, pieces_of

pytestmark = pytest.mark.slow

# A resonance at 38 Hz of 250 Hz and a slow pole: 1 - 2 r cos(w) z^-1 + r^2 z^-2, times 1 - .95 z^-1.
RESONANCE = np.array([1.0, -2.0 * 0.77 * np.cos(2.0 * np.pi * 38.0 / 250.0), 0.77**2])
TRUE = np.convolve(RESONANCE, [1.0, -0.95])
SIGMA = 0.02


def autocovariance(lags: int) -> np.ndarray:
    """Of the true process, from the stationary covariance of its companion form."""
    n = TRUE.size - 1
    companion = np.eye(n, k=-1)
    companion[0] = -TRUE[1:]
    drive = np.zeros((n, n))
    drive[0, 0] = SIGMA**2
    state = solve_discrete_lyapunov(companion, drive)
    found = []
    for _ in range(lags):
        found.append(state[0, 0])
        state = companion @ state
    return np.array(found)


def sample(rng: np.random.Generator, size: int) -> np.ndarray:
    factor = np.linalg.cholesky(toeplitz(autocovariance(size)))
    return np.asarray(factor @ rng.standard_normal(size))


def true_model() -> Autoregression:
    """Predictors of all orders from the covariance: Yule-Walker."""
    covariance = autocovariance(TRUE.size)
    predictors, deviations = [], []
    for k in range(TRUE.size):
        a = np.linalg.solve(toeplitz(covariance[:k]), -covariance[1 : k + 1]) if k else np.zeros(0)
        predictors.append(np.append(1.0, a))
        deviations.append(np.sqrt(covariance[0] + covariance[1 : k + 1] @ a))
    return Autoregression(tuple(predictors), np.array(deviations))


def test_whitening_is_the_root_of_the_inverse_covariance() -> None:
    model, size = true_model(), 60
    np.testing.assert_allclose(model.coefficients, TRUE, rtol=1e-9)
    white = model.whiten(np.eye(size), [slice(0, size)])
    covariance = toeplitz(autocovariance(size))
    # Rounding, times the covariance's condition of some 1e3.
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(size), atol=1e-9)
    assert model.log_deviations([slice(0, size)]) == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_pieces_do_not_know_of_each_other() -> None:
    model = true_model()
    rows = np.random.default_rng(0).standard_normal((50, 2))
    together = model.whiten(rows, [slice(0, 20), slice(20, 22), slice(22, 50)])
    for piece in (slice(0, 20), slice(20, 22), slice(22, 50)):
        alone = model.whiten(rows[piece], [slice(0, piece.stop - piece.start)])
        np.testing.assert_array_equal(together[piece], alone)
    assert pieces_of(np.array([0.3, 1.3, 2.25, 4.3, 5.3])) == (slice(0, 3), slice(3, 5))


def test_data_give_the_process_back() -> None:
    noise = sample(np.random.default_rng(1), 1500)
    found = autoregression(noise, [slice(0, noise.size)])
    assert TRUE.size - 1 <= found.order <= 8  # the criterion takes a few too many now and then
    # The deviation of a variance from 1500 samples is 3.7 %.
    assert found.sigma == pytest.approx(SIGMA, rel=0.06)
    frequency = np.array([1.0, 38.0, 100.0])
    turn = np.exp(-2j * np.pi * 0.004 * np.outer(frequency, np.arange(found.order + 1)))
    power, true = (found.sigma / abs(turn @ found.coefficients)) ** 2, (SIGMA / abs(turn[:, :4] @ TRUE)) ** 2
    # A spectrum of so few poles scatters by sqrt(2 order / samples), some 10 %, and more where a pole is near.
    np.testing.assert_allclose(power, true, rtol=0.5)


def test_white_noise_has_order_nought() -> None:
    orders = [
        autoregression(np.random.default_rng(seed).standard_normal(400), [slice(0, 400)]).order for seed in range(20)
    ]
    # Akaike's criterion takes an order too many in some 3 of 10 cases.
    assert np.median(orders) == 0


def test_few_or_constant_samples_still_give_a_model() -> None:
    for noise in (np.zeros(100), np.array([0.1]), np.array([0.1, -0.1, 0.1]), np.ones(50)):
        model = autoregression(noise, [slice(0, noise.size)], spent=5)
        assert np.isfinite(model.whiten(noise, [slice(0, noise.size)])).all()
