"""Planning: predicted accuracy against closed forms and against what a fit then achieves; limits are kept."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.signals import DT, doublet, pitch_record
from twodof.errors import IdentificationError
from twodof.identify import (
    PITCH_LIMITS,
    RAIL_LIMITS,
    Limits,
    best,
    doublets,
    fit,
    multisines,
    predict,
    three_two_one_ones,
)
from twodof.identify.information import Family, simulate_planned
from twodof.models import PAPER_PITCH_RATE, pitch_rate, velocity

pytestmark = pytest.mark.slow

U = doublet(1500, 0.5, 0.6, 0.03)
CHOSEN = ("w_n", "xi", "mu", "tau")
LIMIT = PITCH_LIMITS.within["theta"]


def test_predicted_is_what_a_fit_then_claims() -> None:
    told = predict(pitch_rate(), {"M": U}, DT, {"q": 0.06}, values={"tau": 0.020}, estimate=CHOSEN)
    found = fit(pitch_rate(), pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(0)), estimate=CHOSEN)
    for label, sigma in zip(told.labels, told.sigma, strict=True):
        # The noise of 1500 samples is known to 2 %, the estimate is near the truth; tau's bound depends on where in
        # the sample the edge falls.
        assert found.cramer_rao(label) == pytest.approx(sigma, rel=0.15)
    assert "ratio" in told.beside(found)


def test_flying_again_helps_what_is_shared() -> None:
    arguments = (pitch_rate(), {"M": U}, DT, {"q": 0.06})
    one, four = predict(*arguments), predict(*arguments, repeats=4)
    for i, label in enumerate(one.labels):
        if label in CHOSEN:
            assert four.sigma[i] == pytest.approx(one.sigma[i] / 2.0, rel=1e-6)
        else:
            assert four.sigma[i] <= one.sigma[i]
            assert four.sigma[i] > one.sigma[i] / 2.0


def test_the_best_doublet_uses_the_pitch_limit() -> None:
    shapes = np.linspace(0.2, 2.0, 19)
    found = best(pitch_rate(), doublets(), shapes.tolist(), 8.0, DT, {"q": 0.06}, PITCH_LIMITS, estimate=CHOSEN)
    costs = [cost for _, _, cost in found.tried]
    assert found.cost == np.nanmin(costs)
    assert found.information.peaks["theta"] <= LIMIT
    # Nothing is left on the table: 2 % more amplitude would break the limit or the range of M.
    assert found.information.peaks["theta"] > 0.98 * LIMIT or found.excitation.peak == 1.0
    # The paper's own doublet keeps far from the limit and tells less.
    paper = predict(pitch_rate(), {"M": U}, DT, {"q": 0.06}, estimate=CHOSEN)
    assert found.information.sigma[found.information.labels.index("mu")] < paper.sigma[paper.labels.index("mu")]


@pytest.mark.parametrize("family", [doublets(), three_two_one_ones(), multisines(harmonics=6)])
def test_every_kind_keeps_the_limits(family: Family) -> None:
    found = best(pitch_rate(), family, [1.4, 2.8], 6.0, DT, {"q": 0.06}, PITCH_LIMITS, estimate=CHOSEN)
    _, u = found.excitation.samples(DT)
    played = np.zeros(round(6.0 / DT) + 1)
    played[: min(u.size, played.size)] = u[: played.size]
    theta = simulate_planned(pitch_rate(), {"M": played}, DT, {"tau": 0.015})["theta"]
    assert np.abs(theta).max() <= LIMIT * 1.001


def test_the_rail_limits_a_velocity_experiment() -> None:
    found = best(
        velocity(), doublets("rad"), [0.8, 1.2, 1.6, 2.0], 5.0, DT, {"v": 0.008}, RAIL_LIMITS, estimate=("k_v", "p_v")
    )
    assert found.information.travel["x"] <= RAIL_LIMITS.travel["x"]
    # A cart that sticks below 10 degrees: a long doublet of at least that much leaves the rail, and that is said.
    sticky = Limits(travel={"x": 0.8}, least=math.radians(10.0))
    with pytest.raises(IdentificationError, match=r"x travels more than 0.8 at the least amplitude 0.1745"):
        best(velocity(), doublets("rad"), [4.0], 6.0, DT, {"v": 0.008}, sticky, estimate=("k_v", "p_v"))


def test_unidentifiable_plans_are_refused() -> None:
    with pytest.raises(IdentificationError, match="cannot tell apart 'theta_0' and 'M_trim'"):
        predict(pitch_rate(), {"M": U}, DT, {"q": 0.06}, estimate=(*CHOSEN, "theta_0", "M_trim"))
    with pytest.raises(IdentificationError, match="none of the structure's outputs"):
        predict(pitch_rate(), {"M": U}, DT, {"v": 0.06})
    with pytest.raises(IdentificationError, match="is longer than 1 s"):
        best(pitch_rate(), doublets(), [3.0], 1.0, DT, {"q": 0.06}, PITCH_LIMITS)
    with pytest.raises(IdentificationError, match="equal lengths"):
        predict(pitch_rate(), {"M": U[:1]}, DT, {"q": 0.06})
    for repeats in (0, 1.5):
        with pytest.raises(IdentificationError, match="give a whole number, 1 or more"):
            predict(pitch_rate(), {"M": U}, DT, {"q": 0.06}, estimate=CHOSEN, repeats=repeats)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="give a time above 0"):
        predict(pitch_rate(), {"M": U}, 0.0, {"q": 0.06}, estimate=CHOSEN)


def test_the_bound_matches_its_closed_form() -> None:
    # v' = -p v - k u from rest: sensitivities to k and p are v / k and the response of the same lag to -v.
    k, p, sigma = 4.748, 1.168, 0.008
    u = doublet(1000, 0.5, 1.6, 0.26)
    told = predict(velocity(), {"theta": u}, DT, {"v": sigma}, estimate=("k_v", "p_v"))
    a = math.exp(-p * DT)
    v = lfilter([0.0, -k * (1.0 - a) / p], [1.0, -a], u)
    h = 1e-6
    b = math.exp(-(p + h) * DT)
    by_p = (lfilter([0.0, -k * (1.0 - b) / (p + h)], [1.0, -b], u) - v) / h
    by_k = v / k
    j = np.column_stack([by_k, by_p]) / sigma
    # One-sided differences of the closed form with a step of 1e-6.
    np.testing.assert_allclose(told.matrix, j.T @ j, rtol=1e-5)
