"""Designs on the virtual rig: placed poles with their promise, and the schedule that keeps it at another thrust."""

import functools
import math

import numpy as np
import pytest

from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import Promise, promise
from twodof.design.sampled_controller import SampledController
from twodof.design.schedule import gain_ratio, scheduled_motor
from twodof.design.state_feedback import placed_attitude
from twodof.excitation import Steps
from twodof.experiment.experiments import experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.starters.attitude import pid_attitude
from twodof.models.plant import PAPER_PITCH_RATE
from twodof.rig.parameters import paper
from twodof.sim.resimulation import identified_rig

pytestmark = pytest.mark.slow

HIGH = 0.6
"""A thrust at which the rig's moment is 1.16 times that of hover."""

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

PLACED = placed_attitude(FAMILY, (-5.0, -12.0 + 6.0j, -12.0 - 6.0j))


@functools.cache
def promised() -> Promise:
    return promise(SampledController.of(PLACED), FAMILY, members=400, name="placed")


def flown(thrust: float, noise: float, **tuned: float) -> Flight:
    """Fly steps of 10 deg with the placed poles and the schedule, parameters set by `tuned`."""
    diagrams = [PLACED, scheduled_motor(float(paper()["curve"]))]
    tuning = {f"motor_control.{name}": value for name, value in tuned.items()}
    return Laboratory("paper", noise=noise, controllers=diagrams, tuning=tuning).fly(
        experiment("attitude-steps", thrust=thrust), seed=4
    )


def step(flight: Flight, name: str) -> np.ndarray:
    """The mean of its four steps, turned up."""
    return np.asarray(np.mean([one[name] for _, one in promised().steps_of(flight.log)], axis=0))


@pytest.mark.long
def test_placed_poles_keep_their_promise() -> None:
    assert promised().robust
    flight = flown(0.4, noise=1.0)
    assert flight.good, flight.reason
    assert promised().verdict_of(flight.log).stands


@pytest.mark.long
def test_schedule_keeps_the_response_at_another_thrust() -> None:
    """At half as much thrust again mu is 1.16 times as large: the pitch stays where it was, M is less by that."""
    ratio = gain_ratio(HIGH, float(paper()["curve"]))
    assert ratio > 1.15
    low, high = flown(0.4, 0.0), flown(HIGH, 0.0)
    # without noise: what differs is the rig's arithmetic at another thrust
    assert step(high, "theta") == pytest.approx(step(low, "theta"), abs=1e-5)
    # a log tells the M that the motors make, which is the scheduled one
    assert np.abs(step(low, "M")).max() / np.abs(step(high, "M")).max() == pytest.approx(ratio, rel=1e-3)
    # that the test can fail: with the schedule put out of action the pitch is another one
    plain = flown(HIGH, 0.0, slope=0.0, at_rest=1.0)
    assert np.abs(step(plain, "theta") - step(low, "theta")).max() > 0.03 * promised().goal


def test_anti_windup_flies() -> None:
    """45 degrees at once on the rig: wound up the drone goes 3 degrees beyond, with anti-windup a tenth of one."""
    quick = Gains((0.12, 0.5, 0.001), 12.0, DEFAULT.velocity, DEFAULT.position)
    level = math.radians(45.0)
    steps = Steps(unit="rad", lead=0.5, levels=(level, 0.0), hold=2.0)
    highest = []
    # without tracking the integral winds up as ever
    for tuning in ({}, {"attitude_control.tracking": 0.0}):
        lab = Laboratory(
            "paper",
            noise=0.0,
            conditions=LIGHT,
            controllers=[pid_attitude(quick, "back-calculation")],
            tuning=tuning,
        )
        highest.append(float(lab.fly(experiment("attitude-steps", excitation=steps)).log["theta_true"].value.max()))
    assert highest[0] < 1.005 * level
    assert highest[1] > 1.05 * level
