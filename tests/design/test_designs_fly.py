"""Designs on the virtual rig: state feedback with its promise, and anti-windup."""

import math

import numpy as np
import pytest

from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import promise
from twodof.design.sampled_controller import SampledController
from twodof.design.state_feedback import lqg_attitude
from twodof.excitation import Steps
from twodof.experiment.experiments import experiment
from twodof.experiment.flight import Laboratory
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.starters.attitude import pid_attitude
from twodof.models.plant import PAPER_PITCH_RATE
from twodof.sim.resimulation import identified_rig

pytestmark = pytest.mark.slow

FAMILY = PitchFamily(
    {
        "w_n": PAPER_PITCH_RATE.w_n,
        "xi": PAPER_PITCH_RATE.xi,
        "mu": PAPER_PITCH_RATE.mu,
        "dead_time": PAPER_PITCH_RATE.tau,
        "lag": 0.0,
    },
    ("mu",),
    np.array([[16.0]]),
    q_noise=0.06,
    q_band=(38.0, 0.6),
)
LIGHT = identified_rig({"mu": 250.0, "tau": 0.02}, "paper")
"""A drone that turns less by the same moment, so that a step holds the motors at their limits for longer."""


@pytest.mark.long
def test_state_feedback_keeps_its_promise() -> None:
    diagram = lqg_attitude(FAMILY)
    promised = promise(SampledController.of(diagram), FAMILY, members=400, name="lqg")
    assert promised.robust
    flight = Laboratory("paper", controllers=[diagram]).fly(experiment("attitude-steps"), seed=4)
    assert flight.good, flight.reason
    assert promised.verdict_of(flight.log).stands


def test_anti_windup_flies() -> None:
    """45 degrees at once on the rig: wound up the drone goes 3 degrees beyond, with anti-windup a tenth of one."""
    quick = Gains((0.12, 0.5, 0.001), 12.0, DEFAULT.velocity, DEFAULT.position)
    level = math.radians(45.0)
    steps = Steps(unit="rad", lead=0.5, levels=(level, 0.0), hold=2.0)
    highest = []
    # without tracking the integral winds up as ever
    for tuning in ({}, {"attitude_control.tracking": 0.0}):
        lab = Laboratory(
            "paper", noise=0.0, conditions=LIGHT, controllers=[pid_attitude(quick, "back-calculation")], tuning=tuning
        )
        highest.append(float(lab.fly(experiment("attitude-steps", excitation=steps)).log["theta_true"].value.max()))
    assert highest[0] < 1.005 * level
    assert highest[1] > 1.05 * level
