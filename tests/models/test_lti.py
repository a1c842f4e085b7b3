"""Linear models against closed forms, scipy and python-control."""

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete

from twodof.errors import ParameterError
from twodof.models.lti import DelayedStateSpace, step_figures
from twodof.models.plant import PAPER_PITCH_RATE, Longitudinal, PitchRate, Velocity, thrust_curve

pytestmark = pytest.mark.slow

DT = 0.004


TWO_INPUTS = DelayedStateSpace.of([[0.0, 1.0], [-9.0, -0.5]], [[0.0, 1.0], [3.0, -2.0]], [1.0, 0.0], [[0.0, 0.5]])


@pytest.mark.parametrize("plant", [Longitudinal().state_space(), TWO_INPUTS], ids=["longitudinal", "two inputs"])
def test_hold_without_delay_is_that_of_scipy(plant: DelayedStateSpace) -> None:
    held = plant.zero_order_hold(DT)
    a, b, c, d, _ = cont2discrete((plant.a, plant.b, plant.c, plant.d), DT, method="zoh")
    np.testing.assert_allclose(held.phi, a, rtol=0, atol=1e-14)
    # |b| is 1.8 here: a few roundings.
    np.testing.assert_allclose(held.new, b, rtol=0, atol=1e-13)
    assert not held.old.any()
    assert (held.c == c).all()
    assert (held.d == d).all()


@pytest.mark.parametrize("tau", [0.0, 0.0011, 0.004, 0.0187, 0.020])
def test_fractional_delay_is_a_finer_grid_on_which_it_is_whole(tau: float) -> None:
    # On a grid of 0.1 ms every delay here is a whole number of steps, so the fine simulation needs no split.
    rng = np.random.default_rng(1)
    u = rng.standard_normal(150)
    coarse = Longitudinal(tau=tau).state_space().zero_order_hold(DT).simulate(u)
    fine = Longitudinal(tau=tau).state_space().zero_order_hold(1e-4).simulate(np.repeat(u, 40))[::40]
    # 6000 fine steps of an unstable plant: rounding grows with it.
    np.testing.assert_allclose(coarse, fine, rtol=0, atol=1e-9 * np.abs(fine).max())


@pytest.mark.parametrize("tau", [0.0, 0.0187, 0.020])
def test_augmented_model_is_the_same_for_a_tool_that_knows_no_delay(tau: float) -> None:
    rng = np.random.default_rng(2)
    u = rng.standard_normal(100)
    held = Longitudinal(tau=tau).state_space().zero_order_hold(DT)
    system = control.ss(*held.augmented(), DT)
    theirs = control.forced_response(system, inputs=u).outputs
    np.testing.assert_allclose(held.simulate(u), theirs.T, rtol=0, atol=1e-11 * np.abs(theirs).max())


def test_step_of_the_pitch_rate_is_the_closed_form() -> None:
    plant = PitchRate(w_n=3.437, xi=0.0836, mu=358.5, tau=0.0103)
    t = DT * np.arange(800)
    q = plant.state_space().zero_order_hold(DT).simulate(np.ones(800))[:, 1]
    w_d = plant.w_n * np.sqrt(1.0 - plant.xi**2)
    late = np.maximum(t - plant.tau, 0.0)
    closed = plant.mu / w_d * np.exp(-plant.xi * plant.w_n * late) * np.sin(w_d * late)
    np.testing.assert_allclose(q, closed, rtol=0, atol=1e-10)


def test_a_pitched_drone_falls_along_its_axis_with_g() -> None:
    """Nose up and at rest, a drone whose thrust holds its weight accelerates backwards by g theta."""
    drop = Longitudinal(x_u=0.0, x_q=0.0, m_u=0.0, m_q=0.0).state_space().zero_order_hold(DT)
    u = drop.simulate(np.zeros(50), x0=[0.0, 0.0, 0.1])[:, 0]
    np.testing.assert_allclose(u, -9.81 * 0.1 * DT * np.arange(50), rtol=0, atol=1e-12)


def test_input_before_the_record_fills_the_delay() -> None:
    plant = Velocity(4.748, 1.168).state_space()
    delayed = DelayedStateSpace(plant.a, plant.b, plant.c, plant.d, 0.0187)
    rest = delayed.zero_order_hold(DT).simulate(np.full(50, 0.2), before=0.2)
    at_once = plant.zero_order_hold(DT).simulate(np.full(50, 0.2))
    np.testing.assert_allclose(rest, at_once, rtol=0, atol=1e-14)


