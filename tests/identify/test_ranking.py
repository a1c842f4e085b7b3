"""Ranking of structures: criteria against the book, and the true structure among others."""

import numpy as np
import pytest
from scipy import signal, stats

from tests.identify.signals import DT, doublet, pitch_record
from twodof.errors import IdentificationError
from twodof.identify.greybox import fit
from twodof.identify.ranking import rank, select
from twodof.identify.record import Record
from twodof.models.plant import PitchRate
from twodof.models.structures import pitch_rate

pytestmark = pytest.mark.slow

MODEL = PitchRate(3.437, 0.3, 358.5, 0.0187)
VALUES = {"w_n": 3.437, "xi": 0.3, "tau": 0.0187}
APPLIED = doublet(400, 0.2, 0.6, 0.03)


def record(seed: int, coloured: bool = False) -> Record:
    rng = np.random.default_rng(seed)
    if not coloured:
        return pitch_record(MODEL, APPLIED, 0.06, rng)
    clean = pitch_record(MODEL, APPLIED, 0.0, rng)
    noise = signal.lfilter([0.03], [1.0, -0.9], rng.standard_normal(APPLIED.size))
    q = clean.outputs["q"].value + noise
    return Record.from_columns(DT * np.arange(APPLIED.size), {"M": APPLIED, "q": q}, ["M"], ["q"])


def test_the_criteria_are_those_of_the_book() -> None:
    data = record(0)
    fits = {
        "mu": fit(pitch_rate(), data, estimate=["mu"], values=VALUES),
        "mu tau": fit(pitch_rate(), data, estimate=["mu", "tau"], values=VALUES),
    }
    found = rank(fits)
    e = {name: one.identification[0].residual for name, one in fits.items()}
    n = APPLIED.size
    for one in found.candidates:
        # The likelihood by scipy's normal density, at the maximum-likelihood standard deviation.
        s = np.sqrt(np.mean(e[one.name] ** 2))
        likelihood = stats.norm.logpdf(e[one.name], scale=s).sum()
        assert one.aic == pytest.approx(2 * one.unknowns - 2 * likelihood, rel=1e-12)
        assert one.bic == pytest.approx(one.unknowns * np.log(n) - 2 * likelihood, rel=1e-12)
    assert sum(one.weight for one in found.candidates) == pytest.approx(1.0)


def test_an_unknown_at_its_bound_is_not_counted() -> None:
    """A drone without delay has tau at its bound of 0 in half of all flights."""
    plant = PitchRate(3.437, 0.3, 358.5, 0.0)
    for seed in range(10):
        data = pitch_record(plant, APPLIED, 0.06, np.random.default_rng(seed))
        fits = {
            name: fit(pitch_rate(), data, estimate=unknowns, values=VALUES | {"tau": 0.0})
            for name, unknowns in (("mu", ["mu"]), ("mu tau", ["mu", "tau"]))
        }
        if fits["mu tau"].at_bound:
            break
    assert fits["mu tau"].at_bound == ("tau",)
    sizes = {one.name: one.unknowns for one in rank(fits).candidates}
    assert sizes["mu tau"] == sizes["mu"]


@pytest.mark.parametrize("coloured", [False, True])
def test_superfluous_unknowns_gain_little(coloured: bool) -> None:
    """AIC gains 10 from a superfluous unknown once in two thousand, also under coloured noise that was whitened."""
    for seed in range(4):
        data = record(seed, coloured)
        fits = {
            name: fit(pitch_rate(), data, estimate=unknowns, values=VALUES, disturbance="ar" if coloured else "white")
            for name, unknowns in (("true", ["mu"]), ("more", ["mu", "tau" if coloured else "M_trim"]))
        }
        by_name = {one.name: one for one in rank(fits).candidates}
        assert by_name["true"].aic - by_name["more"].aic < 10.0


def test_select_finds_the_unknowns_that_matter() -> None:
    rng = np.random.default_rng(3)
    data = pitch_record(MODEL, APPLIED, 0.06, rng, trim=0.004)
    ranking, fits = select(
        pitch_rate(), data, ["mu", "tau"], ["M_trim", "q_bias"], values={"w_n": 3.437, "xi": 0.3}, criterion="bic"
    )
    assert ranking.best == "+ M_trim"
    assert fits[ranking.best]["M_trim"] == pytest.approx(0.004, abs=5e-4)
    assert list(fits) == ["-", "+ M_trim", "+ q_bias", "+ M_trim + q_bias"]
    aic = {one.name: one.aic for one in ranking.candidates}
    assert aic["-"] - aic["+ M_trim"] > 20.0
    assert aic["+ M_trim"] - aic["+ M_trim + q_bias"] < 10.0
    assert "+ M_trim" in ranking.table()


def test_what_cannot_be_compared_is_refused() -> None:
    one = fit(pitch_rate(), record(0), estimate=["mu"], values=VALUES)
    two = fit(pitch_rate(), record(1), estimate=["mu", "tau"], values=VALUES)
    banded = fit(pitch_rate(), record(0), estimate=["mu"], values=VALUES, band=(1.0, 20.0))
    with pytest.raises(IdentificationError, match="1 fits"):
        rank({"a": one})
    with pytest.raises(IdentificationError, match="0 fits"):
        rank([one, one])  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="different data"):
        rank({"a": one, "b": two})
    with pytest.raises(IdentificationError, match="frequency domain"):
        rank({"a": one, "b": banded})
    with pytest.raises(IdentificationError, match="criterion is 'r2'"):
        rank({"a": one, "b": one}, criterion="r2")
    with pytest.raises(IdentificationError, match="no unknown is called 'nu'"):
        select(pitch_rate(), record(0), ["mu"], ["nu"])
    with pytest.raises(IdentificationError, match="0 optional"):
        select(pitch_rate(), record(0), ["mu"], [])
