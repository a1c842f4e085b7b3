"""Exact linear models: against equations, python-control and the published margins of the course."""

from __future__ import annotations

import math
from time import process_time
from typing import Any

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from tests.compile.linear.linear_diagrams import DT, chain, pendulum, same_response
from tests.compile.test_loops import powers
from twodof.blocks import Block, Diagram
from twodof.blocks import library as lib
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError
from twodof.rig.dynamics import Dynamics
from twodof.signals import GRAVITY

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


def test_trim_finds_where_the_moment_holds_it() -> None:
    model = linearize(pendulum(), DT, at={"M": 1.0}, trim=True)
    # omega = 2: 4 sin(theta) = 1. The search ends within some roundings of its residual.
    assert model.point["p.theta"] == pytest.approx(math.asin(0.25), abs=1e-12)
    held = linearize(pendulum(), DT, at={"M": 0.1, "p.theta": 0.4}, trim=True, free=["M"])
    assert held.point["M"] == pytest.approx(4.0 * math.sin(0.4), abs=1e-12)
    assert held.point["p.theta"] == 0.4
    with pytest.raises(DiagramError, match="no equilibrium"):
        linearize(pendulum(), DT, at={"M": 5.0}, trim=True)


def test_the_rig_at_hover() -> None:
    """The equations of docs/explanation/physics.md for small angles, solved for the accelerations by hand."""
    d = Diagram("hover")
    for name in ("thrust", "moment", "gust", "running"):
        d.input(name)
    d.add("dynamics", Dynamics(), **{name: name for name in d.inputs})
    for name in ("theta", "q", "x", "v"):
        d.output(name, f"dynamics.{name}")
    thrust, spring, c, c_x = 5.2, 0.03, 0.002, 0.4
    model = linearize(
        d,
        0.001,
        at={"thrust": thrust, "dynamics.spring": spring, "dynamics.viscous_idle": c, "dynamics.rail_viscous": c_x},
        inputs=["moment"],
    )
    j, m_d, m, offset = 2.6e-3, 0.374, 0.534, 5e-3
    s = m_d * offset
    mass = np.array([[j, s], [s, m]])  # of (q', v')
    forces = np.array([[-s * GRAVITY - spring, -c, 0.0, 0.0], [-thrust, 0.0, 0.0, -c_x]])
    rates = np.linalg.solve(mass, forces)
    expected = np.array([[0, 1, 0, 0], rates[0], [0, 0, 0, 1], rates[1]])
    assert model.dt is None
    assert model.states == ("dynamics.theta", "dynamics.q", "dynamics.x", "dynamics.v")
    assert set(model.left_out) == {"dynamics.sine", "dynamics.cosine"}
    np.testing.assert_allclose(model.a, expected, rtol=1e-12, atol=1e-14)
    push = np.linalg.solve(mass, [1.0, 0.0])
    np.testing.assert_allclose(model.b[:, 0], [0.0, push[0], 0.0, push[1]], rtol=1e-12)


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


MU, W, XI = 358.5, 3.437, 0.0836


def course_loop(plant: Block, integrator: Block) -> Diagram:
    """The two inner loops of the course on the paper's model: P, PID, 20 ms of delay in five samples, pitch."""
    d = Diagram("course")
    d.input("q0")
    d.input("theta0")
    d.add("theta_error", lib.Sum("+-"), a="theta0", b="theta")
    d.add("attitude", lib.Gain(11.0), u="theta_error")
    d.add("command", lib.Sum("++"), a="q0", b="attitude")
    d.add("error", lib.Sum("+-"), a="command", b="plant")
    d.add("pid", lib.Pid(0.08535, 0.25103, 0.000541, 100.0), e="error")
    d.add("delay", lib.Delay(5), u="pid")
    d.add("plant", plant, u="delay")
    d.add("theta", integrator, u="plant")
    d.output("q", "plant")
    d.output("theta_out", "theta")
    return d


def margins(cut: LinearModel) -> tuple[float, float, float]:
    """Gain margin, phase margin [deg] and crossover [rad/s] of a loop that is cut: its gain is minus the model's."""

    def loop(w: float) -> complex:
        return complex(-cut.response(w)[0, 0, 0])

    def falls(values: Any, function: Any, start: float) -> float:
        """Where a function of frequency first falls through 0 above `start`."""
        k = next(k for k in range(len(grid) - 1) if grid[k] >= start and values[k] > 0.0 >= values[k + 1])
        return float(brentq(function, grid[k], grid[k + 1]))

    grid = np.geomspace(1.0, 400.0, 2000)
    response = -cut.response(grid)[:, 0, 0]
    crossover = falls(np.abs(response) - 1.0, lambda w: abs(loop(w)) - 1.0, 1.0)
    turn = falls(-response.imag, lambda w: -loop(w).imag, crossover)
    return 1.0 / abs(loop(turn)), 180.0 + math.degrees(np.angle(loop(crossover))), crossover


def test_the_margins_of_the_course() -> None:
    """Of the published designs: 33.5 rad/s, 57.7 deg, 6.9 dB at 30 rad/s; the attitude loop 11.7 rad/s, 71.5 deg.

    They hold for the plant discretised by Tustin's rule, which spares it the hold's half sample of delay.
    """
    top = [2 * MU / DT, 0.0, -2 * MU / DT]
    bottom = [4 / DT**2 + s * 4 * XI * W / DT + W * W if s else 2 * W * W - 8 / DT**2 for s in (1, 0, -1)]
    # The pitch angle is the sum of the rates up to its own sample: backward Euler, as all integrals of the platform.
    d = course_loop(lib.DiscreteTransferFunction(top, bottom), lib.DiscreteIntegrator("backward"))
    rate = linearize(d, DT, at={"attitude.k": 0.0}, inputs=["pid.M"], outputs=["pid.M"])
    assert rate.dt == DT
    gain, phase, crossover = margins(rate)
    assert crossover == pytest.approx(33.5, abs=0.05)  # half of the last digit that is published, each
    assert phase == pytest.approx(57.7, abs=0.05)
    assert 20 * math.log10(gain) == pytest.approx(6.9, abs=0.05)
    outer = linearize(d, DT, inputs=["attitude.y"], outputs=["attitude.y"])
    _, phase, crossover = margins(outer)
    assert crossover == pytest.approx(11.7, abs=0.05)
    assert phase == pytest.approx(71.5, abs=0.05)


def test_chained_products_cost_what_their_arithmetic_does() -> None:
    """The slope of U^7 is the sum of U^i dU U^(6 - i); row by row that of a dU b is kron(a, b^T)."""
    u = np.random.Generator(np.random.PCG64(5)).uniform(-0.7, 0.7, (3, 3))
    start = process_time()
    model = linearize(powers(6), DT, at={"a": u.ravel().tolist(), "b": u.ravel().tolist()})
    assert process_time() - start < 1.0  # of five products it took minutes, of six hours
    powered = [np.linalg.matrix_power(u, i) for i in range(7)]
    slopes = [np.kron(powered[i], powered[6 - i].T) for i in range(7)]
    np.testing.assert_allclose(model.d, np.hstack([slopes[0], sum(slopes[1:])]), rtol=1e-12, atol=1e-15)
