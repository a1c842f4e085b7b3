"""A recording by itself: what a vehicle may put into its batches."""

from __future__ import annotations

from pathlib import Path

from twodof.gcs.recording import TOGETHER, Recording
from twodof.link.messages import message
from twodof.signals import TOPICS


def test_batches_that_carry_nothing_take_no_memory(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "empty.mcap", [row for row in TOPICS if row.onboard], {}, wait=True)
    empty = message("TWODOF_BATCH", channels=1, tick=1, values=[0.0] * 60, rows=0, every=1)
    for _ in range(10 * TOGETHER):
        recording.take(empty)
        assert len(recording._waiting) < TOGETHER
    recording.finish()
    assert (recording.samples, recording.lost) == (0, 0)
