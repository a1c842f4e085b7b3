"""Simulations of a record: what a fit compared, states that the first samples tell, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.signals import DT, doublet, pitch_record
from twodof.errors import IdentificationError, ParameterError
from twodof.identify import Record, Samples, fit, initial_state, predict_ahead, simulate
from twodof.models import Structure, pitch_rate
from twodof.models.plant import PAPER_PITCH_RATE

pytestmark = pytest.mark.slow

U = doublet(600, 0.4, 0.6, 0.03)
TRUE = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.020}


def test_it_gives_what_the_fit_compared() -> None:
    rng = np.random.default_rng(1)
    records = [pitch_record(PAPER_PITCH_RATE, U, 0.06, rng, name=name) for name in ("one", "two")]
    found = fit(pitch_rate(), records, estimate=("mu", "tau", "q_0"))
    for record, compared in zip(records, found.identification, strict=True):
        assert np.allclose(simulate(pitch_rate(), record, found)["q"], compared.simulated, atol=1e-12)


def test_the_first_samples_tell_the_initial_state() -> None:
    plant = PAPER_PITCH_RATE.state_space().zero_order_hold(DT)
    q = plant.simulate(U, x0=[0.2, -0.5])[:, 1]
    record = Record.from_columns(DT * np.arange(U.size), {"M": U, "q": q}, ["M"], ["q"])
    found = initial_state(pitch_rate(), record, TRUE, samples=50)
    # Without noise what is left is the search's own tolerance.
    assert found == pytest.approx({"theta_0": 0.2, "q_0": -0.5}, abs=1e-6)
    assert np.abs(simulate(pitch_rate(), record, TRUE, initial=50)["q"] - q).max() < 1e-6
    assert np.abs(simulate(pitch_rate(), record, TRUE)["q"] - q).max() > 0.3
    # What comes after the first samples does not count.
    changed = q.copy()
    changed[50:] = 9.0
    other = Record.from_columns(DT * np.arange(U.size), {"M": U, "q": changed}, ["M"], ["q"])
    assert initial_state(pitch_rate(), other, TRUE, samples=50) == found


def test_a_piece_is_predicted_by_the_noise_of_its_flight() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.0, np.random.default_rng(5), name="one")
    v = lfilter([1.0], [1.0, -0.9], 0.05 * np.random.default_rng(6).standard_normal(U.size))
    noisy = replace(record, outputs={"q": replace(record.outputs["q"], value=record.outputs["q"].value + v)})
    other = replace(noisy, name="two")
    found = fit(pitch_rate(), [noisy, other], estimate="mu", values=TRUE, disturbance="ar")
    piece = replace(noisy, name="one, piece 1", flight="one")
    whole, same = (predict_ahead(pitch_rate(), one, found, steps=1)["q"] for one in (noisy, piece))
    assert (same == whole).all()


def test_an_unobservable_state_keeps_its_value() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.0, np.random.default_rng(3))
    found = initial_state(pitch_rate(), record, {**TRUE, "theta_0": 0.125}, samples=1)
    assert found["theta_0"] == 0.125  # the first sample of q is q_0
    assert found["q_0"] == pytest.approx(0.0, abs=1e-6)


def test_coloured_noise_is_predicted_optimally() -> None:
    # v[t] = a v[t-1] + e[t]: the best prediction n ahead errs by sigma sqrt((1 - a^2n) / (1 - a^2)).
    a, sigma, size = 0.9, 0.05, 20_000
    generator = np.random.default_rng(4)
    u = doublet(size, 0.4, 0.6, 0.03)
    v = lfilter([1.0], [1.0, -a], sigma * generator.standard_normal(size))
    q = PAPER_PITCH_RATE.state_space().zero_order_hold(DT).simulate(u)[:, 1]
    record = Record.from_columns(DT * np.arange(size), {"M": u, "q": q + v}, ["M"], ["q"])
    before = np.inf
    for steps in (40, 10, 3, 1):
        error = q + v - predict_ahead(pitch_rate(), record, TRUE, steps=steps)["q"]
        expected = sigma * np.sqrt((1.0 - a ** (2 * steps)) / (1.0 - a**2))
        # The mean square of n-correlated samples: its relative deviation is sqrt(2 * 19 / size) at most, 4 %.
        assert error.std() == pytest.approx(expected, rel=0.06)
        assert error.std() < before
        before = error.std()
    assert np.allclose(predict_ahead(pitch_rate(), record, TRUE, steps=2000)["q"], q, atol=1e-6)


def test_a_prediction_uses_earlier_samples_alone() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(5))
    coloured = record.outputs["q"].value + np.convolve(record.outputs["q"].value, np.ones(5), "same") * 0.2
    record = Record.from_columns(DT * np.arange(U.size), {"M": U, "q": coloured}, ["M"], ["q"])
    found = fit(pitch_rate(), record, estimate=("mu", "tau"), disturbance="ar")
    whole = predict_ahead(pitch_rate(), record, found, steps=3)["q"]
    changed = coloured.copy()
    changed[300:] += 1.0
    other = Record.from_columns(DT * np.arange(U.size), {"M": U, "q": changed}, ["M"], ["q"])
    again = predict_ahead(pitch_rate(), other, found, steps=3)["q"]
    assert (again[:303] == whole[:303]).all()
    assert (again[303:310] != whole[303:310]).all()
    white = fit(pitch_rate(), record, estimate=("mu", "tau"), disturbance="white")
    simulated = simulate(pitch_rate(), record, white)["q"]
    assert (predict_ahead(pitch_rate(), record, white, steps=1)["q"] == simulated).all()


def test_what_is_refused() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(2))
    with pytest.raises(IdentificationError, match="no unknown is called 'mue'"):
        simulate(pitch_rate(), record, {"mue": 1.0})
    for value in (float("nan"), "x", None, True):
        with pytest.raises(IdentificationError, match="'mu' is not a number"):
            simulate(pitch_rate(), record, {"mu": value})  # type: ignore[dict-item]
    with pytest.raises(IdentificationError, match="give a dict by name"):
        simulate(pitch_rate(), record, "mu")  # type: ignore[arg-type]
    for odd in (2.5, "x"):
        with pytest.raises(IdentificationError, match="give a whole number"):
            simulate(pitch_rate(), record, TRUE, initial=odd)  # type: ignore[arg-type]
        with pytest.raises(IdentificationError, match="samples ahead"):
            predict_ahead(pitch_rate(), record, TRUE, steps=odd)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="outside"):
        simulate(pitch_rate(), record, {"mu": 1e9})
    for odd in (0, -3):
        with pytest.raises(IdentificationError, match="samples hold no sample"):
            simulate(pitch_rate(), record, TRUE, initial=odd)
        with pytest.raises(IdentificationError, match="samples ahead"):
            predict_ahead(pitch_rate(), record, TRUE, steps=odd)
    with pytest.raises(IdentificationError, match="is not a structure"):
        simulate(pitch_rate, record)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="is not a record"):
        simulate(pitch_rate(), [record])  # type: ignore[arg-type]
    late = Record.from_channels({"M": (record.time, U), "q": (record.time[100:], U[100:])}, ["M"], ["q"])
    with pytest.raises(IdentificationError, match="samples hold no sample"):
        simulate(pitch_rate(), late, TRUE, initial=50)
    with pytest.raises(IdentificationError, match="no initial states"):
        initial_state(Structure(pitch_rate().diagram, ("mu",)), record)


@pytest.mark.parametrize("early", [0.1, 0.5, 0.9])
def test_outputs_between_steps_are_simulated_exactly(early: float) -> None:
    # Edges at every step, as a controller makes them: linear interpolation between the steps misses each of them.
    rng = np.random.default_rng(5)
    u = 0.03 * rng.standard_normal(200)
    u[:10] = 0.0  # at rest, so that it does not matter that the state at the start is that of a fraction before
    true = {"w_n": 2.8, "xi": 0.04, "mu": 300.0, "dead_time": 0.0096, "lag": 0.0114, "theta_0": 0.0, "q_0": 0.0}
    grid = np.arange(u.size, dtype=float)
    between = Record("between", DT, 0.0, {"M": u}, {"q": Samples(grid[1:] - early, np.zeros(u.size - 1))})
    found = simulate(pitch_rate(lag=True), between, true)["q"]
    # The same instants on a grid 40 times as fine, which they lie on.
    fine = 40
    many = np.repeat(u, fine)
    place = np.rint(fine * (grid[1:] - early)).astype(int)
    record = Record("fine", DT / fine, 0.0, {"M": many}, {"q": Samples(np.arange(many.size, dtype=float), 0.0 * many)})
    expected = simulate(pitch_rate(lag=True, ring=400), record, true)["q"][place]
    assert np.abs(found - expected).max() < 1e-9
    on_steps = Record("on", DT, 0.0, {"M": u}, {"q": Samples(grid, 0.0 * u)})
    plain = np.interp(grid[1:] - early, grid, simulate(pitch_rate(lag=True), on_steps, true)["q"])
    assert np.abs(plain - expected).max() > 1e-4, "this is what it would be without"
