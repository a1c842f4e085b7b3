"""The dynamics against scipy's DOP853 and MuJoCo, the order of the integrator, and the balances of mechanics."""

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.rig.plants import SMOOTH, dynamics, energy, momentum, mujoco_model, settings, slopes
from twodof.compile import CompiledProgram, build

START = {"theta_start": 0.6, "q_start": -1.5, "x_start": 0.1, "v_start": 0.4}


@pytest.fixture(scope="module")
def program() -> CompiledProgram:
    return build(dynamics(), 1e-3)


def run(program: Any, steps: int, inputs: dict[str, Any], **parameters: Any) -> NDArray[np.float64]:
    """(steps + 1, 4) states from the start on."""
    machine = program.machine()
    machine.set_many(settings(parameters))
    machine.reset()
    out = machine.run(steps + 1, inputs)
    return np.stack([out[n] for n in ("theta", "q", "x", "v")], axis=1)


def exact(
    seconds: float, thrust: float, moment: float, at: NDArray[np.float64], running: float, **p: float
) -> NDArray[np.float64]:
    values = {**SMOOTH, **p}
    start = np.array(list(START.values()))
    found = solve_ivp(
        lambda _, s: slopes(s, values, thrust, moment, running),
        (0.0, seconds),
        start,
        method="DOP853",
        t_eval=at,
        rtol=1e-12,
        atol=1e-13,
    )
    return np.asarray(found.y.T)


@pytest.mark.parametrize(
    ("hardening", "softening", "running"), [(0.0, 0.0, 1.0), (0.01, 0.003, 0.0), (0.01, 0.003, 0.4)]
)
def test_it_agrees_with_scipy(program: CompiledProgram, hardening: float, softening: float, running: float) -> None:
    seconds, thrust, moment = 3.0, 2.5, 0.004
    ours = run(
        program,
        3000,
        {"thrust": thrust, "moment": moment, "gust": 0.0, "running": running},
        **{**SMOOTH, **START, "hardening": hardening, "softening": softening},
    )
    at = np.linspace(0.0, seconds, 3001)
    theirs = exact(seconds, thrust, moment, at, running, hardening=hardening, softening=softening)
    assert np.ptp(theirs[:, 0]) > 0.5  # it does swing
    assert np.abs(ours - theirs).max() < 1e-6


def test_it_agrees_with_mujoco(program: CompiledProgram) -> None:
    thrust, moment = 2.5, 0.004
    model = mujoco.MjModel.from_xml_string(mujoco_model(SMOOTH))
    data = mujoco.MjData(model)
    data.qpos[:] = START["x_start"], START["theta_start"]
    data.qvel[:] = START["v_start"], START["q_start"]
    data.ctrl[0] = thrust
    data.qfrc_applied[:] = SMOOTH["rail_force"], moment
    theirs = []
    for _ in range(3001):
        theirs.append([data.qpos[1], data.qvel[1], data.qpos[0], data.qvel[0]])
        mujoco.mj_step(model, data)
    ours = run(program, 3000, {"thrust": thrust, "moment": moment, "gust": 0.0, "running": 1.0}, **{**SMOOTH, **START})
    assert np.abs(ours - np.array(theirs)).max() < 1e-6


FREE = {**SMOOTH, **START, "viscous_run": 0.0, "viscous_idle": 0.0, "rail_viscous": 0.0, "rail_force": 0.0}


def test_energy_and_momentum_stay_without_friction_and_thrust(program: CompiledProgram) -> None:
    states = run(program, 20_000, {}, **{**FREE, "rail_stop": 9.9, "hardening": 0.02})
    p = {**FREE, "hardening": 0.02}
    # RK4 loses energy in proportion to h^5 a step: some 1e-11 of it in 20 s at 1 ms.
    assert np.ptp(energy(states, p)) < 1e-9 * energy(states, p)[0]
    assert np.ptp(momentum(states, p)) < 1e-9 * abs(momentum(states, p)[0])


def test_friction_takes_the_energy_that_its_power_says(program: CompiledProgram) -> None:
    p = {**SMOOTH, **START, "rail_force": 0.0}
    states = run(program, 4000, {"running": 1.0}, **p)
    power = p["viscous_run"] * states[:, 1] ** 2 + p["rail_viscous"] * states[:, 3] ** 2
    lost = np.trapezoid(power, dx=1e-3)
    spent = energy(states, p)[0] - energy(states, p)[-1]
    assert lost > 0.5 * energy(states, p)[0]
    assert spent == pytest.approx(lost, rel=1e-5)  # the trapezoidal rule's error at 1 ms


def test_a_bounce_of_the_pitch_keeps_the_momentum_along_the_rail(program: CompiledProgram) -> None:
    p = {**FREE, "pitch_stop": 0.7, "q_start": 3.0}
    states = run(program, 400, {}, **p)
    assert (np.diff(np.sign(states[:, 1])) != 0).any()
    assert np.abs(states[:, 0]).max() < 0.7 + 3e-3  # one step's way at most
    # The impact is placed at the end of its step: momentum is wrong by cos(theta)'s change over it at most.
    assert np.ptp(momentum(states, p)) < 1e-3 * np.abs(momentum(states, p)).max()


def test_thrust_along_the_body_accelerates_towards_minus_x_when_nose_up(program: CompiledProgram) -> None:
    p = {**SMOOTH, "offset": 0.0, "spring": 0.0, "viscous_run": 0.0, "rail_viscous": 0.0, "rail_force": 0.0}
    states = run(program, 100, {"thrust": 2.5, "running": 1.0}, **p, theta_start=0.2)
    mass = SMOOTH["mass_drone"] + SMOOTH["mass_cart"]
    assert states[-1, 3] == pytest.approx(-2.5 * np.sin(0.2) / mass * 0.1, rel=1e-12)
