"""The PID against its transfer functions and the drone's own law; anti-windup."""

import itertools

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from tests.blocks.library.harness import alone, assert_close, few, noise, run, run_y
from twodof.blocks.diagram import Diagram
from twodof.blocks.library import FirstOrder, Integrator, Pid, Step, Sum
from twodof.blocks.reference.interpreter import Reference

DT = 0.004
# s as a rational function of z, by rule: (numerator, denominator).
RULES = {
    "forward": ([1.0, -1.0], [0.0, DT]),
    "backward": ([1.0, -1.0], [DT, 0.0]),
    "trapezoidal": ([2.0, -2.0], [DT, DT]),
}


def expected_pid(
    e: np.ndarray, Kp: float, Ki: float, Kd: float, N: float, integral: str, derivative: str
) -> np.ndarray:
    """Kp + Ki / s + Kd N s / (s + N), s replaced in each part by its rule."""
    s_top, s_bottom = (np.array(v) for v in RULES[integral])
    total = Kp * e + signal.lfilter(Ki * s_bottom, s_top, e)
    s_top, s_bottom = (np.array(v) for v in RULES[derivative])
    return total + signal.lfilter(Kd * N * s_top, s_top + N * s_bottom, e)


@pytest.mark.parametrize(("integral", "derivative"), list(itertools.product(RULES, RULES)))
def test_each_part_follows_its_rule(integral: str, derivative: str) -> None:
    e = noise(300)
    gains = {"Kp": 0.09, "Ki": 0.25, "Kd": 0.002, "N": 100.0}
    y = run_y(Pid(**gains, integral=integral, derivative=derivative), e, DT)
    assert_close(y, expected_pid(e, **gains, integral=integral, derivative=derivative))


@pytest.mark.parametrize(
    "gains", [(0.02901, 0.02789, 0.001105), (0.08535, 0.25103, 0.000541), (0.11269, 0.44628, 0.000268)]
)
def test_the_drones_rate_controller_is_an_instance(gains: tuple[float, float, float]) -> None:
    Kp, Ki, Kd = gains
    N, z = 100.0, control.tf([1, 0], [1], DT)
    law = Kp + Ki * DT * z / (z - 1) + Kd * (z - 1) / ((1 / N + DT) * z - 1 / N)
    e = noise(250)
    expected = control.forced_response(law, DT * np.arange(250), e).outputs
    assert_close(run_y(Pid(Kp, Ki, Kd, N), e, DT), expected, 1e-10)  # python-control multiplies the parts out


def test_in_reset_the_integral_is_its_own_samples_contribution() -> None:
    e, held = noise(40), np.zeros(40, dtype=bool)
    held[10:30] = True
    y = run(Pid(0.0, 2.0, reset="integral"), 40, DT, {"e": e, "clear": held})["M"]
    assert_close(y[10:30], 2.0 * DT * e[10:30])
    assert_close(y[29:], 2.0 * DT * np.cumsum(e[29:]))


@pytest.mark.parametrize("resets", ["integral", "all"])
def test_a_reset_of_all_covers_the_derivative(resets: str) -> None:
    e, held = noise(40), np.zeros(40, dtype=bool)
    held[20] = True
    y = run(Pid(0.0, 0.0, 0.01, reset=resets), 40, DT, {"e": e, "clear": held})["M"]
    first = signal.lfilter(*_derivative(0.01, 100.0), e)
    again = np.concatenate((first[:20], signal.lfilter(*_derivative(0.01, 100.0), e[20:])))
    assert_close(y, again if resets == "all" else first)


def _derivative(Kd: float, N: float) -> tuple[list[float], list[float]]:
    return [Kd, -Kd], [1 / N + DT, -1 / N]


def test_limits_bound_the_output() -> None:
    e = noise(100)
    free = run_y(Pid(1.0, 1.0), e, DT)
    assert run_y(Pid(1.0, 1.0, limits=[-0.5, 0.25]), e, DT).tolist() == np.clip(free, -0.5, 0.25).tolist()


@pytest.mark.parametrize("rule", RULES)
def test_clamping_stops_the_integral_at_the_limit(rule: str) -> None:
    e = np.concatenate((np.full(1000, 1.0), np.full(10, -1.0)))
    y = run_y(Pid(0.0, 10.0, integral=rule, limits=[-1.0, 1.0], anti_windup="clamping"), e, DT)
    # Without proportional part the integral itself leaves the limit, at most two samples after the error turns.
    assert y[999] == 1.0
    assert y[1009] <= 1.0 - 8 * 10.0 * DT + 1e-12
    wound = run_y(Pid(0.0, 10.0, integral=rule, limits=[-1.0, 1.0]), e, DT)
    assert np.all(wound[100:] == 1.0)


def test_back_calculation_pulls_the_integral_with_its_time_constant() -> None:
    # With e = 0 and the integral at 3, 2 above the limit, the excess decays by 1 - Kb T a sample.
    Kb = 20.0
    block = Pid(0.0, 1.0, limits=[-1.0, 1.0], anti_windup="back-calculation", Kb=Kb)
    machine = Reference(alone(block), DT).machine()
    machine.set("block.initial_integral", 3.0)
    machine.reset()
    excess = []
    for _ in range(50):
        excess.append(machine.state("block.i") - 1.0)
        machine.step({"e_in": 0.0})
    assert_close(excess, 2.0 * (1.0 - Kb * DT) ** np.arange(50))


def overshoot(anti_windup: str) -> float:
    """Of a lag after an integrator, driven through a saturated PID by a step."""
    d = Diagram("loop")
    d.add("r", Step(0.0, after=1.0))
    d.add("error", Sum("+-"), a="r", b="x")
    d.add("pid", Pid(2.0, 1.5, limits=[-0.1, 0.1], anti_windup=anti_windup, Kb=2.0), e="error")
    d.add("lag", FirstOrder(1.0, 0.2), u="pid")
    d.add("x", Integrator(), u="lag")
    d.output("x", "x")
    return float(np.max(Reference(d, 0.05).machine().run(500)["x"])) - 1.0


def test_anti_windup_lowers_the_overshoot() -> None:
    none = overshoot("none")
    assert none > 0.3
    assert overshoot("clamping") < 0.3 * none
    assert overshoot("back-calculation") < 0.3 * none


@few
@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60), st.sampled_from(["clamping", "back-calculation"]))
def test_within_the_limits_anti_windup_does_nothing(values: list[float], anti_windup: str) -> None:
    e = np.array(values)
    free = Pid(0.1, 0.2, 0.001)
    bound = Pid(0.1, 0.2, 0.001, limits=[-1e3, 1e3], anti_windup=anti_windup)
    np.testing.assert_array_equal(run_y(bound, e, DT), run_y(free, e, DT))
