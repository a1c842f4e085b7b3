"""Delays shift; a fractional delay moves the edge to where it belongs; holds and transitions cross rates."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from tests.blocks.library.harness import alone, assert_close, few, noise, run_y
from twodof.blocks.diagram import Diagram
from twodof.blocks.library import (
    Delay,
    FirstOrder,
    FractionalDelay,
    Integrator,
    RateTransition,
    Time,
    UnitDelay,
    ZeroOrderHold,
)
from twodof.blocks.reference.interpreter import Reference
from twodof.errors import ParameterError

pytestmark = pytest.mark.slow


def shifted(u: np.ndarray, samples: int, initial: float) -> np.ndarray:
    return np.concatenate((np.full(samples, initial), u))[: len(u)]


@few
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=30), st.integers(1, 8), st.integers(0, 5), st.floats(-2, 2))
def test_a_delay_shifts(values: list[float], samples: int, spare: int, initial: float) -> None:
    u = np.array(values)
    y = run_y(Delay(samples, samples + spare, initial), u)
    np.testing.assert_array_equal(y, shifted(u, samples, initial))


@pytest.mark.parametrize(
    ("kind", "initial", "values"),
    [
        ("real", 0.5, noise(20).tolist()),
        ("bool", False, [True, False, True, True]),
        ("int32", 7, [3, -4, 5, 6]),
        ("real", [1.0, 2.0, 3.0], noise(30).reshape(10, 3).tolist()),
    ],
)
def test_delays_shift_values_of_all_kinds_and_rows(kind: str, initial: Any, values: list[Any]) -> None:
    width = len(initial) if isinstance(initial, list) else None
    for block, samples in ((Delay(2, 3, initial, kind, width), 2), (UnitDelay(initial, kind, width), 1)):
        assert run_y(block, values).tolist() == [initial] * samples + values[:-samples]


def test_a_tuned_delay_acts_on_the_samples_that_are_kept() -> None:
    machine = Reference(alone(Delay(2, 5, initial=-1.0)), 0.01).machine()
    u = np.arange(1.0, 13.0)
    assert machine.run(6, {"u_in": u[:6]})["y_out"].tolist() == [-1, -1, 1, 2, 3, 4]
    machine.set("block.samples", 5)
    assert machine.run(3, {"u_in": u[6:9]})["y_out"].tolist() == [2, 3, 4]
    machine.set("block.samples", 1)
    assert machine.run(3, {"u_in": u[9:]})["y_out"].tolist() == [9, 10, 11]
    with pytest.raises(ParameterError, match="outside"):
        machine.set("block.samples", 6)


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("samples", [1, 3, 7])
def test_a_fractional_delay_on_the_grid_is_a_delay(samples: int, direct: bool) -> None:
    u = noise(20)
    y = run_y(FractionalDelay(samples * 0.25, 7, 0.5, direct), u, dt=0.25)
    np.testing.assert_array_equal(y, shifted(u, samples, 0.5))


def test_a_delay_that_breaks_loops_is_at_least_one_tick() -> None:
    u = noise(10)
    assert FractionalDelay(direct=False).trace.feedthrough["y"] == frozenset()
    np.testing.assert_array_equal(run_y(FractionalDelay(0.001, direct=False), u), shifted(u, 1, 0.0))


def test_a_delay_longer_than_the_buffer_is_nan() -> None:
    assert np.all(np.isnan(run_y(FractionalDelay(0.0801, samples=8), np.ones(5))))
    assert not np.any(np.isnan(run_y(FractionalDelay(0.08, samples=8), np.ones(5))))


def delayed_into(plant: Any, tau: float, direct: bool = True) -> Diagram:
    d = Diagram("delayed")
    d.input("u")
    d.add("delay", FractionalDelay(tau, 16, direct=direct), u="u")
    d.add("plant", plant, u="delay")
    d.output("x", "plant.y")
    return d


@few
@given(st.floats(0.0, 1.5), st.integers(0, 3))
def test_the_integral_of_a_delayed_signal_is_exact(tau: float, seed: int) -> None:
    dt, u = 0.1, noise(25, seed)
    x = Reference(delayed_into(Integrator(), tau), dt).machine().run(25, {"u": u})["x"]
    # The integral of the staircase u up to t_k - tau; it starts at 0.
    edges = dt * np.arange(26)
    area = np.concatenate(([0.0], np.cumsum(u) * dt))
    expected = np.interp(dt * np.arange(25) - tau, edges, area, left=0.0)
    # 25 steps of roundings of numbers of about 1, and tau / dt is known to 1e-15.
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("tau", [0.0035, 0.02, 0.0221, 0.03999])
def test_a_delayed_lag_follows_the_exact_zero_order_hold(tau: float) -> None:
    dt, time_constant, u = 0.01, 0.5, noise(200)
    x = Reference(delayed_into(FirstOrder(1.0, time_constant), tau), dt).machine().run(200, {"u": u})["x"]
    whole = int(tau / dt)
    f = tau / dt - whole
    decay = linalg.expm(np.array([[-1 / time_constant]]) * dt)[0, 0]
    late = np.exp(-(1 - f) * dt / time_constant)  # what is left of what came before the edge
    expected, state = [], 0.0
    padded = np.concatenate((np.zeros(whole + 1), u))
    for k in range(200):
        expected.append(state)
        state = decay * state + (1 - np.exp(-f * dt / time_constant)) * late * padded[k] + (1 - late) * padded[k + 1]
    # RK4 leaves (h/T)^5 / 120 = 3e-11 a step of the state's change, over some 50 steps of memory.
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9)


def test_a_hold_samples_a_continuous_signal_at_its_own_ticks() -> None:
    d = Diagram("sampled")
    d.input("u")
    d.add("x", Integrator(), u="u")
    d.add("hold", ZeroOrderHold(), u="x", rate=(5, 2))
    d.add("fast", ZeroOrderHold(), u="hold")
    d.add("x2", Integrator(), u="fast")
    d.output("held", "hold")
    d.output("integral", "x2")
    rows = Reference(d, 0.1).machine().run(20, {"u": 1.0})
    k = np.arange(20)
    held = np.where(k < 2, 0.0, (k - 2) // 5 * 5 + 2) * 0.1
    assert_close(rows["held"], held)
    assert_close(rows["integral"], np.concatenate(([0.0], np.cumsum(held)[:-1])) * 0.1)


def test_a_rate_transition_gives_the_sample_before() -> None:
    d = Diagram("two_rates")
    d.add("clock", Time(), rate=(2, 0))
    d.add("fast", RateTransition(-1.0), u="clock.y")
    d.add("slow", RateTransition(-1.0), u="fast", rate=(4, 0))
    d.output("fast", "fast")
    d.output("slow", "slow")
    rows = Reference(d, 1.0).machine().run(10)
    assert rows["fast"].tolist() == [-1, 0, 0, 2, 2, 4, 4, 6, 6, 8]
    assert rows["slow"].tolist() == [-1, -1, -1, -1, -1, -1, -1, -1, 2, 2]
