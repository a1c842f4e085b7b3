"""Predicted motion of an excitation beside the flight's, and refusals of excitations that cannot be flown."""

from math import radians

import numpy as np
import pytest

from twodof.errors import ExperimentError
from twodof.excitation import Doublet, Excitation, Impulse, Steps
from twodof.experiment import Experiment, Laboratory
from twodof.experiment.experiments import script
from twodof.experiment.prediction import predict, predicted
from twodof.flight.gains import DEFAULT, Gains
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

DOUBLET = Doublet(radians(8.0), 0.8, unit="rad", lead=0.2, settle=1.0)


@pytest.mark.parametrize("rig", ["lab", "paper"])
@pytest.mark.parametrize("rings", [False, True])
def test_it_is_what_the_flight_does(rig: str, rings: bool) -> None:
    flown = Experiment("flown", "attitude", DOUBLET, rings=rings, hold=4.0, rest=0.0)
    laboratory = Laboratory(rig, failsafe=True)
    x = laboratory.start(flown)
    plan = script(flown, x)
    truth = laboratory.signals(flown, plan, x, seed=5)["true_theta"][plan.begin : plan.end]
    found = predict(DOUBLET, "theta", rig, x=x, rings=rings)
    n = min(len(truth), round(DOUBLET.duration / PERIOD))
    # The lab rig's gusts are another seed's: they have moved it by up to 1.6 deg in twelve flights.
    assert np.abs(found.theta[:n] - truth[:n]).max() < radians(2.0)
    assert found.pitch == pytest.approx(np.abs(truth).max(), rel=0.15)
    assert found.failsafe == ""


def test_a_small_step_of_the_place_reaches_its_end() -> None:
    found = predict(Steps((0.1,), 6.0, unit="m"), "x", "paper", x=-0.05)
    assert found.x[round(5.5 / PERIOD)] == pytest.approx(0.05, abs=0.01)
    assert found.rail < found.rail_stop


def test_what_the_failsafe_would_do_is_said_with_its_time() -> None:
    found = predict(Steps((radians(20.0),), 3.0, unit="rad"), "theta", "paper")
    assert "rail" in found.failsafe
    assert found.failsafe_at is not None
    # Twenty degrees pull the cart by g tan 20 deg at most: in half a second by 45 cm, were there no friction.
    assert 0.2 < found.failsafe_at < 2.0
    assert found.rail <= found.rail_stop + 1e-3


def test_the_free_response_of_the_pendulum_rings_at_its_own_frequency() -> None:
    found = predict(Impulse(0.1, 0.2, settle=8.0), "M", "paper", thrust=0.0, rings=True)
    late = found.theta[round(1.0 / PERIOD) :]
    crossings = np.flatnonzero(np.diff(np.sign(late - late.mean())) > 0)
    omega = 2 * np.pi * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * PERIOD)
    # The paper finds w_n = 3.43 rad/s (its equation 7); large swings of a pendulum and the spring shift it a little.
    assert omega == pytest.approx(3.43, rel=0.03)


def test_softer_gains_answer_slower() -> None:
    soft = Gains(tuple(0.5 * k for k in DEFAULT.rate), 0.3 * DEFAULT.attitude, DEFAULT.velocity, DEFAULT.position)  # type: ignore[arg-type]
    step = Steps((radians(5.0),), 1.5, unit="rad")
    stock, other = (predict(step, "theta", "paper", rings=True, gains=gains).theta for gains in (DEFAULT, soft))
    risen = [int(np.argmax(theta > radians(2.5))) for theta in (stock, other)]
    assert risen[1] > 1.5 * risen[0]


def test_an_identified_model_takes_the_place_of_the_rig() -> None:
    def rings_down_in(xi: float) -> float:
        document = {"estimates": {"w_n": {"value": 3.43}, "xi": {"value": xi}}}
        swing = Impulse(0.05, 0.2, settle=8.0).to_dict()
        found = predicted(swing, "M", "paper", 0.0, 0.0, True, DEFAULT, ("mine", document))
        assert "'mine'" in found["by"]
        theta = np.abs(found["theta"])
        return float(theta[len(theta) * 3 // 4 :].max() / theta.max())

    assert rings_down_in(0.02) > 2.0 * rings_down_in(0.08)


@pytest.mark.parametrize(
    ("excitation", "loop", "options", "what"),
    [
        (DOUBLET, "M", {}, "rad"),
        (DOUBLET, "yaw", {}, "unknown loop"),
        (DOUBLET, "theta", {"thrust": 0.0}, "a closed loop needs thrust"),
        (DOUBLET, "theta", {"x": 0.7}, "beyond"),
        (Doublet(0.1, 2.0, unit="m"), "x", {"rings": True}, "the rings lock it"),
    ],
)
def test_what_cannot_be_flown_is_refused(
    excitation: Excitation, loop: str, options: dict[str, float], what: str
) -> None:
    with pytest.raises(ExperimentError, match=what):
        predict(excitation, loop, **options)  # type: ignore[arg-type]
