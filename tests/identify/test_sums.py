"""A sum of unknowns, such as the total delay: known far better than its parts, and said so."""

import json

import numpy as np
import pytest

from tests.identify.signals import DT, doublet
from twodof.errors import IdentificationError
from twodof.identify import Record, fit
from twodof.identify.information import simulate_planned
from twodof.models import pitch_rate

TRUTH = {"w_n": 2.8, "xi": 0.04, "mu": 300.0, "dead_time": 0.0092, "lag": 0.012, "theta_0": 0.0, "q_0": 0.0}
SIGMA = 0.02


@pytest.fixture(scope="module")
def record() -> Record:
    u = doublet(300, 0.2, 0.6, 0.03)
    q = simulate_planned(pitch_rate(lag=True), {"M": u}, DT, TRUTH)["q"]
    noise = SIGMA * np.random.default_rng(3).standard_normal(u.size)
    return Record.from_columns(DT * np.arange(u.size), {"M": u, "q": q + noise}, ["M"], ["q"])


def test_total_delay_is_known_better_than_parts(record: Record) -> None:
    found = fit(pitch_rate(lag=True), record)
    assert found.summed == ("tau",)
    assert found["tau"] == found["dead_time"] + found["lag"]
    assert found.unit("tau") == "s"
    weights = np.array([label in ("dead_time", "lag") for label in found.labels], dtype=float)
    assert found.sigma("tau") == pytest.approx(np.sqrt(weights @ found.quoted @ weights), rel=1e-12)
    # What one part gains the other loses.
    assert found.sigma("tau") < 0.5 * min(found.sigma("dead_time"), found.sigma("lag"))
    # 4 deviations: once in 16,000.
    assert abs(found["tau"] - 0.0212) < 4.0 * found.sigma("tau")
    assert "(dead_time + lag)" in found.table()
    assert json.loads(found.to_json())["sums"]["tau"]["value"] == found["tau"]


def test_a_held_part_counts_with_its_value(record: Record) -> None:
    free = tuple(name for name in TRUTH if name != "lag")
    found = fit(pitch_rate(lag=True), record, estimate=free, values={"lag": 0.012})
    assert found["tau"] == found["dead_time"] + 0.012
    assert found.sigma("tau") == found.sigma("dead_time")
    # With both held there is nothing to say.
    held = fit(pitch_rate(lag=True), record, estimate=("mu",), values=TRUTH)
    assert held.summed == ()
    with pytest.raises(IdentificationError, match="'tau' was not estimated"):
        held.sigma("tau")


def test_a_bound_leaves_the_total_delay_accurate(record: Record) -> None:
    free = fit(pitch_rate(lag=True), record)
    high = free["lag"] - 0.3 * free.sigma("lag")
    held = fit(pitch_rate(lag=True), record, bounds={"lag": (0.0005, high)}, values={"lag": 0.005})
    assert held.at_bound == ("lag",)
    assert np.isnan(held.sigma("lag"))
    # The bound is within a deviation of the optimum, so the doubt is the same but for the curvature there.
    assert held.sigma("tau") == pytest.approx(free.sigma("tau"), rel=0.2)
    assert held.sigma("mu") == pytest.approx(free.sigma("mu"), rel=0.2)
