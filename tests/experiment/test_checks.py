"""The checks of a flight's data, on flights of which it is known what happened."""

import numpy as np
import pytest

from twodof.experiment.experiments import experiment, script
from twodof.experiment.flight import STOP_MARGIN, Laboratory


@pytest.mark.parametrize("seed", [43, 148])
def test_a_stop_that_is_struck_between_two_samples_is_seen(seed: int) -> None:
    # The gusts of these seeds swing the drone to its stop at 1.2 and 4.3 rad/s: no sample is nearer than .002 rad.
    laboratory, flown = Laboratory("lab"), experiment("doublet")
    plan = script(flown)
    theta = laboratory.signals(flown, plan, 0.0, seed)["true_theta"][plan.begin : plan.end]
    stop = laboratory.parameters["pitch_stop"]
    assert stop - 0.01 < np.abs(theta).max() < stop - STOP_MARGIN
    (pitch,) = (check for check in laboratory.fly(flown, seed).checks if check.name == "pitch free")
    assert not pitch.passed
