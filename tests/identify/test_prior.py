"""Priors: weighed against the data by their standard deviation, and named beside the estimate."""

import json
import math

import numpy as np
import pytest

from tests.identify.signals import DT, doublet, pitch_record
from twodof.blocks.diagram import Diagram
from twodof.errors import IdentificationError
from twodof.identify import Record, fit, predict
from twodof.models import PAPER_PITCH_RATE, Structure, pitch_rate
from twodof.models.around_plant import Offset
from twodof.models.structures import ROTOR_LAG

pytestmark = pytest.mark.slow

U = doublet(300, 0.2, 0.6, 0.03)


def constant() -> Structure:
    d = Diagram("constant")
    d.input("u")
    d.param("c")
    d.add("sum", Offset(), params={"offset": "c"}, u="u")
    d.output("y", "sum")
    return Structure(d, ("c",))


def measured(seed: int, count: int = 100, sigma: float = 0.5) -> Record:
    y = 3.0 + sigma * np.random.default_rng(seed).standard_normal(count)
    return Record.from_columns(DT * np.arange(count), {"u": np.zeros(count), "y": y}, ["u"], ["y"])


@pytest.mark.parametrize("disturbance", ["white", "ar"])
def test_prior_and_data_combine_as_normal_sources(disturbance: str) -> None:
    record = measured(1)
    plain = fit(constant(), record)
    mean, deviation = 2.8, 0.04
    found = fit(constant(), record, prior={"c": (mean, deviation)}, disturbance=disturbance)  # type: ignore[arg-type]
    weights = np.array([plain.cramer_rao("c") ** -2, deviation**-2])
    # The noise is estimated along, which a prior that is off by four deviations changes by some per cent.
    rel = 0.05 if disturbance == "white" else 0.15
    assert found.cramer_rao("c") == pytest.approx(weights.sum() ** -0.5, rel=rel)
    assert found["c"] == pytest.approx(weights @ [plain["c"], mean] / weights.sum(), abs=0.25 * deviation)
    assert "prior: c 2.8 +- 0.04" in found.table()
    assert json.loads(found.to_json())["prior"] == {"c": [mean, deviation]}


def test_an_infinite_doubt_is_none() -> None:
    record = measured(2)
    plain, found = fit(constant(), record), fit(constant(), record, prior={"c": (9.0, math.inf)})
    assert found["c"] == pytest.approx(plain["c"], rel=1e-9)
    assert found.cramer_rao("c") == pytest.approx(plain.cramer_rao("c"), rel=1e-9)
    assert found.prior == {}


def test_remarks_name_contradicted_and_repeated_priors() -> None:
    against = fit(constant(), measured(3, 1000), prior={"c": (2.0, 0.1)})
    assert any("contradict what was known of c, 2 +- 0.1" in remark for remark in against.remarks)
    repeated = fit(constant(), measured(3), prior={"c": (3.0, 0.001)})
    assert any("c is mostly its prior" in remark for remark in repeated.remarks)


@pytest.mark.parametrize("given", [(1.0,), (1.0, 0.0), (math.nan, 1.0), "ab", 3.0])
def test_a_prior_that_is_none_is_refused(given: object) -> None:
    with pytest.raises(IdentificationError, match="give \\(mean, standard deviation\\)"):
        fit(constant(), measured(4), prior={"c": given})  # type: ignore[dict-item]
    with pytest.raises(IdentificationError, match="no unknown is called 'd'"):
        fit(constant(), measured(4), prior={"d": (1.0, 1.0)})


def test_planning_knows_it_too_and_counts_it_once() -> None:
    u, noise, known = {"u": np.zeros(100)}, {"y": 0.5}, {"c": (3.0, 0.05)}
    for repeats in (1, 4):
        told = predict(constant(), u, DT, noise, prior=known, repeats=repeats)
        assert told.sigma[0] == pytest.approx((0.05**-2 + repeats * 100 / 0.5**2) ** -0.5, rel=1e-6)


def test_the_prior_of_the_lag_narrows_the_gain() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.3, np.random.default_rng(1))
    known = fit(pitch_rate(lag=True), record, disturbance="white")
    alone = fit(pitch_rate(lag=True), record, disturbance="white", prior={"lag": (0.012, math.inf)})
    assert known.prior == {"lag": ROTOR_LAG}
    assert known.sigma("lag") <= ROTOR_LAG[1]
    assert known.sigma("mu") < alone.sigma("mu") or "lag" in alone.at_bound
    held = fit(pitch_rate(lag=True), record, estimate=("mu", "dead_time"), values={"lag": 0.0114})
    assert held.prior == {}, "what is held needs no prior"
