"""Steady-state figures from the rig's parameters, against simulation."""

import numpy as np
import pytest

from twodof.rig.parameters import Q_AGE, lab, paper
from twodof.rig.rig import (
    moment_gain,
    rail_force,
    restoring_moment,
    rotor_moment,
    stiffness,
    trim_moment,
    velocity_damping,
    velocity_gain,
)
from twodof.sim.closed_loop import ClosedLoop, InitialState


def test_trim_balances_rotors_and_spring() -> None:
    rig = lab()
    for moment, theta in ((0.01, 0.0), (-0.02, 0.1), (0.0, -0.3)):
        total = trim_moment(rig, moment, theta) + rotor_moment(rig, moment) - restoring_moment(rig, theta)
        assert total == pytest.approx(0.0, abs=1e-15)


def test_the_moment_gain_is_the_slope_of_the_rotors_moment() -> None:
    for rig in (paper(), lab()):
        slope = (rotor_moment(rig, 1e-6) - rotor_moment(rig, -1e-6)) / 2e-6
        assert moment_gain(rig, 0.4) * rig["inertia"] == pytest.approx(slope, rel=1e-9)


def test_the_paper_rig_pitches_and_slides_by_its_gains() -> None:
    loop = ClosedLoop(rig=paper(), conditions={"noise": 0.0, "rings": True, "ring_play": 0.0})
    loop.start(InitialState(hover=True))
    q = loop.fly(10, {"mode": "open-loop", "M_open": 0.01, "thrust": 0.4})["true_q"]
    # From the delay on q' = mu M - c q; c is 2 xi w_n = .575 1/s.
    t = 9 * 0.004 - (0.020 + Q_AGE)
    assert q[9] == pytest.approx(358.5 * 0.01 * (1.0 - np.exp(-0.575 * t)) / 0.575, rel=1e-3)  # the spring, 11.8 theta
    loop.configure({"rings": False})
    loop.start(InitialState(theta=0.2, hover=True))
    v = loop.fly(3, {"mode": "open-loop", "thrust": 0.4})["true_v"]
    assert v[2] == pytest.approx(-velocity_gain(paper()) * np.sin(0.2) * 0.008, rel=5e-3)  # drag: 1.168 * .008 / 2
    assert velocity_damping(paper()) == pytest.approx(1.168, rel=1e-12)


def test_the_rail_pushes_as_the_mean_pitch_says() -> None:
    """A hover at the pitch under which thrust, push and friction balance does not move the cart."""
    rig = lab()
    sticks = rig["rail_coulomb"] / (velocity_gain(rig) * (rig["mass_drone"] + rig["mass_cart"]))
    for tilt in (0.05, -0.03):
        push = rail_force(rig, tilt)
        weight = velocity_gain(rig) * (rig["mass_drone"] + rig["mass_cart"]) * np.sin(tilt)
        assert abs(weight - push) == pytest.approx(rig["rail_coulomb"], rel=1e-12)
        assert np.sign(push) == np.sign(tilt)
    # A constant acceleration, and a constant speed, under friction that is viscous alone: equation (4).
    smooth = {**rig.snapshot(), "rail_coulomb": 0.0}
    mass = rig["mass_drone"] + rig["mass_cart"]
    assert rail_force(smooth, 0.0, acceleration=0.3) == pytest.approx(0.3 * mass, rel=1e-12)
    assert rail_force(smooth, 0.0, speed=-0.2) == pytest.approx(-0.2 * rig["rail_viscous"], rel=1e-12)
    for tilt in (0.99 * sticks, -0.99 * sticks, 0.0):
        assert rail_force(rig, tilt) == 0.0


def test_the_stiffness_is_the_slope_of_the_restoring_moment() -> None:
    for rig in (paper(), lab()):
        for running in (0.0, 0.3, 1.0):
            slope = restoring_moment(rig, 1e-5, running) / 1e-5
            assert stiffness(rig, running) == pytest.approx(slope, rel=1e-6)
    assert stiffness(paper(), 0.0) == stiffness(paper(), 1.0)
    assert stiffness(lab(), 1.0) < stiffness(lab(), 0.0)
