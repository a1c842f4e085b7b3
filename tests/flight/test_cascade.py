"""The cascade against scipy's and python-control's discrete systems, its modes, its reset, its sum in float32."""

import math
from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from twodof.blocks import Diagram
from twodof.blocks.reference.interpreter import Reference, ReferenceMachine
from twodof.flight.cascade import ArmingReset, LevelHold, cascade
from twodof.flight.gains import DEFAULT, STUDENT
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, POSITION, RATE, VELOCITY

pytestmark = pytest.mark.slow

TS = 0.004
N = 100.0
LOG = (
    *(f"rate.{term}" for term in ("proportional", "integral", "derivative", "increment")),
    *(f"velocity.{term}" for term in ("force", "integral", "increment")),
)


def machine(precision: str = "float64") -> ReferenceMachine:
    return Reference(cascade(DEFAULT), TS, precision, LOG).machine()


def noise(n: int, seed: int, size: float = 0.1) -> NDArray[np.float64]:
    return size * np.random.default_rng(seed).standard_normal(n)


def test_the_rate_loop_is_the_discrete_pid_of_scipy() -> None:
    q0, q = noise(1500, 1), noise(1500, 2)
    kp, ki, kd = DEFAULT.rate
    # Kp + Ki Ts z / (z - 1) + Kd (z - 1) / ((1/N + Ts) z - 1/N), over one denominator.
    integral, slope = np.array([1.0, -1.0]), np.array([1.0 / N + TS, -1.0 / N])
    numerator = (
        kp * np.polymul(integral, slope)
        + ki * TS * np.polymul([1.0, 0.0], slope)
        + kd * np.polymul([1.0, -1.0], integral)
    )
    expected = signal.lfilter(numerator, np.polymul(integral, slope), q0 - q)
    out = machine().run(1500, {"mode": RATE, "q0": q0, "q": q})
    # The two orders of rounding part by 1e-16 of the largest term at each of 1500 steps.
    np.testing.assert_allclose(out["M"], expected, rtol=0.0, atol=1e-13)


def test_the_velocity_loop_is_python_controls_discrete_pi() -> None:
    v0, v = noise(800, 3, 0.05), noise(800, 4, 0.05)
    kp, ki = DEFAULT.velocity
    pi = control.tf([kp + ki * TS, -kp], [1.0, -1.0], TS)
    time = TS * np.arange(800)
    expected = control.forced_response(pi, time, v0 - v).outputs
    out = machine().run(800, {"mode": VELOCITY, "v0": v0, "v": v})
    np.testing.assert_allclose(out["velocity.force"], expected, rtol=0.0, atol=1e-12)


def test_the_projection_pushes_with_the_force_and_keeps_the_vertical_thrust() -> None:
    m = machine()
    out = m.run(300, {"mode": VELOCITY, "v0": noise(300, 5, 0.3)})
    t_bar, eta = m.get("projection.T_bar"), m.get("projection.eta_T")
    np.testing.assert_allclose(out["T"] * np.cos(out["theta0"]), t_bar, rtol=1e-15)
    # v' > 0 needs theta < 0: the force along the rail is -T eta_T sin(theta0).
    np.testing.assert_allclose(-out["T"] * eta * np.sin(out["theta0"]), out["velocity.force"], rtol=1e-14)


def test_the_proportional_loops() -> None:
    out = machine().step({"mode": POSITION, "x0": 0.2, "x": -0.1, "theta": 0.1})
    assert out["v0"] == pytest.approx(1.5 * 0.3, rel=1e-15)
    assert out["q0"] == pytest.approx(11.0 * (out["theta0"] - 0.1), rel=1e-15)


def given_everything(mode: int) -> dict[str, Any]:
    return {
        "mode": mode,
        "x0": 0.1,
        "v0": 0.2,
        "theta0": 0.3,
        "q0": 0.4,
        "thrust": 0.35,
        "M_open": 0.05,
        "x": 0.02,
        "v": 0.01,
        "theta": 0.03,
        "q": 0.04,
    }


@pytest.mark.parametrize("mode", [OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION])
def test_a_mode_uses_its_own_set_point_and_those_above_stay_zero(mode: int) -> None:
    out = machine().step(given_everything(mode))
    if mode == RATE:
        assert out["q0"] == 0.4
    if mode == ATTITUDE:
        assert out["theta0"] == 0.3
    if mode == VELOCITY:
        assert (out["v0"], out["x0"]) == (0.2, 0.02)
    if mode == POSITION:
        assert out["x0"] == 0.1
        assert out["v0"] == pytest.approx(1.5 * 0.08, rel=1e-15)
    if mode <= ATTITUDE:
        assert (out["x0"], out["v0"]) == (0.0, 0.0)
    if mode < ATTITUDE:
        assert out["theta0"] == 0.0


def test_thrust_and_moment_come_from_where_the_mode_says() -> None:
    off, opened, level = (machine().step(given_everything(mode)) for mode in (OFF, OPEN_LOOP, ATTITUDE))
    assert (off["M"], off["T"]) == (0.0, 0.0)
    assert (opened["M"], opened["T"]) == (0.05, 0.35)
    assert level["T"] == 0.35
    assert level["M"] not in (0.0, 0.05)


