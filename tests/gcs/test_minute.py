"""Every topic at the full rate, in real time, through a companion onto the disk: nothing lost, little used."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from bench.stack.programs import running
from twodof.flightlog import read_log
from twodof.gcs.drone import Drone
from twodof.signals import TOPICS

pytestmark = pytest.mark.slow

PERIOD_S = 0.004
MOST_OF_A_CORE, LONG_S = 0.5, 60.0
STAMP_S = 2e-6  # stamps are whole microseconds
# The minute is measured by what the client knows of the drone's time, which a busy machine lets grow old.
EDGES_S = 1.0
# Mean and longest time between samples [s] of what is slower: the range sensor (18.35 Hz, read at whole periods), the
# estimate along the rail (two of five periods), the battery. The loop is not opened; all else is one a period.
SLOWER = {
    "dist": (1.0 / 18.35, 0.056),
    "x": (0.010, 0.012),
    "v": (0.010, 0.012),
    "voltage": (0.5, 0.5),
    "charge": (0.5, 0.5),
}


@pytest.mark.long
@pytest.mark.waits
@pytest.mark.parametrize(
    "seconds", [2.5, pytest.param(60.0, marks=pytest.mark.soak), pytest.param(600.0, marks=pytest.mark.soak)]
)
def test_all_topics_are_recorded_without_a_gap(seconds: float, tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    with ExitStack() as stack:
        command = ("fcu", "--listen", "tcpin://127.0.0.1:0", "--rings", "--state", "state")
        fcu = stack.enter_context(running(*command, urls=1, folder=tmp_path))
        command = ("companion", "--fcu", fcu.urls[0].replace("tcpin", "tcp"), "--onboard", "tcpin://127.0.0.1:0")
        companion = stack.enter_context(running(*command, urls=1, folder=tmp_path))
        drone = stack.enter_context(Drone.connect(companion.urls[0].replace("tcpin", "tcp"), timeout=60.0))
        drone.arm()
        drone.level_hold()
        begun = time.process_time() + fcu.cpu_seconds() + companion.cpu_seconds()
        with drone.record(file) as recording:
            drone.run(seconds)
        used = time.process_time() + fcu.cpu_seconds() + companion.cpu_seconds() - begun
    assert recording.lost == 0
    assert not recording.dropped
    if seconds >= LONG_S:  # in less what beginning costs counts for much
        assert used < MOST_OF_A_CORE * seconds  # drone, companion and recorder together

    log = read_log(file)
    assert {row.mat for row in TOPICS} - set(log) <= {"lmnf"}  # every topic
    for name in set(log) - {"safety", "lmnf"}:
        mean, longest = SLOWER.get(name, (PERIOD_S, PERIOD_S))
        span = float(np.ptp(log[name].time))
        assert span >= seconds - EDGES_S - mean, name
        assert len(log[name]) >= span / mean - 1.0, name
        assert np.diff(log[name].time).max() <= longest + STAMP_S, name
