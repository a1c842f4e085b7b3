"""What the rig's parameters say without a simulation, against the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from twodof.rig.parameters import Q_AGE, lab, paper
from twodof.rig.steady_state import (
    moment_gain,
    restoring_moment,
    rotor_moment,
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
