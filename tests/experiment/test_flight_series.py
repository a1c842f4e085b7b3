"""Flights by processes of their own: they come as simulated, an error comes too, and nothing is left behind."""

import multiprocessing
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from twodof.errors import TwodofError
from twodof.experiment.flight import Laboratory
from twodof.experiment.flight_series import fly_series

pytestmark = pytest.mark.slow


def descendants() -> set[str]:
    """Command lines of what this process has started, drones included."""
    found = set()
    for process in multiprocessing.active_children():
        found.add(process.name)
    children = Path(f"/proc/self/task/{multiprocessing.current_process().pid}/children")
    return found | {one for one in children.read_text().split() if "fcu" in command_line(one)}


def command_line(process: str) -> str:
    """That of a process; nothing for one that has ended."""
    with suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_text()
    return ""


@pytest.mark.long
def test_flights_come_as_they_are_flown_and_leaving_early_ends_all() -> None:
    series = fly_series(["paper"], ["velocity-doublet"], range(4, 1000))
    rig, name, seed, flight = next(series)
    assert (rig, name, seed, flight.good) == ("paper", "velocity-doublet", 4, True)
    simulated = Laboratory("paper").fly(name, seed).log["x"].value
    np.testing.assert_array_equal(flight.log["x"].value, simulated.astype(np.float32))
    assert descendants()
    series.close()
    assert not descendants()


def test_what_goes_wrong_in_a_process_is_raised_here() -> None:
    with pytest.raises(TwodofError, match="no-such-rig"):
        list(fly_series(["no-such-rig.json"], ["doublet"], [1]))
    assert not descendants()
