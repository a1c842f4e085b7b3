"""The core as a whole: what is read when, reset at arming, level hold, and the same bits compiled as interpreted."""

import functools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.blocks.reference.interpreter import Reference, ReferenceMachine
from twodof.compile import CompiledProgram, build
from twodof.flight.core import OUTPUTS, core
from twodof.flight.declarations import INPUTS
from twodof.flight.estimator import POSITION_FILTERS
from twodof.flight.gains import DEFAULT
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, PERIOD, POSITION, RATE, VELOCITY

pytestmark = pytest.mark.slow

GRAVITY = 9.81


@functools.cache
def compiled() -> CompiledProgram:
    return build(core(), dt=PERIOD)


def machine(*log: str) -> ReferenceMachine:
    return Reference(core(), PERIOD, log=log).machine()


def test_the_ports_are_those_that_are_documented() -> None:
    diagram = core()
    assert list(diagram.inputs) == [name for name, *_ in INPUTS]
    assert [(p.kind, p.unit) for p in diagram.inputs.values()] == [(kind, unit) for _, kind, unit, _ in INPUTS]
    assert sorted(diagram.outputs) == sorted(name for name, *_ in OUTPUTS)


def test_the_attitude_loop_reads_the_pitch_of_the_sample_before() -> None:
    rng = np.random.default_rng(1)
    inputs = {"acc_z": -GRAVITY, "gyro_y": rng.standard_normal(60), "mode": ATTITUDE, "thrust": 0.4, "theta0": 0.1}
    out = machine().run(60, inputs)
    expected = DEFAULT.attitude * (0.1 - out["theta"][:-1])
    np.testing.assert_allclose(out["q0"][1:], expected, rtol=1e-14)


def test_the_integrals_are_in_reset_when_off_and_three_samples_beyond_arming() -> None:
    mode = np.where(np.arange(60) < 20, OFF, ATTITUDE)
    log = ("cascade.rate.integral", "cascade.rate.increment")
    out = machine(*log).run(60, {"acc_z": -GRAVITY, "theta0": 0.1, "mode": mode, "thrust": 0.4})
    integral, increment = (out[name] for name in log)
    np.testing.assert_array_equal(integral[:23], increment[:23])
    assert np.all(integral[23:] > increment[23:])
    assert integral[23] == pytest.approx(increment[22] + increment[23], rel=1e-15)


def test_thrust_switched_off_and_on_again_restarts_the_integrals() -> None:
    thrust = np.where((np.arange(90) >= 30) & (np.arange(90) < 50), 0.0, 0.4)
    log = ("cascade.rate.integral", "cascade.rate.increment")
    out = machine(*log).run(90, {"acc_z": -GRAVITY, "theta0": 0.1, "mode": ATTITUDE, "thrust": thrust})
    in_reset = out[log[0]] == out[log[1]]
    assert np.flatnonzero(in_reset).tolist() == [0, 1, 2, *range(30, 53)]


class PitchAxis:
    """A pitch axis with the paper's G_q and a lasting moment M_0; semi-implicit Euler, noise-free sensors."""

    def __init__(self, m_0: float) -> None:
        self.m_0, self.theta, self.q = m_0, 0.05, 0.0

    def sensors(self) -> dict[str, float]:
        return {
            "acc_x": GRAVITY * float(np.sin(self.theta)),
            "acc_z": -GRAVITY * float(np.cos(self.theta)),
            "gyro_y": self.q,
            "dist": 0.5,
        }

    def step(self, moment: float) -> None:
        mu, xi, w_n = 358.5, 0.0836, 3.437
        self.q += PERIOD * (mu * (moment - self.m_0) - 2.0 * xi * w_n * self.q - w_n**2 * self.theta)
        self.theta += PERIOD * self.q


