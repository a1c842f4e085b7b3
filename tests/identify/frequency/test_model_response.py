"""The response of an identified model against python-control, and its band against the spread of many fits."""

import control
import numpy as np
import pytest

from tests.identify.signals import DT, doublet, pitch_record
from twodof.errors import DiagramError, IdentificationError
from twodof.identify.frequency.model_response import model_response
from twodof.identify.greybox import fit
from twodof.models.plant import PitchRate
from twodof.models.structures import free_response, pitch_rate

pytestmark = pytest.mark.slow

MODEL = PitchRate(3.437, 0.3, 358.5, 0.0187)
OMEGA = np.geomspace(1.0, 300.0, 25)
HELD = {"estimate": ["mu", "tau"], "values": {"w_n": 3.437, "xi": 0.3}}


def test_the_response_is_that_of_the_sampled_model() -> None:
    record = pitch_record(MODEL, doublet(400, 0.2, 0.6, 0.03), 0.06, np.random.default_rng(1))
    found = fit(pitch_rate(), record, **HELD)  # type: ignore[arg-type]
    made = model_response(pitch_rate(), found, "M", "q", OMEGA, DT)
    same = PitchRate(3.437, 0.3, found["mu"], found["tau"])
    system = control.ss(*same.state_space().zero_order_hold(DT).augmented(), DT)
    exact = np.asarray(control.frequency_response(system, OMEGA).complex)[1, 0]
    np.testing.assert_allclose(made.response, exact, rtol=1e-8)
    # mu scales the gain, tau turns the phase by omega; beyond that the held fraction of a step changes the gain little.
    slow = OMEGA < 30.0
    assert made.gain_sigma[slow] == pytest.approx(found.sigma("mu") / found["mu"], rel=0.02)
    assert made.phase_sigma[slow] == pytest.approx(OMEGA[slow] * found.sigma("tau"), rel=0.02)


def test_the_band_is_as_wide_as_fits_spread() -> None:
    fits = [
        fit(pitch_rate(), pitch_record(MODEL, doublet(400, 0.2, 0.6, 0.03), 0.1, np.random.default_rng(seed)))
        for seed in range(12)
    ]
    omega = np.array([4.0, 20.0])
    made = [
        PitchRate(*(one[name] for name in ("w_n", "xi", "mu", "tau"))).state_space().response(omega) for one in fits
    ]
    spread = np.std([np.log(abs(one[:, 1, 0])) for one in made], axis=0, ddof=1)
    claimed = model_response(pitch_rate(), fits[0], "M", "q", omega, DT).gain_sigma
    # A standard deviation from 12 is known to 21 %: a factor of two is five of these.
    assert (spread / claimed > 0.5).all()
    assert (spread / claimed < 2.0).all()


def test_what_cannot_be_linearised_is_said() -> None:
    record = pitch_record(MODEL, doublet(400, 0.2, 0.6, 0.03), 0.06, np.random.default_rng(1))
    found = fit(pitch_rate(), record, **HELD)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="no response from 'T'"):
        model_response(pitch_rate(), found, "T", "q", OMEGA, DT)
    with pytest.raises(DiagramError, match="kink"):
        model_response(free_response(), found, "M", "q", OMEGA, DT)
