"""On the rig the joint filter's error is as large as its covariance says, when it is told the rig's noise."""

import math

import numpy as np
import pytest
from scipy import stats

from twodof.flight.estimator import COVARIANCE, PAIRS, STATES
from twodof.rig.parameters import lab
from twodof.signals import PERIOD
from twodof.sim.closed_loop import ClosedLoop, InitialState

FILTER = "flight.estimator.filter"
RUNS, STEPS, EVERY = 60, 5000, 50

# White noise of the rig's sensors in one sample of 4 ms, quantisation (step / sqrt(12)) included.
GYRO = math.hypot(0.0014, 0.00107 / math.sqrt(12.0))
RANGE = math.hypot(0.004, 0.001 / math.sqrt(12.0))
SIGMA = {
    "gyro": 1.05 * GYRO * math.sqrt(PERIOD),
    "walk": 1e-6,
    # The vibration, 1 m/s2 about 38 Hz, moves no position but shakes the velocity by 4 mm/s: a quarter more than white.
    "a": 1.25 * 0.17 * math.sqrt(PERIOD),
    "range": RANGE,
    "gravity": 1e6,
    "theta_0": 0.002,
    "bias_0": 0.003,
    "x_0": 0.01,
    "v_0": 0.01,
}


@pytest.mark.long
def test_the_error_on_the_rig_is_as_large_as_the_covariance_says() -> None:
    log = tuple(f"{FILTER}.{name}" for name in ("bias", "x", "v", *COVARIANCE))
    # What no covariance can know is left out: scales, the IMU's place, a stamp that hides the sample's age.
    honest = {"tof_stamp": lab().snapshot()["tof_age"], "acc_scale": 1.0, "gyro_scale": 1.0, "imu_below": 0.0}
    noise = {"gyro_idle": 0.0014, "acc_x_idle": 0.17, "acc_x_hover": 1.0, "vibration_hz": 38.0, "tof_noise": 0.004}
    noise |= {"vibration_r2": 0.6, "acc_x_line": 0.0, "gyro_line": 0.0, "gyro_hover": 0.01}
    loop = ClosedLoop(
        conditions=honest | noise | {"noise": 1.0, "rings": False},
        tuning={f"estimator.filter.sigma_{name}": value for name, value in SIGMA.items()},
        log=log,
    )
    x0 = 0.1 * np.sin(2.0 * np.pi * 0.1 * PERIOD * np.arange(STEPS))
    start = {
        f"{FILTER}.{name}": SIGMA[f"{a}_0"] ** 2 if a == b else 0.0
        for name, (a, b) in zip(COVARIANCE, PAIRS, strict=True)
    }
    found = []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        first = {name: SIGMA[f"{name}_0"] * rng.standard_normal() for name in STATES}
        loop.configure({"seed": seed + 1, "gyro_bias": first["bias"], "tof_phase": float(rng.uniform(0.0, 0.99))})
        estimates = {name: first[name] for name in ("theta", "x", "v")}
        loop.start(InitialState(hover=True, estimates=estimates, states=start))
        out = loop.fly(STEPS, {"mode": "position", "x0": x0, "thrust": 0.4})
        at = slice(EVERY, None, EVERY)
        e = np.array(
            [
                out["theta"] - out["true_theta"],
                out[f"{FILTER}.bias"] - first["bias"],
                out[f"{FILTER}.x"] - out["true_x"],
                out[f"{FILTER}.v"] - out["true_v"],
            ]
        )[:, at]
        p = np.empty((e.shape[1], 4, 4))
        for name, (a, b) in zip(COVARIANCE, PAIRS, strict=True):
            i, j = STATES.index(a), STATES.index(b)
            p[:, i, j] = p[:, j, i] = out[f"{FILTER}.{name}"][at]
        found.append(np.einsum("ik,kij,jk->k", e, np.linalg.inv(p), e))
    mean = np.mean(found, axis=0)
    low, high = stats.chi2.ppf([0.025, 0.975], 4 * RUNS) / RUNS
    # 99 instants, correlated over a second or so: of 95 % some 88 to 100 % are inside.
    assert np.mean((mean >= low) & (mean <= high)) >= 0.88
