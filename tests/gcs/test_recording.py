"""A recording by itself: what a vehicle may put into its batches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.errors import LinkLost, LogError
from twodof.flightlog import read_log
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.recording import TOGETHER, Recording
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


def test_a_recording_that_cannot_begin_keeps_the_file_that_it_would_replace(tmp_path: Path) -> None:
    """An unknown topic, a link that is lost while it begins, a block that is never entered, a folder in its place."""
    file = tmp_path / "flight.mcap"
    file.write_bytes(b"the flight before")
    (tmp_path / "folder.mcap").mkdir()

    lost = False

    async def work() -> None:
        nonlocal lost
        async with (
            Peer(spoil=lambda _, sent: None if lost else [sent]) as peer,
            await AsyncDrone.connect(peer.url) as drone,
        ):
            drone.record(file, overwrite=True)
            with pytest.raises(LogError, match="no_topic"):
                async with drone.record(file, ["no_topic"], overwrite=True):
                    pass
            with pytest.raises(LogError, match=r"is a directory.*name a file"):
                async with drone.record(tmp_path / "folder.mcap", overwrite=True):
                    pass
            lost = True
            with pytest.raises(LinkLost):
                async with drone.record(file, overwrite=True):
                    pass

    run_virtual(work())
    assert file.read_bytes() == b"the flight before"
    assert {one.name for one in tmp_path.iterdir()} == {"flight.mcap", "folder.mcap"}


def test_a_recording_takes_the_place_of_another_once_it_has_begun(tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    file.write_bytes(b"the flight before")
    recording = Recording(file, [row for row in TOPICS if not row.onboard], {}, wait=True, overwrite=True)
    recording.truth(message("TWODOF_TRUTH", time_usec=2000, step=500, theta=0.5))
    recording.finish()
    assert np.array_equal(read_log(file)["theta_true"].value, [0.5])
    assert [*tmp_path.iterdir()] == [file]
