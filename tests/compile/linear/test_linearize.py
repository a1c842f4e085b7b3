"""Exact linear models: against equations and python-control."""

import math
from time import process_time
from typing import Any

import control
import numpy as np
import pytest

from tests.compile.linear.linear_diagrams import DT, chain, pendulum, same_response
from tests.compile.test_loops import powers
from twodof.blocks import Block, Diagram
from twodof.blocks import library as lib
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


def test_a_pendulum_is_its_textbook_linearization() -> None:
    model = linearize(pendulum(), DT, at={"p.theta": 0.3, "p.omega": 3.0, "p.zeta": 0.1})
    assert model.dt is None
    assert model.states == ("p.theta", "p.q")
    np.testing.assert_allclose(model.a, [[0.0, 1.0], [-9.0 * math.cos(0.3), -0.6]], rtol=1e-15)
    np.testing.assert_array_equal(model.b, [[0.0], [1.0]])
    np.testing.assert_array_equal(model.c, [[1.0, 0.0]])
    np.testing.assert_array_equal(model.d, [[0.0]])
    assert model.point["p.theta"] == 0.3
    assert repr(model) == f"<LinearModel {model.name}: 2 states, continuous, M -> theta>"


def test_trim_finds_where_the_moment_holds_it() -> None:
    model = linearize(pendulum(), DT, at={"M": 1.0}, trim=True)
    # omega = 2: 4 sin(theta) = 1. The search ends within some roundings of its residual.
    assert model.point["p.theta"] == pytest.approx(math.asin(0.25), abs=1e-12)
    held = linearize(pendulum(), DT, at={"M": 0.1, "p.theta": 0.4}, trim=True, free=["M"])
    assert held.point["M"] == pytest.approx(4.0 * math.sin(0.4), abs=1e-12)
    assert held.point["p.theta"] == 0.4
    with pytest.raises(DiagramError, match="no equilibrium"):
        linearize(pendulum(), DT, at={"M": 5.0}, trim=True)


def test_pid_is_its_z_transform() -> None:
    kp, ki, kd, n = 0.08535, 0.25103, 0.000541, 100.0
    model = linearize(chain(lib.Pid(kp, ki, kd, n)), DT)
    assert model.dt == DT
    same_response(model, lambda z: kp + ki * DT * z / (z - 1) + kd * (z - 1) / ((1 / n + DT) * z - 1 / n), rtol=1e-11)


@pytest.mark.parametrize("samples", [1, 2, 5, 64])
def test_a_delay_is_as_many_states_newest_first(samples: int) -> None:
    model = linearize(chain(lib.Delay(samples, bound=64)), DT)
    assert model.states == tuple(f"b0.buffer[k-{i + 1}]" for i in range(samples))
    np.testing.assert_array_equal(model.a, np.eye(samples, k=-1))
    np.testing.assert_array_equal(model.b[:, 0], np.eye(samples)[0])
    np.testing.assert_array_equal(model.c[0], np.eye(samples)[-1])


def test_a_delay_of_arrays_and_a_mean() -> None:
    d = Diagram("arrays")
    d.input("u", width=2)
    d.add("delay", lib.Delay(3, width=2), u="u")
    d.output("y", "delay")
    model = linearize(d, DT)
    np.testing.assert_array_equal(model.a, np.eye(6, k=-2))
    assert model.inputs == ("u[0]", "u[1]")
    assert model.states[:3] == ("delay.buffer[k-1][0]", "delay.buffer[k-1][1]", "delay.buffer[k-2][0]")
    mean = linearize(chain(lib.MovingAverage(4)), DT)
    same_response(mean, lambda z: (1 + z**-1 + z**-2 + z**-3) / 4, rtol=1e-11)


A2, F2, B2, C2 = [[0, 1], [-2, -3]], [[0.5, 1], [0, 0.2]], [[0], [1]], [[1, 1]]


@pytest.mark.parametrize(
    ("block", "system"),
    [
        (lib.FirstOrder(2.0, 0.3), control.tf([2.0], [0.3, 1.0])),
        (lib.SecondOrder(1.5, 3.4, 0.08), control.tf([1.5 * 3.4**2], [1.0, 2 * 0.08 * 3.4, 3.4**2])),
        (lib.TransferFunction((358.5, 0.0), (1.0, 0.5747, 11.81)), control.tf([358.5, 0.0], [1.0, 0.5747, 11.81])),
        (lib.TransferFunction((2.0, 1.0, 3.0), (1.0, 4.0, 5.0)), control.tf([2.0, 1.0, 3.0], [1.0, 4.0, 5.0])),
        (lib.Integrator(), control.tf([1.0], [1.0, 0.0])),
        (lib.StateSpace(A2, B2, C2), control.ss(A2, B2, C2, 0)),
        (lib.DiscreteIntegrator("trapezoidal", 2.0), control.tf([DT, DT], [1.0, -1.0], DT)),
        (lib.DiscreteDerivative(0.5), control.tf([0.5 / DT, -0.5 / DT], [1.0, 0.0], DT)),
        (lib.DiscreteFilter((0.2, 0.3, 0.1), (1.0, -0.5, 0.06)), control.tf([0.2, 0.3, 0.1], [1.0, -0.5, 0.06], DT)),
        (lib.DiscreteTransferFunction((0.3,), (1.0, -0.7, 0.1)), control.tf([0.3], [1.0, -0.7, 0.1], DT)),
        (lib.DiscreteStateSpace(F2, B2, C2), control.ss(F2, B2, C2, 0, DT)),
    ],
    ids=lambda item: type(item).__name__,
)  # fmt: skip
def test_the_linear_blocks_are_python_controls(block: Block, system: Any) -> None:
    model = linearize(chain(block), DT)
    assert (model.dt or 0) == system.dt
    # Transfer functions to state space and back lose some digits.
    same_response(model, lambda s: system(s), rtol=1e-9)
    assert model.to_control().dt == system.dt


def test_chained_products_cost_what_their_arithmetic_does() -> None:
    """The slope of U^7 is the sum of U^i dU U^(6 - i); row by row that of a dU b is kron(a, b^T)."""
    u = np.random.Generator(np.random.PCG64(5)).uniform(-0.7, 0.7, (3, 3))
    start = process_time()
    model = linearize(powers(6), DT, at={"a": u.ravel().tolist(), "b": u.ravel().tolist()})
    assert process_time() - start < 1.0  # of five products it took minutes, of six hours
    powered = [np.linalg.matrix_power(u, i) for i in range(7)]
    slopes = [np.kron(powered[i], powered[6 - i].T) for i in range(7)]
    np.testing.assert_allclose(model.d, np.hstack([slopes[0], sum(slopes[1:])]), rtol=1e-12, atol=1e-15)
