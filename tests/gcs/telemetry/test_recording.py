"""A recording by itself: what a vehicle may put into its batches."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twodof.flightlog import read_log
from twodof.gcs.telemetry.recording import TOGETHER, Recording
from twodof.link.mavlink.messages import message
from twodof.signals import TOPICS


def test_batches_that_carry_nothing_take_no_memory(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "empty.mcap", [row for row in TOPICS if row.onboard], {}, wait=True)
    empty = message("TWODOF_BATCH", channels=1, tick=1, values=[0.0] * 60, rows=0, every=1)
    for _ in range(10 * TOGETHER):
        recording.take(empty)
        assert len(recording._waiting) < TOGETHER
    recording.finish()
    assert (recording.samples, recording.lost) == (0, 0)


def test_a_true_state_that_comes_twice_is_one(tmp_path: Path) -> None:
    """Where time is granted that of the present tick is asked for, and asked for again if the answer is slow."""
    file = tmp_path / "truth.mcap"
    recording = Recording(file, [row for row in TOPICS if not row.onboard], {}, wait=True)
    for tick in (500, 500, 501, 500, 502):
        recording.truth(message("TWODOF_TRUTH", time_usec=4000 * tick, step=tick, theta=0.001 * tick))
    recording.finish()
    assert recording.samples == 3 * len(recording.topics)
    assert np.array_equal(read_log(file)["theta_true"].value, [0.5, 0.501, 0.502])
