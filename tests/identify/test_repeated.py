"""Repeated flights: where only the sensor is noisy they spread as each claims; where something pushes, further."""

import json

import numpy as np
import pytest

from twodof.errors import IdentificationError
from twodof.identify import Record, Repeated, fit, repeat
from twodof.models.plant import PitchRate
from twodof.models.structures import pitch_rate

TRUTH = PitchRate(w_n=3.437, xi=0.0836, mu=358.5, tau=0.02)
DT, STEPS, FLIGHTS = 0.004, 400, 8
HELD = {"w_n": TRUTH.w_n, "xi": TRUTH.xi}


def doublet(seed: int, gust: float) -> Record:
    """A doublet with white noise of .05 rad/s at the gyro; a moment of correlation time .4 s pushes by `gust`."""
    generator = np.random.default_rng(seed)
    moment = np.zeros(STEPS)
    moment[50:125], moment[125:200] = 0.03, -0.03
    push, pushed = 0.0, np.zeros(STEPS)
    for k in range(STEPS):
        push += -push * DT / 0.4 + gust * np.sqrt(2.0 * DT / 0.4) * generator.normal()
        pushed[k] = push
    q = TRUTH.state_space().zero_order_hold(DT).simulate(moment + pushed)[:, 1] + generator.normal(0.0, 0.05, STEPS)
    time = DT * np.arange(STEPS)
    return Record.from_columns(time, {"M": moment, "q": q}, ["M"], ["q"], name=f"flight {seed}")


def flown(gust: float) -> Repeated:
    records = [doublet(seed, gust) for seed in range(1, FLIGHTS + 1)]
    return repeat(pitch_rate(), records, estimate=("mu", "tau", "theta_0", "q_0"), values=HELD)


def test_sensor_noise_spreads_flights_as_claimed() -> None:
    found = flown(0.0)
    assert found.labels == ("mu", "tau")
    # What all of them suppose does not show in their spread.
    assert "held: w_n 3.437, xi 0.0836" in found.table()
    assert not found.spread("mu").exceeds(found.claimed("mu"))
    assert not any(one.wanders for one in found.estimates)
    assert not any("spread" in remark for remark in found.remarks)
    # Seven degrees of freedom: chi-square leaves the ratio within these once in a thousand on either side.
    assert 0.29 < found.spread("mu").value / found.claimed("mu") < 1.87
    assert abs(found.mean("mu") - TRUTH.mu) < 3.3 * found.claimed("mu") / np.sqrt(FLIGHTS)


@pytest.mark.parametrize("gust", [0.002, 0.005])
def test_gusts_spread_flights_more_than_claimed(gust: float) -> None:
    found = flown(gust)
    assert found.spread("mu").exceeds(found.claimed("mu"))
    assert any(remark.startswith("mu: the flights spread") for remark in found.remarks)
    assert all(one.wanders for one in found.estimates)
    assert all(any("wanders" in remark for remark in one.remarks) for one in found.estimates)
    assert "> " in found.estimates[0].table()
    each = [one["mu"] for one in found.estimates]
    assert json.loads(found.to_json())["repeated"]["mu"]["spread"] == pytest.approx(np.std(each, ddof=1))
    assert f"+- {np.std(each, ddof=1):.2g}" in found.table()


def test_a_damping_below_zero_is_said() -> None:
    found = fit(pitch_rate(), doublet(1, 0.0), estimate=("mu", "xi"), values={"w_n": TRUTH.w_n, "tau": TRUTH.tau})
    assert not any("xi is negative" in remark for remark in found.remarks)
    unstable = PitchRate(w_n=3.437, xi=-0.1, mu=358.5, tau=0.02).state_space().zero_order_hold(DT)
    moment = np.zeros(STEPS)
    moment[50:125], moment[125:200] = 0.03, -0.03
    time = DT * np.arange(STEPS)
    q = unstable.simulate(moment)[:, 1] + np.random.default_rng(3).normal(0.0, 0.01, STEPS)
    record = Record.from_columns(time, {"M": moment, "q": q}, ["M"], ["q"])
    grown = fit(pitch_rate(), record, estimate=("mu", "xi"), values={"w_n": TRUTH.w_n, "tau": TRUTH.tau})
    assert grown["xi"] == pytest.approx(-0.1, abs=0.01)
    assert any("xi is negative" in remark for remark in grown.remarks)


@pytest.mark.parametrize("seeds", [[], [1], [1, 1]])
def test_repetitions_need_two_different_flights(seeds: list[int]) -> None:
    """Refused before any fit, which would refuse the unknown."""
    with pytest.raises(IdentificationError, match="two or more"):
        repeat(pitch_rate(), [doublet(seed, 0.0) for seed in seeds], estimate=["nothing"])
