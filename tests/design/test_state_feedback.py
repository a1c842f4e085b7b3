"""LQI and LQG: the poles that were designed for, the sister that exists, and a step."""

import math

import numpy as np
import pytest

from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import PitchLoop
from twodof.design.promise import promise
from twodof.design.sampled_controller import SampledController
from twodof.design.state_feedback import lqg_attitude, lqi
from twodof.errors import ParameterError
from twodof.flight.templates import check_template
from twodof.models.lqr import lqr
from twodof.models.plant import PAPER_PITCH_RATE
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

VALUES = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "dead_time": 0.0113, "lag": 0.0087}
FAMILY = PitchFamily.of(VALUES, {"mu": 8.0, "dead_time": 0.0007}, gust=1.0, q_noise=0.02)
PAPER = PitchFamily.of({"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.02})


@pytest.mark.parametrize("family", [FAMILY, PAPER])
def test_loop_has_the_poles_of_its_feedback(family: PitchFamily) -> None:
    """Feedback and observer do not move each other's poles (separation), over the dead time and the diagram."""
    diagram = lqg_attitude(family)
    check_template(diagram, "attitude_control")
    found = np.linalg.eigvals(PitchLoop(family.nominal(), SampledController.of(diagram)).matrices[0][0])
    for pole in lqi(family).poles:
        if pole.real > -100.0:  # those of the dead time at 0 are not simple, and roundings move them most
            assert np.abs(found - np.exp(pole * PERIOD)).min() < 1e-5


def test_lqi_is_the_lqr_of_the_augmented_plant() -> None:
    """Designed without the dead time and predicted over it, against one Riccati equation with all states."""
    largest = (math.radians(5.0), 2.0)
    ours = lqi(PAPER, *largest, 0.3, 0.1)
    other = lqr(PAPER_PITCH_RATE.state_space(), 0, largest, 0.3, 0.1)
    # The integral there has its own step's sample, here the one before: .4 % of the slow pole's time, and the gain
    # on theta takes up T times the integral's.
    assert ours.state[:2] == pytest.approx(other.state, rel=0.02)
    assert ours.integral == pytest.approx(other.integral, rel=0.02)
    # A lag of 10 us stands for none in PitchLoop, so the moments under way may differ by that part.
    assert ours.state[4:9] == pytest.approx(other.history, rel=0.02)


def test_lqg_keeps_its_family_stable_and_follows() -> None:
    controller = SampledController.of(lqg_attitude(FAMILY))
    made = promise(controller, FAMILY, members=100)
    assert made.robust
    rise, overshoot = made.figures["rise_time"], made.figures["overshoot"]
    assert rise[2] < 0.25
    assert overshoot[2] < 0.05
    # A constant load is found by the gust's state and the integral: the error goes.
    assert abs(made.figures["settled_error"][1]) < 0.03


@pytest.mark.parametrize("call", [lambda: lqi(FAMILY, largest_q=0.0), lambda: lqi(FAMILY, largest_moment=math.nan)])
def test_refuses_with_a_remedy(call: object) -> None:
    with pytest.raises(ParameterError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.remedy
