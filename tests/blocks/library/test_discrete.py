"""Discrete linear blocks against scipy.signal and python-control."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from tests.blocks.library.harness import alone, assert_close, few, noise, run, run_y
from twodof.blocks.library import (
    DiscreteDerivative,
    DiscreteFilter,
    DiscreteIntegrator,
    DiscreteStateSpace,
    DiscreteTransferFunction,
    MovingAverage,
)
from twodof.blocks.reference.interpreter import Reference

pytestmark = pytest.mark.slow

DT = 0.02
INTEGRATORS = {"forward": [0.0, DT], "backward": [DT, 0.0], "trapezoidal": [DT / 2, DT / 2]}

coefficients = st.lists(st.floats(-1, 1), min_size=1, max_size=5)


@pytest.mark.parametrize("method", INTEGRATORS)
def test_an_integrator_is_its_rule(method: str) -> None:
    u = noise(300)
    y = run_y(DiscreteIntegrator(method, gain=3.0), u, DT)
    assert_close(y, 3.0 * signal.lfilter(INTEGRATORS[method], [1.0, -1.0], u))


@pytest.mark.parametrize("method", INTEGRATORS)
def test_an_integrator_starts_where_it_is_told(method: str) -> None:
    y = run_y(DiscreteIntegrator(method, initial=[1.5, -2.0], width=2), np.zeros((3, 2)))
    assert y.tolist() == [[1.5, -2.0]] * 3


@pytest.mark.parametrize("method", INTEGRATORS)
def test_limits_bound_the_state_too(method: str) -> None:
    u = np.concatenate((np.full(100, 1.0), np.full(100, -1.0)))
    y = run_y(DiscreteIntegrator(method, limits=[-0.3, 0.5]), u, DT)
    assert np.max(y) == 0.5
    assert np.min(y) == -0.3
    # No wind-up: the way back from 0.5 begins at once, so that 0 is reached after 0.5 / DT = 25 samples (and a half).
    assert abs(y[125]) <= 1.01 * DT


@pytest.mark.parametrize("method", INTEGRATORS)
def test_reset_reads_the_initial_value_in_its_own_sample(method: str) -> None:
    u, reset = noise(60), np.zeros(60, dtype=bool)
    reset[20:25] = True
    block = DiscreteIntegrator(method, initial=0.25, reset=True)
    y = run(block, 60, DT, {"u": u, "clear": reset})["y"]
    direct = INTEGRATORS[method][0]
    assert_close(y[20:25], 0.25 + direct * u[20:25])
    # From its last sample on it is an integrator that started there.
    assert_close(y[24:], 0.25 + signal.lfilter(INTEGRATORS[method], [1.0, -1.0], u[24:]))


def test_a_derivative_is_a_difference() -> None:
    u = noise(50)
    assert_close(run_y(DiscreteDerivative(2.0, initial=u[0]), u, DT), 2.0 * np.diff(u, prepend=u[0]) / DT)


@few
@given(coefficients, coefficients, st.floats(0.5, 2))
def test_a_filter_is_lfilter(b: list[float], a: list[float], a0: float) -> None:
    # Poles stay within |z| <= 1.2 or so: a is at most 1 beside a0; a growing response is compared relatively.
    u = noise(60)
    expected = signal.lfilter(b, [a0, *(0.5 * v for v in a)], u)
    assert_close(run_y(DiscreteFilter(b, [a0, *(0.5 * v for v in a)]), u), expected)


def test_a_filter_starts_from_lfilter_zi() -> None:
    b, a = signal.butter(3, 0.2)
    zi = signal.lfilter_zi(b, a)
    y = run_y(DiscreteFilter(b.tolist(), a.tolist(), (2.0 * zi).tolist()), np.full(50, 2.0))
    assert_close(y, np.full(50, 2.0))


def test_coefficients_can_be_tuned_while_it_runs() -> None:
    machine = Reference(alone(DiscreteFilter([1.0], [1.0, -0.5])), DT).machine()
    first = machine.run(10, {"u_in": 1.0})["y_out"]
    machine.set("block.denominator", [2.0, -1.8])
    second = machine.run(10, {"u_in": 1.0})["y_out"]
    y, expected = 0.0, []
    for k in range(20):
        y = 0.5 * y + 1.0 if k < 10 else (y * 0.5 if k == 10 else y * 0.9) + 0.5
        expected.append(y)
    # At the change the state still holds 0.5 y, made with the coefficients before it.
    assert_close(np.concatenate((first, second)), expected)


@few
@given(coefficients, coefficients)
def test_a_transfer_function_is_dlsim(numerator: list[float], denominator: list[float]) -> None:
    bottom = [1.0, *denominator]
    top = numerator[: len(bottom)]
    u = noise(40)
    block = DiscreteTransferFunction(top, bottom)
    # scipy warns of leading zeros; they change nothing, lfilter's form takes them.
    padded = [0.0] * (len(bottom) - len(top)) + top
    expected = signal.lfilter(padded, bottom, u)
    assert_close(run_y(block, u), expected)
    assert bool(block.trace.feedthrough["y"]) == (len(np.trim_zeros(top, "f") or [0.0]) == len(bottom))
    delayed = DiscreteFilter([0.0, *numerator], bottom)
    assert_close(run_y(delayed, u), signal.lfilter([0.0, *numerator], bottom, u))
    assert not delayed.trace.feedthrough["y"]


@pytest.mark.parametrize(("inputs", "outputs", "direct"), [(1, 1, True), (2, 3, True), (3, 1, False), (1, 2, None)])
def test_a_state_space_is_dlsim(inputs: int, outputs: int, direct: bool | None) -> None:
    rng = np.random.default_rng(inputs + 10 * outputs)
    A = rng.uniform(-0.4, 0.4, (4, 4))
    B, C = rng.standard_normal((4, inputs)), rng.standard_normal((outputs, 4))
    D = rng.standard_normal((outputs, inputs)) if direct else np.zeros((outputs, inputs))
    start = rng.standard_normal(4)
    block = DiscreteStateSpace(
        A.tolist(), B.tolist(), C.tolist(), None if direct is None else D.tolist(), initial=start.tolist()
    )
    u = noise(60 * inputs).reshape(60, inputs)
    _, expected, _ = signal.dlsim((A, B, C, D, DT), u, x0=start)
    y = run_y(block, u[:, 0] if inputs == 1 else u, DT)
    assert_close(y.reshape(60, outputs), expected)
    assert bool(block.trace.feedthrough["y"]) == bool(direct)


def test_a_moving_average_is_a_convolution() -> None:
    u = noise(50)
    padded = np.concatenate((np.full(6, 0.5), u))
    assert_close(run_y(MovingAverage(7, initial=0.5), u), np.convolve(padded, np.full(7, 1 / 7), "valid"))
