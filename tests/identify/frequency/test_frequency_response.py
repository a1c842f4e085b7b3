"""The averaged frequency response against the exact one of the held model."""

import control
import numpy as np
import pytest

from tests.identify.signals import DT, pitch_record
from twodof.errors import IdentificationError
from twodof.identify.frequency.frequency_response import frequency_response
from twodof.models.plant import PitchRate

MODEL = PitchRate(3.437, 0.3, 358.5, 0.0187)


def exact(omega: np.ndarray) -> np.ndarray:
    """Response of the held, delayed, sampled model: what a record of it contains."""
    system = control.ss(*MODEL.state_space().zero_order_hold(DT).augmented(), DT)
    return np.asarray(system(np.exp(1j * omega * DT)))[1, 0]


def test_response_and_its_sigma_are_right() -> None:
    rng = np.random.default_rng(0)
    u = 0.03 * np.sign(rng.standard_normal(6000)).repeat(5)
    found = frequency_response(pitch_record(MODEL, u, 0.06, rng), "M", "q", segment=8.0)
    band = (found.omega > 2.0) & (found.omega < 60.0)
    error = abs(found.response - exact(found.omega))[band] / found.sigma[band]
    # |error|^2 / sigma^2 has mean 2 (real and imaginary part, each sigma): 74 points, half of them independent;
    # the window's leakage of the resonance adds some.
    assert np.sqrt(np.mean(error**2) / 2.0) == pytest.approx(1.0, abs=0.35)
    assert (found.coherence[band] > 0.5).all()


def test_coherence_tells_signal_from_noise() -> None:
    rng = np.random.default_rng(1)
    u = 0.03 * np.sign(rng.standard_normal(4000)).repeat(5)
    clean = frequency_response(pitch_record(MODEL, u, 0.0, rng), "M", "q", segment=8.0)
    noisy = frequency_response(pitch_record(MODEL, u, 100.0, rng), "M", "q", segment=8.0)
    middle = (clean.omega > 2.0) & (clean.omega < 60.0)
    # Near the resonance (3.4 rad/s) the window's leakage costs coherence even without noise.
    assert clean.coherence[middle & (clean.omega > 8.0)].min() > 0.95
    # Pure noise has a coherence of 1 / averages in the mean.
    assert noisy.coherence[middle].mean() == pytest.approx(1.0 / noisy.averages, rel=0.35)
    assert clean.trusted()[middle].all()
    assert "deg" in clean.table()


def test_what_cannot_be_averaged_is_refused() -> None:
    rng = np.random.default_rng(2)
    record = pitch_record(MODEL, np.zeros(1000), 0.06, rng)
    with pytest.raises(IdentificationError, match="does not move"):
        frequency_response(record, "M", "q")
    with pytest.raises(IdentificationError, match="do not fit at least twice"):
        frequency_response(record, "M", "q", segment=3.0)
    with pytest.raises(IdentificationError, match="does not hold 'T' as input"):
        frequency_response(record, "T", "q")
