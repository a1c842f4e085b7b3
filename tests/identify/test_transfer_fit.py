"""Transfer functions fitted to frequency responses: exact ones, python-control's, and noisy records."""

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.identify.signals import DT, pitch_record
from twodof.errors import IdentificationError
from twodof.identify.frequency_response import FrequencyResponse, frequency_response
from twodof.identify.transfer_fit import fit_transfer
from twodof.models.plant import PitchRate

pytestmark = pytest.mark.slow

OMEGA = np.geomspace(0.5, 60.0, 80)


def response_of(values: NDArray[np.complex128], omega: NDArray[np.float64] = OMEGA) -> FrequencyResponse:
    """A response as if it had been measured with 1 % of error."""
    flat = np.ones(omega.size)
    return FrequencyResponse(
        "u", "y", omega, values, 0.99 * flat, 0.01 * abs(values), 50.0, 0.99 * flat, DT, flat, 49.0 * flat
    )


@pytest.mark.parametrize(
    ("top", "bottom", "orders", "power"),
    [
        ([5.0], [1.0, 3.0], (0, 1), 0),
        ([358.5, 0.0], [1.0, 0.57, 11.8], (0, 2), 1),
        ([2.0, 8.0, 40.0], [1.0, 4.0, 30.0, 60.0], (2, 3), 0),
        ([-3.0, 12.0], [1.0, 2.0, 25.0, 0.0], (1, 2), -1),
    ],
)
def test_an_exact_response_gives_back_its_coefficients(
    top: list[float], bottom: list[float], orders: tuple[int, int], power: int
) -> None:
    truth = control.tf(top, bottom)
    values = np.asarray(truth(1j * OMEGA)) * np.exp(-0.018j * OMEGA)
    found = fit_transfer(response_of(values), *orders, power=power, held=False)
    # A search on differences ends within their rounding.
    np.testing.assert_allclose(found.numerator, top, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(found.denominator, bottom, rtol=1e-4, atol=1e-6)
    assert found.dead_time == pytest.approx(0.018, rel=1e-4)
    assert found.cost < 1e-6
    again = control.frequency_response(control.tf(found.numerator, found.denominator), OMEGA).complex
    np.testing.assert_allclose(found.response(OMEGA), again * np.exp(-1j * found.dead_time * OMEGA), rtol=1e-9)
    poles = sorted(one.value for one in found.factors if one.kind == "pole")
    roots = np.roots(bottom[: len(bottom) + min(power, 0)])
    assert poles == pytest.approx(sorted({round(abs(one), 9) for one in roots}), rel=1e-4)


def test_the_cost_is_that_of_the_book() -> None:
    """One dB off everywhere: J = 20 W^2; one degree off everywhere: .01745 of it; W^2 = (1.58 (1 - exp(-.99)))^2."""
    weight = (1.58 * (1.0 - np.exp(-0.99))) ** 2
    flat = np.ones(OMEGA.size, dtype=complex)
    off = np.where(np.arange(OMEGA.size) % 2 == 0, 1.0, -1.0)
    for error, expected in ((10.0 ** (off / 20.0), 20.0), (np.exp(1j * np.radians(off)), 20.0 * 0.01745)):
        found = fit_transfer(response_of(flat * error), 0, 0, dead_time=False, held=False)
        assert found["b0"] == pytest.approx(1.0, abs=1e-3)
        assert found.cost == pytest.approx(expected * weight, rel=1e-3)


def test_intervals_hold_the_truth_of_records() -> None:
    model = PitchRate(12.0, 0.9, 358.5, 0.0187)
    truth = {"b0": 358.5, "a0": 144.0, "a1": 21.6, "tau": 0.0187}
    inside = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        record = pitch_record(model, 0.03 * np.sign(rng.standard_normal(2000)).repeat(5), 0.15, rng)
        response = frequency_response(record, "M", "q", segment=5.0)
        found = fit_transfer(response, 0, 2, power=1, band=(3.0, 60.0), coherence=0.3)
        assert found.converged
        inside += [low < truth[name] < high for name in truth for low, high in [found.interval(name)]]
    # 60 intervals of 95 %, correlated by fours: fewer than 86 % would be a chance of one in a thousand.
    assert np.mean(inside) > 0.86


def test_a_coefficient_and_the_hold_can_be_fixed() -> None:
    values = 5.0 / (1j * OMEGA + 3.0)
    hold = (1.0 - np.exp(-1j * OMEGA * DT)) / (1j * OMEGA * DT)
    found = fit_transfer(response_of(values * hold), 0, 1, values={"a0": 3.0})
    assert found["a0"] == 3.0
    assert found.sigma("a0") == 0.0
    assert found["tau"] == pytest.approx(0.0, abs=1e-7)
    # The hold also costs a little gain, which a1 takes.
    assert fit_transfer(response_of(values * hold), 0, 1, held=False)["tau"] == pytest.approx(DT / 2, rel=3e-3)
    assert "held: a0 3" in found.table()


def test_a_band_of_none_is_the_whole() -> None:
    good = response_of(5.0 / (1j * OMEGA + 3.0))
    assert fit_transfer(good, 0, 1, band=None)["a0"] == fit_transfer(good, 0, 1)["a0"]


def test_what_cannot_be_fitted_is_refused() -> None:
    good = response_of(5.0 / (1j * OMEGA + 3.0))
    for order in (-1, 1.5, None):
        with pytest.raises(IdentificationError, match=f"order is {order}"):
            fit_transfer(good, order, 1)  # type: ignore[arg-type]
    for value in (np.nan, np.inf, "3"):
        with pytest.raises(IdentificationError, match="give a finite number"):
            fit_transfer(good, 0, 1, values={"a0": value})  # type: ignore[dict-item]
    for band in ((1.0,), 5.0, "ab"):
        with pytest.raises(IdentificationError, match="the band is"):
            fit_transfer(good, 0, 1, band=band)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="call frequency_response first"):
        fit_transfer(good.response, 0, 1)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="no coefficient named 'mu'"):
        fit_transfer(good, 0, 1, values={"mu": 3.0})
    with pytest.raises(IdentificationError, match="0 points with a coherence"):
        fit_transfer(good, 0, 1, band=(1000.0, 2000.0))
    with pytest.raises(IdentificationError, match="every coefficient is held"):
        fit_transfer(good, 0, 0, dead_time=False, values={"b0": 1.0})
    with pytest.raises(IdentificationError, match="0 points"):
        fit_transfer(replace(good, sigma=np.full(OMEGA.size, np.inf)), 0, 1)
