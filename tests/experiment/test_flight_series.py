"""Series of flights: they come as simulated, an error comes too, and no drone is left behind."""

import os

import numpy as np
import pytest

from tests.processes import children
from twodof.errors import TwodofError
from twodof.experiment.flight import Laboratory
from twodof.experiment.fly import fly_series

pytestmark = pytest.mark.slow


def drones() -> list[int]:
    """Return the processes of drones that this process has started."""
    return [number for number, words in children(os.getpid()).items() if "fcu" in words]


@pytest.mark.long
def test_flights_come_as_they_are_flown_and_leaving_early_ends_all() -> None:
    series = fly_series(["paper"], ["velocity-doublet"], range(4, 1000))
    rig, name, seed, flight = next(series)
    assert (rig, name, seed, flight.good) == ("paper", "velocity-doublet", 4, True)
    simulated = Laboratory("paper").fly(name, seed).log["x"].value
    np.testing.assert_array_equal(flight.log["x"].value, simulated.astype(np.float32))
    flying = drones()
    series.close()
    assert flying
    assert not drones()


def test_an_error_in_a_thread_is_raised() -> None:
    with pytest.raises(TwodofError, match="no-such-rig"):
        list(fly_series(["no-such-rig.json"], ["doublet"], [1]))
    assert not drones()
