"""Contact: what sticks stays to the bit, what slides stops where mechanics says, what bounces keeps the closed form."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import argrelmin

from tests.rig.plants import SMOOTH, dynamics, settings
from twodof.compile import CompiledMachine, CompiledProgram, build

DT = 1e-3
STICKY = {**SMOOTH, "coulomb_idle": 8e-4, "coulomb_run": 8e-4, "rail_coulomb": 0.03, "rail_force": 0.0}
MASS = SMOOTH["mass_drone"] + SMOOTH["mass_cart"]


@pytest.fixture(scope="module")
def program() -> CompiledProgram:
    return build(dynamics(), DT)


def machine(program: Any, **parameters: Any) -> CompiledMachine:
    m = program.machine()
    m.set_many(settings(parameters))
    m.reset()
    return m


def test_at_rest_within_friction_nothing_moves_to_the_bit(program: CompiledProgram) -> None:
    # Gravity and spring at .004 rad pull with 4.6e-4 N m, thrust along the rail with .0096 N.
    m = machine(program, **STICKY, theta_start=0.004, x_start=0.123)
    out = m.run(20_000, {"thrust": 2.4, "running": 0.5})
    for name, value in (("theta", 0.004), ("q", 0.0), ("x", 0.123), ("v", 0.0)):
        assert np.all(out[name] == value)


def test_it_lets_go_just_beyond_friction(program: CompiledProgram) -> None:
    for share, moves in ((0.999, False), (1.001, True)):
        m = machine(program, **{**STICKY, "offset": 0.0, "spring": 0.0})
        assert (m.run(100, {"moment": share * 8e-4})["q"][-1] != 0.0) is np.bool_(moves)
        m = machine(program, **{**STICKY, "offset": 0.0, "rail_force": share * 0.03})
        assert (m.run(100)["v"][-1] != 0.0) is np.bool_(moves)


def test_sliding_stops_where_the_closed_form_says_and_stays(program: CompiledProgram) -> None:
    v, friction = 0.3, STICKY["rail_coulomb"] / MASS
    m = machine(program, **{**STICKY, "offset": 0.0, "rail_viscous": 0.0}, v_start=v)
    out = m.run(round(v / friction / DT) + 500)
    stop_time, way = v / friction, v**2 / (2.0 * friction)
    first_rest = int(np.flatnonzero(out["v"] == 0.0)[0])
    assert first_rest * DT == pytest.approx(stop_time, abs=DT)
    assert np.all(out["v"][first_rest:] == 0.0)
    assert np.all(out["x"][first_rest:] == out["x"][first_rest])
    # The last step, in which it stops, is cut short by the clamp: half a step at the slope's speed.
    assert out["x"][-1] == pytest.approx(way, abs=friction * DT**2)


def test_pitch_under_coulomb_friction_loses_the_same_amplitude_each_half_swing(program: CompiledProgram) -> None:
    stiffness, inertia, friction = 0.02, 2.6e-3, 8e-4
    p = {**STICKY, "offset": 0.0, "spring": stiffness, "inertia": inertia, "viscous_run": 0.0, "viscous_idle": 0.0}
    out = machine(program, **p, theta_start=0.5).run(12_000)["theta"]
    peaks = np.abs(out[np.flatnonzero(np.diff(np.sign(np.diff(out))) != 0) + 1])
    # Classic: each half swing of a spring with dry friction is shorter by 2 F / k.
    assert np.diff(peaks)[:4] == pytest.approx(-2.0 * friction / stiffness, rel=0.01)
    assert out[-1] == out[-1000]
    assert abs(out[-1]) <= friction / stiffness


def bouncing(times: np.ndarray, speed: float, stop: float, restitution: float) -> np.ndarray:
    """Position of a free body that starts at 0 with `speed` between stops at +-`stop`."""
    position, direction, now, out = 0.0, 1.0, 0.0, []
    for t in times:
        while True:
            way = (stop - direction * position) / speed
            if now + way > t:
                break
            now, position, speed, direction = now + way, direction * stop, restitution * speed, -direction
        out.append(position + direction * speed * (t - now))
    return np.array(out)


def test_bounces_of_the_pitch_match_the_closed_form(program: CompiledProgram) -> None:
    p = {**SMOOTH, "offset": 0.0, "spring": 0.0, "viscous_run": 0.0, "viscous_idle": 0.0}
    m = machine(program, **{**p, "pitch_stop": 0.87, "pitch_bounce": 0.75}, q_start=3.0)
    out = m.run(3000)
    expected = bouncing(np.arange(3000) * DT, 3.0, 0.87, 0.75)
    assert np.unique(np.abs(out["q"]).round(12)).size >= 3
    inside = np.abs(out["theta"]) <= 0.87
    assert np.abs(out["theta"] - expected)[inside].max() < 1e-12
    speeds = 3.0 * 0.75 ** np.arange(8)
    assert np.all(np.isclose(np.abs(out["q"])[:, None], speeds, rtol=1e-14).any(axis=1))


def test_bounces_of_the_cart_match_the_closed_form(program: CompiledProgram) -> None:
    p = {**SMOOTH, "offset": 0.0, "rail_viscous": 0.0, "rail_force": 0.0, "rail_stop": 0.4, "rail_bounce": 0.3}
    out = machine(program, **p, v_start=1.3).run(2500)
    expected = bouncing(np.arange(2500) * DT, 1.3, 0.4, 0.3)
    assert np.abs(out["x"] - expected).max() < 1e-12


def test_under_gravity_each_bounce_keeps_the_square_of_the_restitution(program: CompiledProgram) -> None:
    """A constant moment presses towards the stop; the heights of rebound fall by e^2."""
    p = {**SMOOTH, "offset": 0.0, "spring": 0.0, "viscous_run": 0.0, "viscous_idle": 0.0, "pitch_stop": 0.87}
    m = machine(program, **{**p, "pitch_bounce": 0.75})
    theta = m.run(3200, {"moment": SMOOTH["inertia"] * 2.0})["theta"]
    rises = 0.87 - theta[argrelmin(theta, order=50)[0]]
    # The impact acts at the end of its step: the speed is wrong by 2 rad/s2 * 1 ms of 1.4 rad/s at most, twice that
    # in energy.
    assert rises[:2] / np.array([0.87, rises[0]]) == pytest.approx(0.75**2, rel=0.003)


def test_it_comes_to_rest_on_a_stop_and_leaves_it_again(program: CompiledProgram) -> None:
    p = {**SMOOTH, "offset": 0.0, "spring": 0.0, "pitch_stop": 0.87, "pitch_bounce": 0.75}
    m = machine(program, **p, theta_start=0.86)
    pressed = m.run(8000, {"moment": 5e-3})
    assert pressed["theta"][-1] == 0.87
    assert pressed["q"][-1] == 0.0
    assert np.all(pressed["theta"][-1000:] == 0.87)
    assert m.run(200, {"moment": -5e-3})["theta"][-1] < 0.85


def test_rings_leave_the_cart_their_play_and_no_more(program: CompiledProgram) -> None:
    p = {**SMOOTH, "rings": True, "ring_place": 0.05, "ring_play": 5e-4, "x_start": 0.05, "rail_force": 0.0}
    out = machine(program, **p, theta_start=0.5).run(6000, {"thrust": 2.5, "running": 1.0})
    assert out["x"].min() >= 0.05 - 5e-4 - 1e-6  # a stop is met within a step of at most 1 ms at 1 mm/s
    assert out["x"].max() <= 0.05 + 5e-4 + 1e-6
    assert np.ptp(out["x"]) > 5e-4
    held = machine(program, **{**p, "ring_play": 0.0}, theta_start=0.5).run(6000, {"thrust": 2.5, "running": 1.0})
    assert np.all(held["x"] == 0.05)


@pytest.mark.parametrize("dry", [0.0, 1.0])
def test_the_rail_s_end_swings_a_drone_that_rests(program: CompiledProgram, dry: float) -> None:
    """The impulse of a stop keeps the momentum of the other coordinate, whether that one is stuck or only still."""
    rough = {name: dry * STICKY[name] for name in ("coulomb_idle", "coulomb_run", "rail_coulomb")}
    m = machine(program, **{**STICKY, **rough, "rail_viscous": 0.0, "rail_stop": 0.4}, x_start=0.3998, v_start=0.5)
    out = m.run(2)
    assert out["q"][0] == 0.0
    change = out["v"][1] - out["v"][0]
    assert change < -0.6
    # Friction, which changes v too but not q, takes 6e-5 m/s in the tick.
    lever = SMOOTH["mass_drone"] * SMOOTH["offset"]
    assert out["q"][1] == pytest.approx(-lever * change / SMOOTH["inertia"], rel=1e-3)


def test_the_pitch_stop_pushes_a_cart_that_sticks(program: CompiledProgram) -> None:
    small = {**STICKY, "offset": 0.004, "spring": 0.0, "pitch_stop": 0.8}
    out = machine(program, **small, theta_start=0.799, q_start=3.0).run(2)
    assert out["v"][0] == 0.0
    # The speed before the impact is 3 rad/s less what gravity takes of it within the tick, .4 %.
    change = -(1.0 + 0.75) * 3.0
    lever = SMOOTH["mass_drone"] * small["offset"]
    assert out["v"][1] == pytest.approx(-lever * np.cos(0.8) * change / MASS, rel=0.01)


def test_what_is_stuck_twice_stays_to_the_bit(program: CompiledProgram) -> None:
    """Pitch and cart both within their friction: neither may be loosened by an acceleration that the other lacks."""
    for turn in (-0.99, 0.99):
        for push in (-0.999, 0.999):
            m = machine(program, **{**STICKY, "rail_force": push * 0.03})
            out = m.run(2000, {"moment": turn * 8e-4})
            for name in ("theta", "q", "x", "v"):
                assert np.all(out[name] == 0.0)
