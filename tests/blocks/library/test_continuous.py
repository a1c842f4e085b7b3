"""Continuous linear blocks against scipy's exact response to a held input, and closed forms."""

import numpy as np
import pytest
from scipy import signal

from tests.blocks.library.harness import alone, assert_close, noise, run, run_y
from twodof.blocks.library import FirstOrder, Integrator, SecondOrder, StateSpace, TransferFunction
from twodof.blocks.reference.interpreter import Reference

pytestmark = pytest.mark.slow

DT = 0.01
STEPS = 150
# RK4 leaves (w h)^5 / 120 of the state a step, w h <= 0.09 here: 5e-8, over a memory of 1 / (w h) = 11 steps.
RK4 = 1e-6


def held(system: signal.lti, u: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    t = DT * np.arange(len(u))
    return signal.lsim(system, u, t, X0=start, interp=False)[1]


@pytest.mark.parametrize(
    ("top", "bottom"),
    [
        ([1.0], [1.0, 1.0]),
        ([2.0, 3.0], [4.0, 5.0]),
        ([358.5], [1.0, 0.575, 11.81]),
        ([1.0, 2.0, 3.0], [1.0, 1.5, 7.0]),
        ([1.0, 0.5], [2.0, 3.0, 8.0, 4.0]),
        ([0.0, 3.0], [4.0, 5.0]),
        ([0.0, 0.0, 1.0, 0.5], [2.0, 3.0, 8.0]),
    ],
)
def test_a_transfer_function_is_lsim(top: list[float], bottom: list[float]) -> None:
    u = noise(STEPS)
    block = TransferFunction(top, bottom)
    proper = np.trim_zeros(top, "f") or [0.0]
    assert_close(run_y(block, u, DT), held(signal.lti(proper, bottom), u), RK4)
    assert bool(block.trace.feedthrough["y"]) == (len(proper) == len(bottom))


@pytest.mark.parametrize("direct", [True, False, None])
def test_a_state_space_is_lsim(direct: bool | None) -> None:
    rng = np.random.default_rng(5)
    A = np.array([[-1.0, 2.0, 0.0], [-2.0, -1.0, 1.0], [0.0, 0.5, -3.0]])
    B, C = rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    D = rng.standard_normal((2, 2)) if direct else np.zeros((2, 2))
    start = np.array([1.0, -1.0, 0.5])
    u = noise(2 * STEPS).reshape(STEPS, 2)
    block = StateSpace(A.tolist(), B.tolist(), C.tolist(), None if direct is None else D.tolist(), start.tolist())
    assert_close(run_y(block, u, DT), held(signal.lti(A, B, C, D), u, start), RK4)
    assert bool(block.trace.feedthrough["y"]) == bool(direct)


def test_a_first_order_lag_is_an_exponential() -> None:
    t = DT * np.arange(STEPS)
    y = run_y(FirstOrder(3.0, 0.4, initial=0.5), np.ones(STEPS), DT)
    assert_close(y, 3.0 * (1 - 0.5 * np.exp(-t / 0.4)), RK4)


@pytest.mark.parametrize("damping", [0.0836, 1.0, 1.5])
def test_a_second_order_lag_is_lsim(damping: float) -> None:
    w, u = 3.437, noise(STEPS)
    rows = run(SecondOrder(2.0, w, damping), STEPS, DT, {"u": u})
    bottom = [1.0, 2 * damping * w, w * w]
    assert_close(rows["y"], held(signal.lti([2.0 * w * w], bottom), u), RK4)
    assert_close(rows["rate"], held(signal.lti([2.0 * w * w, 0.0], bottom), u), RK4)


def test_an_integrator_of_a_held_signal_is_a_sum() -> None:
    u = noise(2 * STEPS).reshape(STEPS, 2)
    y = run_y(Integrator([1.0, -1.0], width=2), u, DT)
    before = np.concatenate((np.zeros((1, 2)), np.cumsum(u, axis=0)[:-1]))
    assert_close(y, [1.0, -1.0] + DT * before)


def test_limits_hold_and_let_go_at_once() -> None:
    u = np.concatenate((np.full(60, 1.0), np.full(100, -1.0)))
    y = run_y(Integrator(limits=[-0.2, 0.35]), u, DT)
    ramp = np.minimum(0.35, DT * np.arange(61))
    assert_close(y[:61], ramp)
    assert_close(y[60:], np.maximum(-0.2, 0.35 - DT * np.arange(100)))


def test_an_initial_value_outside_the_limits_reads_as_the_limit() -> None:
    assert run_y(Integrator(2.0, limits=[-1.0, 1.0]), np.zeros(3), DT).tolist() == [1.0, 1.0, 1.0]


def test_parameters_can_be_tuned_while_it_runs() -> None:
    machine = Reference(alone(TransferFunction([1.0], [1.0, 1.0])), DT).machine()
    machine.run(10, {"u_in": 1.0})
    before = machine.state("block.x")
    machine.set("block.denominator", [1.0, 0.0])
    machine.run(10, {"u_in": 1.0})
    assert_close(machine.state("block.x")[0] - before[0], 0.1)
