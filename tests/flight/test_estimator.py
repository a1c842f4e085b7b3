"""The estimator against textbook matrix filters, closed forms, its own covariance, and the drone's estimates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.blocks.reference.interpreter import Reference
from twodof.compile import build
from twodof.errors import ParameterError
from twodof.flight.estimator import COVARIANCE, estimator
from twodof.flight.estimator import PAIRS as PAIRS_JOINT
from twodof.flightlog.files import read_log
from twodof.signals import GRAVITY

pytestmark = pytest.mark.slow

TS = 0.004
LOGS = (
    "free-response-impulse",
    "doublet-0.03",
    "attitude-steps-10deg-default",
    "attitude-steps-10deg-student",
    "rate-doublets-30dps-student",
    "velocity-doublets-0.25",
    "position-sweep-default",
)
PITCH = tuple(f"pitch.{name}" for name in ("bias", "variance", "covariance", "bias_variance"))
PAIRS = ("xx", "xv", "xb", "vv", "vb", "bb")
POSITION = ("position.bias", *(f"position.P_{pair}" for pair in PAIRS), "position.innovation")


def specific_force(theta: Any, acceleration: Any = 0.0) -> tuple[Any, Any]:
    """(f_x, f_z) of a body pitched by theta whose cart accelerates along the rail."""
    return (
        np.cos(theta) * acceleration + GRAVITY * np.sin(theta),
        np.sin(theta) * acceleration - GRAVITY * np.cos(theta),
    )


def rms(e: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(e**2)))


def fly(name: str, folder: Path, position_filter: str) -> tuple[float, float, float]:
    """RMS distance of theta [rad], x [m] and v [m/s] from the drone's own estimates, over the whole log."""
    log = read_log(folder / f"{name}.mat")
    t, tof = log["acc"].time, log["dist"]
    at = np.searchsorted(t, tof.time)
    at, known = at[at < len(t)], at < len(t)
    dist, age, new = np.zeros(len(t)), np.zeros(len(t)), np.zeros(len(t), dtype=bool)
    dist[at], age[at], new[at] = tof.value[known], t[at] - tof.time[known], True
    out = (
        build(estimator(position_filter), dt=TS)
        .machine()
        .run(
            len(t),
            {
                "acc_x": log["acc"].value[:, 0],
                "acc_z": log["acc"].value[:, 2],
                "gyro_y": log["gyr"].value[:, 1],
                "dist": dist,
                "dist_age": age,
                "dist_new": new,
            },
        )
    )

    def distance(name: str) -> float:
        index = np.searchsorted(t, log[name].time, side="right") - 1
        return rms((out[name][index] - log[name].value)[index >= 0])

    return distance("theta"), distance("x"), distance("v")


@pytest.mark.parametrize("position_filter", ["joint", "fixed-gain"])
@pytest.mark.parametrize("name", LOGS)
def test_on_real_flights_the_estimates_are_the_drones(flight_data: Path, name: str, position_filter: str) -> None:
    theta, x, v = fly(name, flight_data, position_filter)
    assert np.degrees(theta) < 1.0
    assert x < 0.005
    assert v < 0.03


