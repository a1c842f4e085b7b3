"""Promises of identified models: fly, identify as the command does, promise, fly again, and count what is kept."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from twodof.design.pitch_family import PARAMETERS, FittedNoise, PitchFamily
from twodof.design.promise import promise
from twodof.design.robustness import robustness
from twodof.design.sampled_controller import SampledController
from twodof.experiment.flight import Laboratory
from twodof.flight.gains import DEFAULT
from twodof.flight.starters.attitude import pid_attitude
from twodof.identify.disturbance.autoregression import from_covariance
from twodof.identify.identified_flight import identify_flight
from twodof.signals import PERIOD
from twodof.sim.promised.rail_promise import RailFamily, rail_promise

pytestmark = pytest.mark.slow

VALUES = {"w_n": 2.3, "xi": 0.07, "mu": 290.0, "tau": 0.02}
STOCK = SampledController.of(pid_attitude(DEFAULT))


@functools.cache
def laboratory(rig: str) -> Laboratory:
    return Laboratory(rig)


def model(rig: str, experiment: str, seed: int) -> dict[str, object]:
    lab = laboratory(rig)
    swing = lab.fly("impulse", seed=1000 + seed).log if experiment == "doublet" else None
    return identify_flight(lab.fly(experiment, seed=seed).log, impulse=swing).model()


def check_kept(kept: list[dict[str, bool]]) -> None:
    """Fail for a line that is kept less often than promised: chance does that once in a thousand."""
    from scipy.stats import binomtest

    counts = {name: sum(one[name] for one in kept) for name in kept[0]}
    assert all(binomtest(n, len(kept), 0.95, "less").pvalue > 1e-3 for n in counts.values()), (counts, len(kept))


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig", "experiment", "flights"),
    [
        ("lab", "attitude-steps", 4),
        *(
            pytest.param(rig, experiment, 100, marks=pytest.mark.soak)
            for rig in ("lab", "paper")
            for experiment in ("attitude-steps", "attitude-prbs", "rate-doublets", "doublet")
        ),
    ],
)
def test_promises_of_the_pitch_are_kept(rig: str, experiment: str, flights: int) -> None:
    kept = []
    for seed in range(1, flights + 1):
        made = promise(STOCK, PitchFamily.from_identified(model(rig, experiment, seed)), members=400, seed=seed)
        step = made.verdict_of(laboratory(rig).fly("attitude-steps", seed=5000 + seed).log).steps[0]
        kept.append({name: step.kept(name) for name in (*step.outside, *step.figures)})
    check_kept(kept)


@pytest.mark.soak
@pytest.mark.parametrize("rig", ["lab", "paper"])
def test_promises_of_the_rail_are_kept(rig: str) -> None:
    kept = []
    for seed in range(1, 31):
        family = RailFamily.from_identified(model(rig, "attitude-prbs", seed), model(rig, "velocity-doublet", seed))
        assert family.base == rig
        made = rail_promise(family, members=80, seed=seed)
        step = made.verdict_of(laboratory(rig).fly("velocity-doublets", seed=5000 + seed).log).steps[0]
        kept.append({name: step.kept(name) for name in (*step.outside, *step.figures)})
    check_kept(kept)


def test_noise_is_parted_into_gust_and_vibration() -> None:
    w_n, xi = 2.4, 0.04
    turn = np.pi * np.arange(1 << 14) / (1 << 14)
    omega, delay = turn / PERIOD, np.exp(-1j * turn)
    gust = 1.8**2 * 0.2 / (1.0 + (0.1 * omega) ** 2) / PERIOD
    gust *= omega**2 / ((w_n**2 - omega**2) ** 2 + (2.0 * xi * w_n * omega) ** 2)
    poles = 1.0 - 1.6 * np.cos(2.0 * np.pi * 38.0 * PERIOD) * delay + 0.6 * delay**2
    vibration = 0.01**2 * 0.2 * np.abs(1.0 - delay**2) ** 2 / np.abs(poles) ** 2
    noise = from_covariance(np.fft.irfft(gust + vibration)[:60])
    row = {"coefficients": noise.coefficients.tolist(), "sigma": noise.sigma}
    found = FittedNoise.of_rows([row], w_n, xi)
    # A model of .24 s tells a gust of .1 s to a tenth.
    assert (found.gust, found.gust_time) == (pytest.approx(1.8, rel=0.1), pytest.approx(0.1, rel=0.2))
    assert found.q_noise == pytest.approx(0.01, rel=0.02)
    assert found.q_band == (pytest.approx(38.0, rel=0.02), pytest.approx(0.6, rel=0.05))


@pytest.mark.parametrize(("length", "widest"), [(1.2, 3.3), (20.0, 1.7)])
def test_gusts_are_drawn_around_the_true_ones(length: float, widest: float) -> None:
    """Records of a gust of .1 s, each estimated by its samples alone: the short ones take it for too short.

    The interval of the strength is at most `widest` times as wide as it would be around the estimates' own spread: 2.6
    and 1.3 times with these seeds, and a third more. Sensor noise, which these records do not have, hides some of the
    gust, so the draws allow for more than they need.
    """
    from scipy.signal import lfilter
    from scipy.stats import binomtest

    true, keep, steps, rng = (1.8, 0.1), np.exp(-PERIOD / 0.1), round(length / PERIOD), np.random.default_rng(1)
    held, found, widths = [0, 0], [], []
    for number in range(200):
        new = rng.standard_normal(steps) * np.sqrt(1.0 - keep**2)
        record, _ = lfilter([1.0], [1.0, -keep], 1.8 * new, zi=[keep * 1.8 * rng.standard_normal()])
        record -= record.mean()
        kept = float(record[1:] @ record[:-1] / (record[:-1] @ record[:-1]))
        gust = float(np.sqrt(np.mean((record[1:] - kept * record[:-1]) ** 2) / (1.0 - kept**2)))
        time = float(-PERIOD / np.log(kept))
        family = PitchFamily.of(VALUES, gust=gust, gust_time=time)
        drawn = replace(family, gust_freedom=length / time).gusts(400, seed=number)
        low, high = np.quantile(drawn, [0.025, 0.975], axis=1)
        held = [n + bool(low[k] <= true[k] <= high[k]) for k, n in enumerate(held)]
        found.append((gust, time))
        widths.append(high[0] - low[0])
    assert (np.median(found, axis=0)[1] < 0.08) is np.bool_(length < 2.0)
    assert all(binomtest(n, 200, 0.95, "less").pvalue > 1e-3 for n in held), held
    assert np.median(widths) < widest * 2.0 * 1.96 * np.std(found, axis=0)[0], (
        np.median(widths),
        np.std(found, axis=0),
    )


def test_a_gust_that_is_given_is_known() -> None:
    told = replace(PitchFamily.of(VALUES, gust=1.5, gust_time=0.07), gust_freedom=17.0)
    for gust, time in ((2.0, None), (None, 0.2), (2.0, 0.2)):
        strengths, times = told.disturbed(gust=gust, gust_time=time).gusts(10)
        assert set(strengths) == {gust or 1.5}
        assert set(times) == {time or 0.07}
    assert len(set(told.disturbed(q_noise=0.02).gusts(10)[1])) == 10


@pytest.mark.long
def test_negative_damping_is_taken_for_none() -> None:
    """One doublet in gusts: the poles are hardly known, and the estimate is a swing that grows."""
    rows = {"w_n": (0.9, 2.2), "xi": (-0.1, 0.5), "mu": (310.0, 25.0), "tau": (0.022, 0.001)}
    document = {
        "estimates": {name: {"value": value, "sigma": sigma} for name, (value, sigma) in rows.items()},
        "correlation": np.eye(4).tolist(),
    }
    family = PitchFamily.from_identified(document)
    assert family.values["xi"] == 0.0
    assert "xi -0.1" in family.notes[0]
    found = robustness(STOCK, family, members=200)
    assert found.robust
    assert all(low <= found.worst[name] <= high for name, (low, high) in PARAMETERS.items())


def test_rail_accepts_a_pendulum_softer_than_gravity() -> None:
    pitch = {"model": {"w_n": 1.8, "xi": 0.0, "mu": 296.0, "tau": 0.0217}, "rig": "lab"}
    cart = {"estimates": {name: {"value": 1.0, "sigma": 0.1} for name in ("k_v", "p_v")}, "correlation": np.eye(2)}
    family = RailFamily.from_identified(pitch, cart)
    rig = family.rigs(1)[0]
    assert family.base == "lab"
    assert rig["spring"] == 0.0
    stiffness = 9.80665 * rig["mass_drone"] * rig["offset"] - rig["softening"]
    assert stiffness == pytest.approx(1.8**2 * rig["inertia"], rel=1e-3)