def fly(m: Any, axis: PitchAxis, steps: int, **inputs: Any) -> NDArray[np.float64]:
    """Pitch (steps,) [rad] while the core flies the axis."""
    theta = []
    for k in range(steps):
        out = m.step(axis.sensors() | {"dist_new": k % 14 == 0} | inputs)
        axis.step(out["M"])
        theta.append(axis.theta)
    return np.array(theta)


def test_the_level_hold_finds_the_trim_and_the_open_loop_starts_from_it() -> None:
    m, axis = compiled().machine(), PitchAxis(m_0=-0.0103)
    level = fly(m, axis, 3000, mode=ATTITUDE, thrust=0.4)
    assert np.abs(level[-250:]).max() < 1e-3
    trim = m.step(axis.sensors() | {"mode": OPEN_LOOP})["M_trim"]
    # The mean over five seconds in which the loop has settled to 1e-3 rad: w_n^2 / mu times that, and less.
    assert trim == pytest.approx(-0.0103, abs=3e-5)
    opened = fly(m, axis, 250, mode=OPEN_LOOP, thrust=0.4, use_trim=True)
    assert np.abs(opened).max() < 5e-3


def test_an_excitation_is_added_to_the_trim() -> None:
    m, axis = compiled().machine(), PitchAxis(m_0=0.02)
    fly(m, axis, 3000, mode=ATTITUDE, thrust=0.4)
    out = m.step(axis.sensors() | {"mode": OPEN_LOOP, "thrust": 0.4, "M_open": 0.03, "use_trim": True})
    assert out["M"] == pytest.approx(out["M_trim"] + 0.03, rel=1e-15)
    assert (out["fore"] - out["aft"]) / 2.0 == pytest.approx(out["M"], rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize(
    ("position_filter", "precision"), [("joint", "float64"), *((name, "float32") for name in POSITION_FILTERS)]
)
def test_compiled_and_interpreted_give_the_same_bits(position_filter: str, precision: str) -> None:
    rng = np.random.default_rng(5)
    n = 400
    modes = np.repeat([OFF, ATTITUDE, OPEN_LOOP, RATE, VELOCITY, POSITION, ATTITUDE, OFF], n // 8)
    inputs = {
        "acc_x": rng.standard_normal(n),
        "acc_z": -GRAVITY + rng.standard_normal(n),
        "gyro_y": rng.standard_normal(n),
        "dist": 0.5 + 0.1 * rng.standard_normal(n),
        "dist_new": np.arange(n) % 13 == 3,
        "dist_age": rng.uniform(0.0, 0.01, n),
        "mode": modes,
        "in_reset": rng.random(n) < 0.02,
        "thrust": 0.4,
        "use_trim": True,
        **{name: 0.1 * rng.standard_normal(n) for name in ("x0", "v0", "theta0", "q0", "M_open")},
    }
    diagram = core(position_filter=position_filter)
    compiled = build(diagram, dt=PERIOD, precision=precision).machine().run(n, inputs)
    interpreted = Reference(diagram, PERIOD, precision).machine().run(n, inputs)
    for name in diagram.outputs:
        np.testing.assert_array_equal(np.asarray(compiled[name], float), np.asarray(interpreted[name], float), name)


def test_the_covariance_stays_positive_definite_in_float32() -> None:
    names = [f"estimator.filter.P_{a}_{a}" for a in ("theta", "bias", "x", "v")]
    program = build(core(), dt=PERIOD, precision="float32", log=tuple(names))
    short, long = 14 * 1_400, 14 * 17_000  # 78 and 952 s, to the same phase between two range samples

    def level(n: int) -> dict[str, Any]:
        return {"acc_z": -GRAVITY, "dist": 0.5, "dist_new": np.arange(n) % 14 == 0}

    out = program.machine().run(long, level(long))
    double = build(core(), dt=PERIOD, log=tuple(names)).machine()
    exact = double.run(short, level(short))
    for name in names:
        assert np.asarray(out[name]).min() > 0.0
        # Settled after 78 s: float32 must not drift away from it in the 874 s that follow.
        assert out[name][-1] == pytest.approx(exact[name][-1], rel=0.05)