def test_the_pitch_filter_is_the_textbooks_extended_kalman_filter() -> None:
    rng = np.random.default_rng(1)
    n = 400
    theta = 0.2 * np.sin(0.02 * np.arange(n))
    f_x, f_z = specific_force(theta, 5.0 * rng.standard_normal(n))
    gyro = np.gradient(theta, TS) + 0.02 + 0.06 * rng.standard_normal(n)
    out = (
        Reference(estimator("fixed-gain"), TS, log=PITCH).machine().run(n, {"acc_x": f_x, "acc_z": f_z, "gyro_y": gyro})
    )

    state = np.array([np.arctan2(f_x[0], -f_z[0]), 0.0])
    covariance = np.diag([0.05**2, 0.01**2])
    step = np.array([[1.0, -TS], [0.0, 1.0]])
    process = np.diag([0.004**2, 0.0007**2]) * TS
    for k in range(1, n):
        state = step @ state + np.array([TS * gyro[k], 0.0])
        covariance = step @ covariance @ step.T + process
        measured = np.cos(state[0]) * f_x[k] + np.sin(state[0]) * f_z[k]
        slope = np.array([[-GRAVITY, 0.0]])
        gain = covariance @ slope.T / (slope @ covariance @ slope.T + 5.0**2)
        state = state - (gain * measured)[:, 0]
        covariance = (np.eye(2) - gain @ slope) @ covariance
        assert out["theta"][k] == pytest.approx(state[0], abs=1e-12)
        assert out["pitch.bias"][k] == pytest.approx(state[1], abs=1e-12)
        got = [out[f"pitch.{name}"][k] for name in ("variance", "covariance", "bias_variance")]
        assert got == pytest.approx([covariance[0, 0], covariance[0, 1], covariance[1, 1]], rel=1e-9, abs=1e-18)


def test_the_kalman_position_is_the_textbooks_filter_with_late_samples() -> None:
    rng = np.random.default_rng(2)
    n = 500
    f_x, f_z = specific_force(0.0, rng.standard_normal(n))
    new = np.arange(n) % 13 == 5
    dist = 0.5 + 0.1 * rng.standard_normal(n)
    age = rng.uniform(0.0, 0.02, n)
    inputs = {"acc_x": f_x, "acc_z": f_z, "dist": dist, "dist_new": new, "dist_age": age}
    m = Reference(estimator("kalman"), TS, log=(*POSITION, "rail.acceleration")).machine()
    out = m.run(n, inputs)
    sigma_a, walk, tof = (m.get(f"position.{p}") for p in ("sigma_a", "sigma_walk", "sigma_tof"))

    state = np.array([dist[5] - 0.5, 0.0, 0.0])
    covariance = np.diag([tof**2, m.get("position.sigma_v_0") ** 2, m.get("position.sigma_bias_0") ** 2])
    step = np.array([[1.0, TS, -(TS**2) / 2], [0.0, 1.0, -TS], [0.0, 0.0, 1.0]])
    process = np.array(
        [
            [sigma_a**2 * TS**3 / 3, sigma_a**2 * TS**2 / 2, 0.0],
            [sigma_a**2 * TS**2 / 2, sigma_a**2 * TS, 0.0],
            [0.0, 0.0, walk**2 * TS],
        ]
    )
    for k in range(6, n):
        a = out["rail.acceleration"][k]
        state = step @ state + np.array([a * TS**2 / 2, a * TS, 0.0])
        covariance = step @ covariance @ step.T + process
        if new[k]:
            s = age[k]
            slope = np.array([[1.0, -s, -(s**2) / 2]])
            gain = covariance @ slope.T / (slope @ covariance @ slope.T + tof**2)
            state = state + gain[:, 0] * (dist[k] - 0.5 - (slope @ state)[0] - a * s**2 / 2)
            covariance = (np.eye(3) - gain @ slope) @ covariance
        got = [out["x"][k], out["v"][k], out["position.bias"][k]]
        assert got == pytest.approx(state.tolist(), rel=1e-9, abs=1e-12)
        upper = [covariance[i, j] for i, j in zip(*np.triu_indices(3), strict=True)]
        assert [out[f"position.P_{pair}"][k] for pair in PAIRS] == pytest.approx(upper, rel=1e-8, abs=1e-18)


JOINT_STATES = ("theta", "bias", "x", "v")
JOINT = tuple(f"filter.{name}" for name in ("bias", *COVARIANCE))


def joint_covariance(out: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4, n) from the filter's upper triangle."""
    p = np.empty((4, 4, len(out["theta"])))
    for (a, b), name in zip(PAIRS_JOINT, COVARIANCE, strict=True):
        i, j = JOINT_STATES.index(a), JOINT_STATES.index(b)
        p[i, j] = p[j, i] = out[f"filter.{name}"]
    return p


