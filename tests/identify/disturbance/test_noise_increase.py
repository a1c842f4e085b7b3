"""Noise that is louder where an input has just moved: it is found, and a fit under it claims what it is worth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from tests.identify.signals import DT
from twodof.experiment import Laboratory
from twodof.identify import Estimate, Record, cut, fit
from twodof.identify.disturbance.coloured_problem import moves
from twodof.identify.problem import Problem
from twodof.models.plant import PitchRate
from twodof.models.structures import free_response, pitch_rate

pytestmark = pytest.mark.slow

TRUTH = PitchRate(w_n=3.437, xi=0.0836, mu=300.0, tau=0.02)
SAMPLES = 1600
AFTER = 16
"""Samples behind an edge in which the noise is as strong as `TIMES` says."""
TIMES = 4.0
COLOUR = (1.0, -0.97)
"""Noise that wanders: what tells the gain are the samples in which q changes."""


def pulses(seed: int) -> np.ndarray:
    """A moment that jumps for 40 ms every .4 s, by a size of its own."""
    moment = np.zeros(SAMPLES)
    for k, size in enumerate(np.random.default_rng(1000 + seed).uniform(-0.04, 0.04, SAMPLES // 100)):
        moment[100 * k + 20 : 100 * k + 30] = size
    return moment


def flown(seed: int, times: float = TIMES) -> Record:
    """An open loop whose gyro is `times` as noisy in the samples behind an edge."""
    moment, rng = pulses(seed), np.random.default_rng(seed)
    edges = np.flatnonzero(np.diff(moment)) + 1
    strength = np.ones(SAMPLES)
    for edge in edges[::2]:
        strength[edge + 1 : edge + 11 + AFTER] = times
    plant = replace(TRUTH, tau=0.0).state_space().zero_order_hold(DT)
    noise = lfilter([1.0], COLOUR, 0.02 * strength * rng.normal(size=SAMPLES))
    x, q = np.zeros(2), np.zeros(SAMPLES)
    for k in range(SAMPLES):
        q[k] = (plant.c @ x)[1] + noise[k]
        x = plant.phi @ x + plant.new[:, 0] * moment[max(0, k - 5)]
    return Record.from_columns(DT * np.arange(SAMPLES), {"M": moment, "q": q}, ["M"], ["q"], f"flight {seed}")


def estimated(record: Record) -> Estimate:
    held = {"w_n": TRUTH.w_n, "xi": TRUTH.xi}
    return fit(pitch_rate(), record, estimate=("mu", "tau", "theta_0", "q_0"), values=held, disturbance="ar")


@pytest.mark.long
def test_intervals_under_louder_noise_hold() -> None:
    found = [estimated(flown(seed)) for seed in range(1, 25)]
    for one in found:
        (loud,) = one.disturbance.louder.values()
        assert loud.input == "M"
        assert loud.window == AFTER
        assert loud.times == pytest.approx(TIMES, rel=0.25)  # the strengths that are tried are 1.4 apart
        assert "times as strong in the 64 ms after M has moved" in one.table()
    z = np.array([(one["mu"] - TRUTH.mu) / one.sigma("mu") for one in found])
    # Once in a thousand by chance. Taken for even, the same noise makes chi-square 95.
    assert chi2.isf(0.9995, z.size) < float(z @ z) < chi2.isf(0.0005, z.size)


@pytest.mark.long
def test_even_noise_is_left_even() -> None:
    # Less than one in 10,000 is louder by chance.
    assert not any(estimated(flown(seed, times=1.0)).disturbance.louder for seed in range(1, 16))


def test_a_weight_does_not_depend_on_its_sample() -> None:
    # In closed loop an input answers the noise of the same sample: its weight must not know it.
    def moved(record: Record) -> list[np.ndarray]:
        problem = Problem(pitch_rate(), [record], ("mu", "q_0"), {}, {})
        return [size for _, _, size in moves(problem, [0])]

    record = flown(1)
    changed = record.inputs["M"].copy()
    changed[700] += 1.0
    other = replace(record, inputs={"M": changed})
    for one, two in zip(moved(record), moved(other), strict=True):
        assert (one[:701] == two[:701]).all()
        assert two[701] == pytest.approx(one[701] + 1.0, abs=0.1)


def test_a_search_that_steps_too_far_comes_back() -> None:
    # Of 30 free responses of the rig `lab` three led the last steps to where the spring's cube overflows.
    record = cut(Laboratory("lab").fly("impulse", 5).log, "impulse")
    found = fit(free_response(), record)
    assert np.isfinite(found.values).all()
    # The rig's w_n at rest is 2.812 rad/s; 30 flights scatter by .002 about 2.810.
    assert found["w_n"] == pytest.approx(2.812, abs=0.01)
