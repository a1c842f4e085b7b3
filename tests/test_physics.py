"""docs/explanation/physics.md against the code: its tables, its laws derived again, the road to the paper's models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigvals

from tests.rig.plants import dynamics, settings
from tools.tables import PAGES, models, render
from twodof.compile import CompiledProgram, build
from twodof.models import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, DelayedStateSpace
from twodof.rig.parameters import Q_AGE, lab, paper
from twodof.rig.rig import rig, trim_moment

G = 9.81
TICK = 1e-3


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_are_those_of_the_code(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "<!-- made: " in text
    assert text == render(text), "run `python tools/tables.py`"


@pytest.fixture(scope="module")
def mechanics() -> CompiledProgram:
    return build(dynamics(), 1e-6)


def newton_euler(
    state: NDArray[np.float64], p: Mapping[str, float], thrust: float, moment: float, running: float
) -> NDArray[np.float64]:
    """(q', v') from Newton's and Euler's laws of each body, the force in the bearing being two more unknowns.

    Unknowns: q', v', and the force (B_x, B_z) of the cart on the drone; z down. Nothing of Lagrange's is used.
    """
    theta, q, _, v = state
    s, c = math.sin(theta), math.cos(theta)
    d, own = p["offset"], p["inertia"] - p["mass_drone"] * p["offset"] ** 2
    md, mc = p["mass_drone"], p["mass_cart"]
    linear, cubic = p["spring"] - running * p["softening"], (1.0 - running) * p["hardening"]
    spring = linear * theta + cubic * theta**3 + p["viscous_idle"] * q
    # The centre of mass is accelerated by (v' + d (c q' - s q^2), -d (s q' + c q^2)).
    rows = [
        [md * d * c, md, -1.0, 0.0],  # drone along x
        [-md * d * s, 0.0, 0.0, -1.0],  # drone downwards
        [own, 0.0, d * c, -d * s],  # drone about its centre of mass: the bearing's force has the arms (d s, d c)
        [0.0, mc, 1.0, 0.0],  # cart along x
    ]
    right = [
        md * d * s * q**2 - thrust * s,
        md * d * c * q**2 - thrust * c + md * G,
        # The thrust passes through the bearing along the body's axis, hence through the centre of mass too.
        moment - spring,
        p["rail_force"] - p["rail_viscous"] * v,
    ]
    return np.asarray(np.linalg.solve(np.array(rows), np.array(right))[:2])


angles = st.floats(-1.2, 1.2)


@given(
    angles, st.floats(-4.0, 4.0), st.floats(-1.0, 1.0), st.floats(0.0, 6.0), st.floats(-0.3, 0.3), st.floats(0.0, 1.0)
)
def test_the_accelerations_are_those_of_newton_and_euler(
    mechanics: CompiledProgram, theta: float, q: float, v: float, thrust: float, moment: float, running: float
) -> None:
    p = {
        "mass_drone": 0.374,
        "mass_cart": 0.16,
        "inertia": 2.6e-3,
        "offset": 0.04,
        "spring": 0.01,
        "softening": 0.006,
        "hardening": 0.02,
        "viscous_idle": 4e-4,
        "viscous_run": 4e-4,
        "rail_viscous": 0.3,
        "rail_force": 0.1,
        "pitch_stop": 1.5,
        "rail_stop": 10.0,
    }
    machine = mechanics.machine()
    machine.set_many(settings({**p, "theta_start": theta, "q_start": q, "v_start": v}))
    machine.reset()
    out = machine.run(3, {"thrust": thrust, "moment": moment, "running": running})
    # A central difference over 2 us: its own error is some 1e-9, that of rounding 1e-16 / 1e-6 of what is differenced.
    found = [(out[name][2] - out[name][0]) / 2e-6 for name in ("q", "v")]
    state = np.array([out[name][1] for name in ("theta", "q", "x", "v")])
    assert found == pytest.approx(newton_euler(state, p, thrust, moment, running), rel=1e-7, abs=1e-7)


@pytest.fixture(scope="module")
def whole() -> CompiledProgram:
    return build(rig(), TICK)


def fly(
    program: CompiledProgram, steps: int, fore: Any, aft: Any, values: Mapping[str, float], **conditions: Any
) -> dict[str, NDArray[Any]]:
    machine = program.machine()
    machine.set_many({**values, "noise": 0.0, **conditions})
    machine.reset()
    return dict(machine.run(steps, {"fore": fore, "aft": aft}))


def test_the_accelerometer_is_the_second_derivative_of_its_place(whole: CompiledProgram) -> None:
    below, ahead = 0.08, 0.07
    values = {**lab().snapshot(), "imu_below": below, "imu_ahead": ahead, "acc_scale": 1.0}
    t = np.arange(800) * TICK
    moment = 0.02 * np.sin(9.0 * t)
    out = fly(whole, 800, 0.4 + moment, 0.4 - moment, values)
    theta, x = out["theta"], out["x"]
    sine, cosine = np.sin(theta), np.cos(theta)
    place = np.stack([x + below * sine + ahead * cosine, below * cosine - ahead * sine])  # downwards positive
    k = np.arange(404, 796, 4)
    # The mean over the 4 ms before sample k is the second difference about k - 2.
    middle = k - 2
    force = (place[:, middle + 2] - 2.0 * place[:, middle] + place[:, middle - 2]) / (2.0 * TICK) ** 2
    force = force - np.array([[0.0], [G]])
    s, c = np.sin(theta[k]), np.cos(theta[k])
    expected = np.stack([c * force[0] - s * force[1], s * force[0] + c * force[1]])
    measured = np.stack([out["acc_x"][k], out["acc_z"][k]])
    # The rig takes the attitude and q^2 of the sample for the whole interval, of which the middle is 2 ms older: in
    # that time the attitude turns by 2 ms q and q^2 changes by 2 ms 2 q q'.
    q, q_rate = np.abs(out["q"]).max(), np.abs(np.gradient(out["q"], TICK)).max()
    coarse = 2.0 * TICK * max(below, ahead) * (q**3 + 3.0 * q * q_rate)
    assert min(below, ahead) * q_rate > 20.0 * coarse  # a wrong sign of a term would show
    assert np.abs(measured - expected).max() < coarse


def test_the_paper_rig_is_the_papers_pitch_rate(whole: CompiledProgram) -> None:
    steps = 3000
    moment = np.where((np.arange(steps) % 600) < 300, 0.03, -0.03)
    # By the log's stamps q is older than M, and the rig's delay holds that age; here nothing has a stamp.
    assert paper()["delay"] - Q_AGE == pytest.approx(PAPER_PITCH_RATE.tau, abs=1e-15)
    values = {**paper().snapshot(), "delay": PAPER_PITCH_RATE.tau}
    # The rotors stand at the start: the moment waits until the thrust is there.
    moment[:200] = 0.0
    out = fly(whole, steps, 0.4 + moment, 0.4 - moment, values, rings=True)
    plant = PAPER_PITCH_RATE
    exact = DelayedStateSpace.of(
        [[0.0, 1.0], [-(plant.w_n**2), -2.0 * plant.xi * plant.w_n]],
        [0.0, plant.mu],
        [[1.0, 0.0], [0.0, 1.0]],
        [[0.0], [0.0]],
        plant.tau,
    )
    expected = exact.zero_order_hold(TICK).simulate(moment)
    # Battery 1e9 A h: the supply falls by some 1e-12; what remains is RK4's error and rounding.
    assert np.abs(expected[:, 1]).max() > 2.0
    assert np.abs(out["q"] - expected[:, 1]).max() < 1e-8
    assert np.abs(out["theta"] - expected[:, 0]).max() < 1e-8


def test_the_paper_rig_at_a_constant_pitch_is_the_papers_velocity(whole: CompiledProgram) -> None:
    theta = 0.02
    # No spring: nothing turns the drone back. From the moment on at which the thrust is there (20 ms).
    out = fly(whole, 350, 0.4, 0.4, {**paper().snapshot(), "spring": 0.0, "rail_stop": 9.0}, theta_start=theta)
    plant, start = PAPER_VELOCITY_GREYBOX, round(paper()["delay"] / TICK)
    t = TICK * np.arange(350 - start - 1)
    expected = -plant.k_v * math.sin(theta) / plant.p_v * -np.expm1(-plant.p_v * t)
    first = int(np.flatnonzero(out["v"])[0]) - 1
    assert first == pytest.approx(start, abs=1)
    assert out["v"][first : first + t.size - 1] == pytest.approx(expected[: t.size - 1], abs=k_v_rest(plant.k_v, theta))


def k_v_rest(k_v: float, theta: float) -> float:
    """A delay of part of a tick leaves an error of part of one tick of acceleration."""
    return k_v * theta * TICK


DRY = ("coulomb_idle", "coulomb_run", "rail_coulomb", "ring_play", "resistance", "trim_start")


def test_small_motions_of_the_lab_rig_are_those_of_its_linear_model(whole: CompiledProgram) -> None:
    values = {**lab().snapshot(), **dict.fromkeys(DRY, 0.0), "capacity": 1e9}
    steps, amplitude = 3000, 1e-4
    moment = np.where((np.arange(steps) % 800) < 400, amplitude, -amplitude)
    moment[:600] = 0.0
    trim = trim_moment(values, 0.0)
    out = fly(whole, steps, 0.4 + moment, 0.4 - moment, values, rings=True, trim=trim, wake_start=1.0)
    found = {name: value for name, (value, _, _) in models(values).items()}
    w_n, xi = found["w_n, rotors running"], found["xi, rotors running"]
    mu, lag = found["mu at T = 0.4"], values["lag"]
    linear = DelayedStateSpace.of(
        [[0.0, 1.0, 0.0], [-(w_n**2), -2.0 * xi * w_n, mu], [0.0, 0.0, -1.0 / lag]],
        [0.0, 0.0, 1.0 / lag],
        [[0.0, 1.0, 0.0]],
        [[0.0]],
        values["delay"],
    )
    expected = linear.zero_order_hold(TICK).simulate(moment)[:, 0]
    # The rotors have come up to exp(-.6 s / lag) = 1e-21, and the amplitude's square is 1e-8. What remains is the
    # delay's fraction of a tick, of which the rig takes the mean: part of a tick in 400 at each edge.
    assert np.abs(expected).max() > 20.0 * amplitude
    assert np.abs(out["q"] - expected).max() < 1e-3 * np.abs(expected).max()


def test_with_the_cart_free_the_pendulum_is_softer(whole: CompiledProgram) -> None:
    p = {**lab().snapshot(), **dict.fromkeys(DRY, 0.0), "viscous_run": 0.0, "viscous_idle": 0.0, "rail_viscous": 0.0}
    mass, lever = p["mass_drone"] + p["mass_cart"], p["mass_drone"] * p["offset"]
    thrust = models(p)["k_v at T = 0.4"][0] * mass
    spring = p["spring"] - p["softening"]
    # (37) against the eigenvalues of (2) and (4), linearised: states theta, q, v.
    matrix = np.array([[p["inertia"], lever], [lever, mass]])
    stiff = np.linalg.solve(matrix, np.array([spring + lever * G, thrust]))
    full = eigvals(np.array([[0.0, 1.0, 0.0], [-stiff[0], 0.0, 0.0], [-stiff[1], 0.0, 0.0]]))
    stiffness = spring + lever * (G - thrust / mass)
    expected = math.sqrt(stiffness / (p["inertia"] - lever**2 / mass))
    assert np.abs(full.imag).max() == pytest.approx(expected, rel=1e-12)
    # And as the rig swings: from a pitch so small that sin(theta) is theta, over its first crossings.
    out = fly(whole, 12_000, 0.4, 0.4, {**p, "capacity": 1e9, "rail_stop": 9.0}, theta_start=1e-3, wake_start=1.0)
    theta = out["theta"][1000:]
    cross = np.flatnonzero(np.diff(np.sign(theta)) != 0)
    crossing = cross + theta[cross] / (theta[cross] - theta[cross + 1])
    period = 2.0 * TICK * float(np.mean(np.diff(crossing)))
    assert 2.0 * math.pi / period == pytest.approx(expected, rel=1e-4)