def test_the_joint_filter_is_the_textbooks_extended_kalman_filter() -> None:
    rng = np.random.default_rng(3)
    n = 300
    theta = 0.2 * np.sin(0.02 * np.arange(n))
    f_x, f_z = specific_force(theta, rng.standard_normal(n))
    gyro = np.gradient(theta, TS) + 0.02 + 0.06 * rng.standard_normal(n)
    new, dist, age = np.arange(n) % 13 == 5, 0.5 + 0.1 * rng.standard_normal(n), rng.uniform(0.0, 0.02, n)
    inputs = {"acc_x": f_x, "acc_z": f_z, "gyro_y": gyro, "dist": dist, "dist_new": new, "dist_age": age}
    m = Reference(estimator("joint"), TS, log=JOINT).machine()
    out = m.run(n, inputs)
    got = joint_covariance(out)

    def sigma(name: str) -> float:
        return float(m.get(f"filter.sigma_{name}"))

    state = np.zeros(4)
    covariance = np.diag([sigma(f"{name}_0") ** 2 for name in JOINT_STATES])
    process = np.zeros((4, 4))
    process[0, 0], process[1, 1] = sigma("gyro") ** 2 * TS, sigma("walk") ** 2 * TS
    process[2:, 2:] = sigma("a") ** 2 * np.array([[TS**3 / 3, TS**2 / 2], [TS**2 / 2, TS]])
    for k in range(n):
        if k == 0:
            state[0] = np.arctan2(f_x[0], -f_z[0])
        else:
            state[0] += (gyro[k] - state[1]) * TS
        a = np.cos(state[0]) * f_x[k] + np.sin(state[0]) * f_z[k]
        slope = np.cos(state[0]) * f_z[k] - np.sin(state[0]) * f_x[k]
        measurements = []
        if k > 0:
            state[2] += state[3] * TS + a * TS**2 / 2
            state[3] += a * TS
            step = np.array(
                [[1, -TS, 0, 0], [0, 1, 0, 0], [slope * TS**2 / 2, 0, 1, TS], [slope * TS, 0, 0, 1]], dtype=float
            )
            covariance = step @ covariance @ step.T + process
            measurements.append((np.array([slope, 0, 0, 0]), -a, sigma("gravity") ** 2))
        if new[k]:
            s = age[k]
            row = np.array([slope * s**2 / 2, 0.0, 1.0, -s])
            measurements.append((row, None, sigma("range") ** 2))
        for row, innovation, r in measurements:
            if innovation is None:
                innovation = dist[k] - 0.5 - (state[2] - state[3] * age[k] + a * age[k] ** 2 / 2)
            gain = covariance @ row / (row @ covariance @ row + r)
            state = state + gain * innovation
            covariance = covariance - np.outer(gain, row @ covariance)
        assert [out["theta"][k], out["filter.bias"][k], out["x"][k], out["v"][k]] == pytest.approx(
            state.tolist(), rel=1e-9, abs=1e-11
        )
        np.testing.assert_allclose(got[:, :, k], covariance, rtol=1e-7, atol=1e-15)


def test_the_joint_filter_does_not_take_the_carts_acceleration_for_tilt() -> None:
    n = 5000
    t = TS * np.arange(n)
    w = 2.0 * np.pi * 0.4
    a, v, x = 1.5 * np.cos(w * t), 1.5 / w * np.sin(w * t), 1.5 / w**2 * (1.0 - np.cos(w * t))
    a[0] = 0.0  # the first pitch is taken at rest
    f_x, f_z = specific_force(0.0, a)
    inputs = {"acc_x": f_x, "acc_z": f_z, "dist": 0.5 + x, "dist_new": np.arange(n) % 14 == 0}
    joint, separate = (build(estimator(name), dt=TS).machine().run(n, inputs) for name in ("joint", "fixed-gain"))
    late = slice(2500, None)
    assert rms(joint["theta"][late]) < 0.3 * rms(separate["theta"][late])
    assert rms(joint["v"][late] - v[late]) < 0.01