def test_in_reset_an_integral_is_its_own_samples_contribution_and_the_derivative_runs_on() -> None:
    q0 = noise(120, 6)
    in_reset = np.zeros(120, dtype=bool)
    in_reset[40:60] = True
    out = machine().run(120, {"mode": RATE, "q0": q0, "in_reset": in_reset})
    free = machine().run(120, {"mode": RATE, "q0": q0})
    np.testing.assert_array_equal(out["rate.integral"][40:60], out["rate.increment"][40:60])
    np.testing.assert_array_equal(out["rate.derivative"], free["rate.derivative"])
    kept = out["rate.increment"][59] + np.cumsum(out["rate.increment"][60:])
    np.testing.assert_allclose(out["rate.integral"][60:], kept, rtol=0.0, atol=1e-16)


@pytest.mark.parametrize(
    ("outside", "inside", "loop", "inputs"),
    [
        (ATTITUDE, VELOCITY, "velocity", {"theta0": 0.1, "v0": 0.3, "v": 0.1}),
        (OPEN_LOOP, RATE, "rate", {"q0": 0.3, "q": 0.1}),
        (OFF, ATTITUDE, "rate", {"theta0": 0.1, "q": 0.1}),
    ],
)
def test_an_integral_outside_the_closed_loops_does_not_wind_up(
    outside: int, inside: int, loop: str, inputs: dict[str, float]
) -> None:
    m = machine()
    held = m.run(500, {"mode": outside, **inputs})
    out = m.step({"mode": inside, **inputs})
    # On board, too, the last sample in reset leaves its own contribution behind, and no more.
    expected = held[f"{loop}.increment"][-1] + out[f"{loop}.increment"]
    assert out[f"{loop}.integral"] == pytest.approx(expected, rel=1e-15)


def test_the_level_hold_and_the_reset_at_arming_are_their_laws() -> None:
    """Against both written out: random modes and thrust, each for some samples."""
    rng, n, settle, window = np.random.default_rng(8), 3600, 5, 30
    mode = rng.choice([OFF, OPEN_LOOP, RATE, ATTITUDE, ATTITUDE, VELOCITY, POSITION], n // 60).repeat(60)
    thrust, moment = np.where(rng.random(n // 50) < 0.8, 0.4, 0.0).repeat(50), noise(n, 9)
    use_trim, in_reset = rng.random((2, n)) < 0.1
    d = Diagram("alone")
    for block in (LevelHold(), ArmingReset()):
        for port in block.inputs:
            if port.name not in d.inputs:
                d.input(port.name, port.kind, unit=port.unit)
        name = type(block).__name__
        d.add(name, block, inputs={port.name: port.name for port in block.inputs})
        for port in block.outputs:
            d.output(f"{name}_{port.name}", f"{name}.{port.name}")
    m = Reference(d, TS).machine()
    m.set_many({"LevelHold.settle": settle * TS, "LevelHold.window": window * TS})
    given = {"mode": mode, "thrust": thrust, "M": moment, "use_trim": use_trim, "in_reset": in_reset}
    out = m.run(n, {**given, "excitation": 0.01})
    held = armed = 0
    trim = 0.0
    for k in range(n):
        assert out["LevelHold_M_trim"][k] == pytest.approx(trim, abs=1e-15)
        assert out["LevelHold_M_open"][k] == pytest.approx(0.01 + use_trim[k] * trim, abs=1e-15)
        held = held + 1 if mode[k] == ATTITUDE and thrust[k] > 0.0 else 0
        if held > settle:
            trim += (moment[k] - trim) / min(held - settle, window)
        thrusts = mode[k] >= VELOCITY or (mode[k] >= RATE and thrust[k] > 0.0)
        assert out["ArmingReset_in_reset"][k] == (in_reset[k] or not thrusts or armed < 3)
        armed = armed + 1 if thrusts else 0


@pytest.mark.long
def test_the_sum_in_float32_stays_where_the_double_sum_is() -> None:
    n = 3000
    q0 = (1.0 + noise(n, 7)).astype(np.float32).astype(np.float64)
    out = machine("float32").run(n, {"mode": RATE, "q0": q0})
    exact = np.array([math.fsum(out["rate.increment"][: k + 1].tolist()) for k in range(0, n, 100)])
    plain = np.cumsum(out["rate.increment"].astype(np.float32), dtype=np.float32)[::100]
    error = np.abs(out["rate.integral"][::100] - exact)
    # Kahan: two roundings of the result, whatever the number of terms; a plain sum drifts with it.
    assert np.all(error <= np.finfo(np.float32).eps * np.abs(exact))
    assert np.abs(plain - exact).max() > 10.0 * error.max()


def test_the_moment_is_limited() -> None:
    out = machine().step({"mode": RATE, "q0": 100.0})
    assert out["M"] == 1.0
    assert machine().step({"mode": RATE, "q0": -100.0})["M"] == -1.0


def test_gains_are_tuned_by_path_within_bounds() -> None:
    m = machine()
    m.set_many(STUDENT.parameters())
    assert m.step({"mode": ATTITUDE, "theta0": 0.1})["q0"] == pytest.approx(0.61986, rel=1e-15)
