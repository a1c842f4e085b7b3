"""Gusts at the input: intervals that hold the truth, the gust itself, and the prediction of a further flight."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.signals import DT, doublet
from twodof.errors import IdentificationError
from twodof.identify import DisturbanceModel, Estimate, Record, fit, predict
from twodof.identify.information import simulate_planned
from twodof.models.structures import free_response, pitch_rate

pytestmark = pytest.mark.slow

STRUCTURE = pitch_rate(lag=True)
HELD = {"w_n": 3.437, "xi": 0.0836, "lag": 0.011}
TRUE_MU = 300.0
TRUTH = {**HELD, "mu": TRUE_MU, "dead_time": 0.0095}
WANTED = ("mu", "dead_time", "theta_0", "q_0")
SEEDS = range(1, 7)
PUSH, TIME = 0.006, 0.12
U = doublet(300, 0.2, 0.6, 0.03)


def flown(seed: int, push: float = PUSH, vibration: float = 0.01) -> Record:
    """A doublet under a push at the input; at the gyro a vibration of 38 Hz and .5 mrad/s of white noise."""
    rng = np.random.default_rng(seed)
    before, steps = 500, U.size
    keep = np.exp(-DT / TIME)
    gust = push * lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(before + steps))
    applied = np.concatenate([np.zeros(before), U]) + gust
    moved = simulate_planned(STRUCTURE, {"M": applied}, DT, TRUTH)["q"][before:]
    turn = 1.6 * np.cos(2.0 * np.pi * 38.0 * DT)
    shaken = lfilter(np.sqrt(0.2) * np.array([1.0, 0.0, -1.0]), [1.0, -turn, 0.6], rng.standard_normal(before + steps))
    q = moved + vibration * shaken[before:] + 5e-4 * rng.standard_normal(steps)
    return Record.from_columns(DT * np.arange(steps), {"M": U, "q": q}, ["M"], ["q"], f"flight {seed}")


@pytest.fixture(scope="module")
def found() -> list[Estimate]:
    return [fit(STRUCTURE, flown(seed), estimate=WANTED, values=HELD) for seed in SEEDS]


@pytest.mark.long
def test_intervals_under_gusts_hold_the_truth(found: list[Estimate]) -> None:
    z = np.array([(one["mu"] - TRUE_MU) / one.sigma("mu") for one in found])
    # Chi-square of 6: above 22.5 once in a thousand.
    assert float(z @ z) < 22.5
    white = [fit(STRUCTURE, flown(seed), estimate=WANTED, values=HELD, disturbance="white") for seed in SEEDS]
    too_sure = np.array([(one["mu"] - TRUE_MU) / one.sigma("mu") for one in white])
    assert float(too_sure @ too_sure) > 2.0 * 22.5
    # And it is not because the deviations are large: the estimates themselves are nearer.
    assert np.std([one["mu"] for one in found]) < np.std([one["mu"] for one in white])


@pytest.mark.long
def test_the_gust_is_found_beside_a_vibration(found: list[Estimate]) -> None:
    gusts = [one.disturbance.gusts["q"] for one in found if one.disturbance.kind == "input"]
    assert len(gusts) >= 5  # a whiteness test at 99 % may pass one
    assert {gust.input for gust in gusts} == {"M"}
    # One record of 1.2 s holds ten correlation times: each figure to a factor, their medians to half of one.
    assert np.median([gust.std for gust in gusts]) == pytest.approx(PUSH, rel=0.5)
    assert np.median([gust.correlation_time for gust in gusts]) == pytest.approx(TIME, rel=0.6)
    assert np.median([gust.frequency for gust in gusts]) == pytest.approx(38.0, abs=4.0)
    assert np.median([gust.narrow for gust in gusts]) == pytest.approx(0.01, rel=0.2)
    calm = fit(STRUCTURE, flown(1, push=0.0), estimate=WANTED, values=HELD, disturbance="input")
    assert calm.disturbance.gusts["q"].std < 0.1 * PUSH


@pytest.mark.long
def test_what_was_found_is_told(found: list[Estimate]) -> None:
    one = next(one for one in found if one.disturbance.kind == "input")
    assert one.converged
    assert "disturbance: pushes at M, seen in q: standard deviation" in one.table()
    assert not any("wanders" in remark for remark in one.remarks)
    stored = one.disturbance.to_json()
    assert stored["kind"] == "input"
    assert stored["gusts"]["q"]["std"] == one.disturbance.gusts["q"].std  # type: ignore[index]


@pytest.mark.long
def test_prediction_with_the_found_noise_is_right(found: list[Estimate]) -> None:
    one = next(one for one in found if one.disturbance.kind == "input")
    values = {**HELD, **dict(zip(one.labels, one.values, strict=True))}
    plan = predict(STRUCTURE, {"M": U}, DT, one.noise, values=values, estimate=WANTED, disturbance=one.disturbance)
    # The same sensitivities and the same noise.
    assert plan.sigma[plan.labels.index("mu")] == pytest.approx(one.cramer_rao("mu"), rel=1e-3)
    white = predict(STRUCTURE, {"M": U}, DT, one.noise, values=values, estimate=WANTED)
    assert white.sigma[0] < 0.7 * plan.sigma[0]
    with pytest.raises(IdentificationError, match=r"samples .* s apart"):
        predict(STRUCTURE, {"M": U}, 0.002, one.noise, estimate=WANTED, disturbance=one.disturbance)
    several = DisturbanceModel("ar", {"q[a]": one.disturbance.noise["q"], "q[b]": one.disturbance.noise["q"]}, dt=DT)
    with pytest.raises(IdentificationError, match="2 records each"):
        predict(STRUCTURE, {"M": U}, DT, one.noise, estimate=WANTED, disturbance=several)


def test_a_nonlinear_structure_has_no_gust() -> None:
    options = {"estimate": ("mu", "tau", "q_0"), "values": {"w_n": 3.437, "xi": 0.0836, "coulomb": 0.3, "mu": 250.0}}
    with pytest.raises(IdentificationError, match="needs a linear structure"):
        fit(free_response(), flown(1), disturbance="input", **options)  # type: ignore[arg-type]
    assert fit(free_response(), flown(1), **options).disturbance.kind == "white"  # type: ignore[arg-type]


@pytest.mark.long
def test_a_structure_without_lag_keeps_output_error() -> None:
    # It would take what the lag does behind an edge, where the gust has not pushed yet, for less gain and delay.
    wanted, held = ("mu", "tau", "theta_0", "q_0"), {"w_n": 3.437, "xi": 0.0836}
    auto = fit(pitch_rate(), flown(1), estimate=wanted, values=held)
    assert auto.disturbance.kind == "white"
    assert any("fit a linear structure with the actuators' lag" in remark for remark in auto.remarks)
    asked = fit(pitch_rate(), flown(1), estimate=wanted, values=held, disturbance="input")
    assert asked["mu"] < TRUE_MU - 2.0 * asked.sigma("mu")