def test_a_late_sample_of_a_constant_acceleration_brings_no_innovation() -> None:
    n, a, s = 250, 0.7, 0.018
    t = TS * np.arange(n)
    f_x, f_z = specific_force(0.0, np.full(n, a))
    position = 0.5 * a * t**2
    when = t - np.where(np.arange(n) > 0, s, 0.0)
    m = Reference(estimator("kalman"), TS, log=POSITION).machine()
    m.set("pitch.sigma_acc", 1e6)  # keep the pitch, which cannot tell acceleration from tilt, out of it
    first = {"acc_x": 0.0, "acc_z": -GRAVITY, "dist": 0.5, "dist_new": True}
    m.step(first)
    out = m.run(
        n - 1,
        {"acc_x": f_x[1:], "acc_z": f_z[1:], "dist": 0.5 + 0.5 * a * when[1:] ** 2, "dist_age": s}
        | {"dist_new": (np.arange(1, n) % 14 == 0)},
    )
    assert np.abs(out["position.innovation"]).max() < 1e-9
    np.testing.assert_allclose(out["x"], position[1:], rtol=0.0, atol=1e-9)


def test_an_error_of_the_acceleration_gives_the_fixed_gain_filter_its_lasting_velocity() -> None:
    b, every = 0.1, 14
    n = 7000
    f_x, f_z = specific_force(0.0, np.full(n, b))
    m = build(estimator("fixed-gain"), dt=TS, log=("position.x_filter",)).machine()
    m.set("pitch.sigma_acc", 1e6)  # keep the pitch, which cannot tell acceleration from tilt, out of it
    m.step({"acc_x": 0.0, "acc_z": -GRAVITY, "dist": 0.5, "dist_new": True})
    out = m.run(n, {"acc_x": f_x, "acc_z": f_z, "dist": 0.5, "dist_new": np.arange(1, n + 1) % every == 0})
    k_x, k_v, period = m.get("position.k_x"), m.get("position.k_v"), every * TS
    at = every * (n // every) - 1
    # Over a period b T = k_v x and k_x x = v T + b T^2 / 2, x before and v after the correction.
    assert out["v"][at] == pytest.approx(b * k_x / k_v - b * period / 2, rel=1e-6)
    assert out["position.x_filter"][at] == pytest.approx((1.0 - k_x) * b * period / k_v, rel=1e-6)


@pytest.mark.parametrize("position_filter", ["joint", "fixed-gain", "kalman"])
def test_the_first_samples_set_pitch_and_position(position_filter: str) -> None:
    f_x, f_z = specific_force(0.3)
    inputs = {"acc_x": f_x, "acc_z": f_z, "dist": 0.7, "dist_new": [False, True, False]}
    out = Reference(estimator(position_filter), TS).machine().run(3, inputs)
    assert out["theta"].tolist() == pytest.approx([0.3] * 3, abs=1e-6)
    # The joint filter starts with x known to 1 m, so the first range, weighed as 16 mm, gives x to 3e-4 of itself.
    assert out["x"].tolist() == pytest.approx([0.0, 0.2, 0.2], abs=1e-4)
    assert out["v"].tolist() == pytest.approx([0.0] * 3, abs=1e-4)


def test_what_is_published_changes_at_100_hz_and_is_read_a_sample_later() -> None:
    m = Reference(estimator("fixed-gain"), TS).machine()
    m.set("pitch.sigma_acc", 1e6)
    m.step({"acc_x": 0.0, "acc_z": -GRAVITY, "dist": 0.5, "dist_new": True})
    out = m.run(500, {"acc_x": 0.5, "acc_z": -GRAVITY, "dist_new": False})
    changes = np.flatnonzero(np.diff(out["x_published"])) + 1
    assert set(np.diff(changes)) == {2, 3}
    assert len(changes) == pytest.approx(200, abs=2)
    np.testing.assert_array_equal(out["x_published"][changes], out["x"][changes - 1])


def test_an_unknown_filter_is_refused() -> None:
    with pytest.raises(ParameterError, match="joint, fixed-gain, kalman"):
        estimator("luenberger")
