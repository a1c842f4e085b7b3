"""Ready-made structures, run by the reference interpreter, against closed forms and independent integrators."""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Param, Port
from twodof.blocks.reference.interpreter import Reference
from twodof.errors import DiagramError, IdentificationError
from twodof.models import (
    Longitudinal,
    PitchRate,
    Structure,
    Velocity,
    free_response,
    longitudinal,
    pitch_and_velocity,
    pitch_on_cart,
    pitch_rate,
    rail,
    velocity,
)
from twodof.models.dry_friction import after_friction
from twodof.models.lti import DelayedStateSpace

pytestmark = pytest.mark.slow

DT = 0.004
Array = NDArray[np.float64]


def run(structure: Structure, values: Mapping[str, float], u: Array, dt: float = DT) -> dict[str, Array]:
    machine = Reference(structure.diagram, dt=dt, precision="float64").machine()
    machine.set_many(values)
    machine.reset()
    return machine.run(u.size, {structure.inputs[0]: u})


def noise(steps: int, seed: int = 0) -> Array:
    return 0.03 * np.sign(np.random.default_rng(seed).standard_normal(steps // 5)).repeat(5)


def cascade(tau: float) -> DelayedStateSpace:
    """The pitch, and behind it the cart."""
    p, v = PitchRate(3.437, 0.0836, 358.5, tau).state_space(), Velocity(4.748, 1.168).state_space()
    a = np.zeros((4, 4))
    a[:2, :2], a[2:, 2:], a[3, 0] = p.a, v.a, -4.748
    return DelayedStateSpace(a, np.vstack([p.b, np.zeros((2, 1))]), np.eye(4), np.zeros((4, 1)), tau)


@pytest.mark.parametrize(
    ("structure", "plant", "values"),
    [
        *(
            (
                pitch_rate(),
                PitchRate(3.437, 0.0836, 358.5, tau).state_space(),
                {"tau": tau, "theta_0": 0.1, "q_0": -0.2},
            )
            for tau in (0.0, 0.0011, 0.004, 0.0187, 0.020)
        ),
        # No damping is special.
        *((pitch_rate(), PitchRate(3.437, xi, 358.5, 0.015).state_space(), {"xi": xi}) for xi in (-0.2, 0.0, 1.0, 3.0)),
        (velocity(), Velocity(4.748, 1.168).state_space(), {"v_0": 0.05, "x_0": -0.1}),
        (longitudinal(), Longitudinal(tau=0.0187).state_space(), {"tau": 0.0187}),
        (pitch_and_velocity(), cascade(0.0187), {"tau": 0.0187}),
    ],
    ids=lambda one: getattr(one, "name", ""),
)
def test_linear_structures_are_the_exact_hold(
    structure: Structure, plant: DelayedStateSpace, values: dict[str, float]
) -> None:
    u, names = noise(200), {"velocity": ("x", "v"), "longitudinal": ("u", "q", "theta", "a_x")}
    ours = run(structure, values, u)
    order = names.get(structure.name, ("theta", "q", "x", "v"))
    start = [values.get(f"{name}_0", 0.0) for name in order[: len(plant.a)]]
    expected = plant.zero_order_hold(DT).simulate(u, x0=start, before=u[0])
    for name, column in zip(order, expected.T, strict=False):
        # Rounding only: some hundred steps.
        np.testing.assert_allclose(ours[name], column, rtol=0, atol=1e-12)


def test_lag_and_delay_share_the_total() -> None:
    # q is twice the integral of a ramp r t, so a lag L instead of the same pure delay is ahead by mu r L^2 / 2.
    u = np.linspace(0.0, 0.1, 100)
    free = {"w_n": 0.05, "xi": 0.0}
    delayed = run(pitch_rate(), {**free, "tau": 0.020}, u)["q"]
    lagged = run(pitch_rate(lag=True), {**free, "dead_time": 0.012, "lag": 0.008}, u)["q"]
    # The held ramp is a staircase: at the samples the lag sees its steps averaged, which is r dt^2 / 12 more.
    ahead = 358.5 * (u[1] / DT) * (0.008**2 / 2.0 + DT**2 / 12.0)
    # What the lag has forgotten after 0.39 s, exp(-48), is nothing; the spring of 0.05 rad/s takes 2e-4 of q.
    np.testing.assert_allclose(lagged[50:] - delayed[50:], ahead, rtol=1e-3)


@pytest.mark.parametrize("structure", [pitch_rate(ring=8), free_response(ring=8)])
def test_a_delay_longer_than_the_ring_is_no_number(structure: Structure) -> None:
    u = noise(40)
    # Six steps are kept; between the first sample, which fills the past, and the end.
    within = run(structure, {"tau": 6 * DT}, u)["q"]
    beyond = run(structure, {"tau": 6 * DT}, u, dt=DT / 2)["q"]
    assert np.isfinite(within).all()
    assert np.isnan(beyond[-1])


@pytest.mark.parametrize(
    "structure",
    [pitch_rate(ring=8), pitch_rate(True, 8), pitch_on_cart(8), rail(True, 8), free_response(8), longitudinal(8)],
    ids=lambda structure: structure.name,
)
def test_a_search_keeps_within_the_delays_that_the_ring_holds(structure: Structure) -> None:
    delays = [one for one in structure.unknowns.values() if one.name in ("tau", "dead_time", "rotor_delay")]
    assert [(one.lower, one.upper) for one in delays] == [(0.0, pytest.approx(6 * DT))] * len(delays)
    assert len(delays) == 1 + (structure.name == "rail_thrust")


def test_trim_and_bias_shift_input_and_outputs() -> None:
    u = noise(60)
    plain = run(pitch_rate(), {"tau": 0.0187}, u)
    shifted = run(pitch_rate(), {"tau": 0.0187, "M_trim": -0.0103, "q_bias": 0.5, "theta_bias": -0.1}, u - 0.0103)
    np.testing.assert_allclose(shifted["q"], plain["q"] + 0.5, rtol=0, atol=1e-12)
    np.testing.assert_allclose(shifted["theta"], plain["theta"] - 0.1, rtol=0, atol=1e-12)


def test_free_response_without_friction_is_that_of_an_accurate_integrator() -> None:
    values = {"w_n": 3.0, "xi": 0.05, "hardening": 4.0, "coulomb": 0.0, "theta_0": 0.6, "q_0": -0.5}
    steps = 500
    ours = run(free_response(), values, np.zeros(steps))

    def slope(_: float, x: Array) -> list[float]:
        return [x[1], -9.0 * np.sin(x[0]) - 4.0 * x[0] ** 3 - 0.3 * x[1]]

    t = DT * np.arange(steps)
    exact = solve_ivp(slope, (0.0, t[-1]), [0.6, -0.5], t_eval=t, method="DOP853", rtol=1e-12, atol=1e-12).y
    # RK4 at 4 ms of a swing of 3 rad/s: (w dt)^4 / 120 a radian, 6 rad here, with a constant of order one.
    np.testing.assert_allclose(ours["theta"], exact[0], rtol=0, atol=2e-8)
    np.testing.assert_allclose(ours["q"], exact[1], rtol=0, atol=5e-8)


@pytest.mark.long
def test_dry_friction_takes_its_work_from_every_swing_and_holds_in_the_end() -> None:
    # From one turn to the next the spring's energy falls by friction times the way: w^2 (cos B - cos A) = c (A + B).
    w_n, c = 3.0, 0.09
    values = {"w_n": w_n, "xi": 0.0, "hardening": 0.0, "coulomb": c, "theta_0": 0.0755, "q_0": 0.0}
    ours = run(free_response(), values, np.zeros(1500))
    theta, q = ours["theta"], ours["q"]
    turns, before = [], 0.0755
    for _ in range(3):
        before = brentq(lambda b, a=before: w_n**2 * (np.cos(b) - np.cos(a)) - c * (a + b), 0.0, before)
        turns.append(before)
    found = [-theta.min(), theta[375:].max(), -theta[700:].min()]
    # A sample misses the turn by w^2 theta dt^2 / 8 at most.
    np.testing.assert_allclose(found, turns, rtol=0, atol=1e-6)
    assert (q[-300:] == 0.0).all()
    assert abs(theta[-1]) < c / w_n**2
    assert np.ptp(theta[-300:]) == 0.0


def test_friction_holds_until_the_moment_exceeds_it() -> None:
    values = {"w_n": 3.0, "xi": 0.0, "hardening": 0.0, "mu": 100.0, "tau": 0.0, "coulomb": 1.0}
    u = np.concatenate([np.full(200, 0.0099), np.full(200, 0.0101)])
    q = run(free_response(), values, u)["q"]
    assert (q[:200] == 0.0).all()
    assert q[-1] > 0.0


def test_friction_stops_turns_back_and_lets_go_inside_a_step() -> None:
    """Under a constant drive, against the motion followed from the moment of the stop on."""
    dt, frictions = 0.5, (0.0, 0.1, 1.0, 2.0)
    cases = product((-1.0, -0.1, 0.0, 0.05, 0.3, 2.0), (-2.0, -0.1, 0.0, 0.05, 0.7, 2.0), frictions, frictions)
    for v, drive, more, less in (map(np.float64, case) for case in cases):
        slope = drive - more if v > 0.0 else drive + less
        left = dt if v == 0.0 else dt + v / slope if v * slope < 0.0 else 0.0
        after_stop = left * (max(0.0, drive - more) + min(0.0, drive + less))
        sticks = v == 0.0 and -less <= drive <= more
        with np.errstate(divide="ignore", invalid="ignore"):
            found = after_friction(0.0 if sticks else v + drive * dt, drive, more, less, dt)
        assert found == pytest.approx(after_stop if left > 0.0 else v + slope * dt, abs=1e-12), (v, drive, more, less)


def test_delay_inside_a_step_is_exact_for_the_continuous_block() -> None:
    # A constant angular acceleration that starts inside a step: q and theta are polynomials of the time since.
    values = {"w_n": 0.05, "xi": 0.0, "hardening": 0.0, "coulomb": 0.0, "mu": 100.0, "tau": 0.0137}
    u = np.concatenate([np.zeros(5), np.full(45, 0.01)])
    ours = run(free_response(), values, u)
    late = np.maximum(DT * np.arange(50) - 5 * DT - 0.0137, 0.0)
    # The spring of 0.05 rad/s cannot be switched off; it takes w^2 t^2 / 6 of q.
    np.testing.assert_allclose(ours["q"], late, rtol=2e-5, atol=1e-12)


def test_rail_is_that_of_an_accurate_integrator() -> None:
    t = DT * np.arange(400)
    q = 0.8 * np.sign(np.sin(2.0 * np.pi * t / 0.8 + 1e-9))
    ours = run(rail(), {"theta_0": 0.1, "x_0": 0.05, "v_0": -0.1}, q)
    lift = np.interp(t, t, np.cumsum(q) * DT - q * DT) + 0.1

    def slope(_: float, x: Array, rate: float) -> list[float]:
        return [rate, x[2], -4.748 * np.sin(x[0]) - 1.168 * x[2]]

    x, states = np.array([0.1, 0.05, -0.1]), []
    for rate in q:
        states.append(x)
        x = solve_ivp(slope, (0.0, DT), x, args=(rate,), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    exact = np.array(states)
    np.testing.assert_allclose(ours["theta"], lift, rtol=0, atol=1e-12)
    # RK4 at 4 ms of a rate of at most 1.2 1/s: (p dt)^5 / 120 a step, 400 of them.
    np.testing.assert_allclose(ours["x"], exact[:, 1], rtol=0, atol=1e-11)
    np.testing.assert_allclose(ours["v"], exact[:, 2], rtol=0, atol=1e-11)


def test_dry_friction_of_the_rail_stops_the_cart_in_closed_form() -> None:
    # From v_0 under constant friction c: at rest after v_0 / c, v_0^2 / (2 c) further on.
    ours = run(rail(), {"k_v": 0.0, "p_v": 0.0, "coulomb": 0.5, "v_0": 0.3}, np.zeros(400))
    t = DT * np.arange(400)
    np.testing.assert_allclose(ours["v"], np.maximum(0.3 - 0.5 * t, 0.0), rtol=0, atol=1e-12)
    assert ours["x"][-1] == pytest.approx(0.3**2 / (2.0 * 0.5), abs=0.5 * DT**2)


def test_lift_is_one_at_hover_and_grows_with_the_square_of_the_moment() -> None:
    structure = rail(thrust=True)
    machine = Reference(structure.diagram, dt=DT, precision="float64", log=("lift.lift",)).machine()
    machine.set_many({"curve": 0.3})

    def lift(moment: float, thrust: float) -> float:
        return float(machine.step({"q": 0.0, "M": moment, "T": thrust})["lift.lift"])

    hover = 0.7 * 0.4 + 0.3 * 0.16
    assert lift(0.0, 0.4) == pytest.approx(1.0, rel=1e-12)
    assert lift(0.2, 0.4) == pytest.approx(1.0 + 0.3 * 0.04 / hover, rel=1e-12)
    # Beyond T the one pair stands still and the other gives all.
    assert lift(0.5, 0.4) == pytest.approx((0.7 * 0.9 + 0.3 * 0.81) / (2.0 * hover), rel=1e-12)


def test_structure_knows_its_unknowns() -> None:
    structure = pitch_rate()
    assert structure.inputs == ("M",)
    assert structure.outputs == ("theta", "q")
    assert structure.unknowns["w_n"].unit == "rad/s"
    assert structure.unknowns["theta_0"].local
    assert not structure.unknowns["mu"].local
    guessed = structure.with_guess(mu=100.0)
    assert guessed.unknowns["mu"].value == 100.0
    assert structure.unknowns["mu"].value == 358.5


def test_a_name_that_is_no_parameter_is_refused() -> None:
    diagram = pitch_rate().diagram
    with pytest.raises(IdentificationError, match="no parameter named 'muu'"):
        Structure(diagram, ("muu",))
    with pytest.raises(IdentificationError, match="there is nothing to estimate"):
        Structure(diagram, ())
    for scale in (0.0, -1.0, np.inf):
        with pytest.raises(IdentificationError, match="'mu' is not positive"):
            _ = Structure(diagram, ("mu",), scale={"mu": scale}).unknowns


def test_a_parameter_named_like_an_input_is_refused() -> None:
    with pytest.raises(DiagramError, match="is used twice"):
        Structure.of_block(TwiceNamed())


class TwiceNamed(Block):
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("u", 1.0),)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.u * u.u


def test_a_step_of_many_time_constants_is_held_exactly() -> None:
    """The fastest rotors that are allowed and data at 20 Hz: the step is 25 times the lag."""
    dt, u = 0.05, noise(100)
    ours = run(pitch_rate(lag=True), {"lag": 0.002, "dead_time": 0.0}, u, dt)
    a = np.array([[0.0, 1.0, 0.0], [-(3.437**2), -2.0 * 0.0836 * 3.437, 358.5], [0.0, 0.0, -500.0]])
    whole = expm(dt * np.block([[a, np.array([[0.0], [0.0], [500.0]])], [np.zeros((1, 4))]]))
    x, expected = np.array([0.0, 0.0, u[0]]), []
    for value in u:
        expected.append(x[1])
        x = whole[:3, :3] @ x + whole[:3, 3] * value
    # The pieces of the step are doubled six times, and rounding with them.
    np.testing.assert_allclose(ours["q"], expected, rtol=0, atol=1e-11 * np.abs(expected).max())