def test_frequency_response_of_the_paper() -> None:
    omega = np.logspace(-1, 2, 50)
    s = 1j * omega
    p = PAPER_PITCH_RATE
    paper = p.mu * s / (s**2 + 2 * p.xi * p.w_n * s + p.w_n**2) * np.exp(-s * p.tau)
    ours = p.state_space().response(omega)[:, 1, 0]
    np.testing.assert_allclose(ours, paper, rtol=1e-12)


def test_step_figures_are_those_of_python_control() -> None:
    system = control.tf([25.0], [1.0, 4.0, 25.0])
    t = np.linspace(0.0, 4.0, 40001)
    y = control.step_response(system, t).outputs
    ours, theirs = step_figures(t, y, 0.0, 1.0), control.step_info(system, T=t)
    # python-control takes samples, here 0.1 ms apart; ours are interpolated between them.
    assert ours.rise_time == pytest.approx(theirs["RiseTime"], abs=2e-4)
    assert ours.settling_time == pytest.approx(theirs["SettlingTime"], abs=2e-4)
    assert 100.0 * ours.overshoot == pytest.approx(theirs["Overshoot"], rel=1e-6)
    assert ours.peak_time == pytest.approx(theirs["PeakTime"], abs=2e-4)
    # And overshoot is the closed form exp(-pi xi / sqrt(1 - xi^2)).
    assert ours.overshoot == pytest.approx(np.exp(-np.pi * 0.4 / np.sqrt(1.0 - 0.16)), rel=1e-6)


@pytest.mark.parametrize(("start", "final"), [(0.0, 1.0), (3.0, -1.0)])
def test_step_figures_are_interpolated_between_samples(start: float, final: float) -> None:
    z = np.array([0.0, 0.5, 1.2, 1.0, 1.0])
    found = step_figures(2.0 * np.arange(5), start + (final - start) * z, start, final)
    assert found.rise_time == pytest.approx(2.0 * (1.0 + 0.4 / 0.7 - 0.2))
    assert found.settling_time == pytest.approx(2.0 * (2.0 + 0.18 / 0.2))
    assert (found.overshoot, found.peak) == (pytest.approx(0.2), pytest.approx(start + 1.2 * (final - start)))
    assert (found.peak_time, found.final) == (4.0, final)


def test_a_step_that_does_not_settle_says_so() -> None:
    t = np.linspace(0.0, 1.0, 101)
    figures = step_figures(t, 0.5 * t, 0.0, 1.0)
    assert np.isnan(figures.settling_time)
    assert np.isnan(figures.rise_time)
    at_once = step_figures(t, np.ones(101), 0.0, 1.0)
    assert (at_once.settling_time, at_once.rise_time, at_once.overshoot) == (0.0, 0.0, 0.0)


def test_bad_models_are_refused() -> None:
    with pytest.raises(ParameterError, match="shapes"):
        DelayedStateSpace.of(np.eye(2), [1.0, 0.0, 0.0], [[1.0, 0.0]], [[0.0]])
    with pytest.raises(ParameterError, match="NaN"):
        DelayedStateSpace.of([[np.nan]], [1.0], [[1.0]], [[0.0]])
    with pytest.raises(ParameterError, match="delay"):
        DelayedStateSpace.of([[1.0]], [1.0], [[1.0]], [[0.0]], delay=-0.1)
    with pytest.raises(ParameterError, match="sample time"):
        Velocity(1.0, 1.0).state_space().zero_order_hold(0.0)
    with pytest.raises(ParameterError, match="so this is not a step"):
        step_figures([0.0, 1.0], [0.0, 0.0], 1.0, 1.0)


def test_paper_equations_7_and_8() -> None:
    # T_P = 1.83 s and T_S = 16 s are what the paper measured; its model gives them back as printed.
    assert PAPER_PITCH_RATE.period == pytest.approx(1.83, abs=0.006)
    assert PAPER_PITCH_RATE.settling_time == pytest.approx(16.0, abs=0.02)


def test_thrust_curve_comes_back_from_the_two_gains_it_makes() -> None:
    a, b = 0.3, 160.0
    idle, run = b * (1.0 - a + a * 0.1), 2.0 * b * (1.0 - a + 2.0 * a * 0.4)
    assert thrust_curve(idle, run) == pytest.approx(a, rel=1e-12)
    # The real drone's gains, 112 to 118 and 288 +- 8, need a curve of about .3.
    assert thrust_curve(115.0, 288.0) == pytest.approx(0.3, abs=0.05)
    with pytest.raises(ParameterError, match="no thrust curve"):
        thrust_curve(200.0, 300.0)
    with pytest.raises(ParameterError, match="not both positive"):
        thrust_curve(0.0, 900.0)
