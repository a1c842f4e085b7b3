"""The LQR: Bellman's equation by brute force, python-control's own gains, and a delay that it predicts over."""

from collections.abc import Sequence
from dataclasses import replace

import control
import numpy as np
import pytest

from twodof.errors import ParameterError
from twodof.models.lqr import LqrGains, attitude_lqr, lqr, rate_lqr
from twodof.models.lti import DelayedStateSpace
from twodof.models.plant import PAPER_PITCH_RATE
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow


def test_a_plant_without_delay_gets_the_gains_of_python_control() -> None:
    plant = DelayedStateSpace.of([[0.0, 1.0], [-9.0, -0.5]], [0.0, 300.0], np.eye(2), np.zeros((2, 1)))
    gains = lqr(plant, 0, (0.1, 2.0), 0.3, 0.2)
    held = plant.zero_order_hold(PERIOD)
    a = np.block([[held.phi, np.zeros((2, 1))], [PERIOD * held.phi[:1], np.ones((1, 1))]])
    b = np.vstack([held.new, PERIOD * held.new[:1]])
    theirs, _, _ = control.dlqr(a, b, np.diag([1 / 0.1**2, 1 / 2.0**2, 1 / 0.3**2]), [[1 / 0.2**2]])
    # Both solve the same Riccati equation, python-control by another library or by scipy.
    np.testing.assert_allclose([*gains.state, gains.integral], theirs[0], rtol=1e-9)
    assert gains.history == ()


def cost(plant: DelayedStateSpace, largest: Sequence[float], gains: LqrGains) -> float:
    """The sum that an LQR minimises, flown from errors of `largest` until all is at rest; the last two: sum, moment."""
    held = plant.zero_order_hold(PERIOD)
    *states, most_integral, most_moment = largest
    x, past, total, spent = np.array(states) * [1.0, -0.5][: len(states)], [0.0] * len(gains.history), 0.0, 0.0
    for _ in range(5000):
        total += PERIOD * x[0]
        moment = -float(np.dot(gains.state, x)) - gains.integral * total - float(np.dot(gains.history, past))
        spent += sum((x / states) ** 2) + (total / most_integral) ** 2 + (moment / most_moment) ** 2
        x = held.phi @ x + held.new[:, 0] * past[-1]
        past = [moment, *past[:-1]]
    return spent


RIGID = DelayedStateSpace.of([[0.0]], [PAPER_PITCH_RATE.mu], [[1.0]], [[0.0]], PAPER_PITCH_RATE.tau)


@pytest.mark.long
@pytest.mark.parametrize(
    ("best", "plant", "largest"),
    [
        (attitude_lqr(), PAPER_PITCH_RATE.state_space(), (np.radians(5.0), 2.0, 0.3, 0.1)),
        (rate_lqr(), RIGID, (1.0, 0.2, 0.06)),
    ],
    ids=["attitude", "rate"],
)
def test_no_neighbour_of_the_gains_costs_less(
    best: LqrGains, plant: DelayedStateSpace, largest: tuple[float, ...]
) -> None:
    assert len(best.history) == 5  # 20 ms, five steps
    least = cost(plant, largest, best)
    for share in (0.99, 1.01):
        for i, gain in enumerate(best.state):
            state = (*best.state[:i], share * gain, *best.state[i + 1 :])
            assert cost(plant, largest, replace(best, state=state)) > least
        assert cost(plant, largest, replace(best, integral=share * best.integral)) > least
        assert cost(plant, largest, replace(best, history=tuple(share * k for k in best.history))) > least


def test_what_cannot_be_stabilised_is_refused() -> None:
    # The integral of the rate of a plant with a spring is its angle: no moment holds it elsewhere.
    with pytest.raises(ParameterError, match="no state feedback"):
        lqr(PAPER_PITCH_RATE.state_space(), 1, (np.inf, 1.0), 0.2, 0.03)
