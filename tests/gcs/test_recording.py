"""Recordings: copies and empty batches, the file that is replaced, what flew, and a minute without a gap."""

import hashlib
import json
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from bench.stack.programs import running
from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from tests.gcs.virtual import on_board
from twodof.blocks.schema.json_form import to_json
from twodof.errors import LinkLost, LogError
from twodof.flight.starters import starter
from twodof.flightlog.files import attachments, read_log
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone import Drone
from twodof.gcs.recording import TOGETHER, Recording
from twodof.link.mavlink.messages import message
from twodof.signals import TOPICS

pytestmark = pytest.mark.slow


def test_empty_batches_take_no_memory(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "empty.mcap", [row for row in TOPICS if row.onboard], {}, wait=True)
    empty = message("TWODOF_BATCH", channels=1, tick=1, values=[0.0] * 60, rows=0, every=1)
    for _ in range(10 * TOGETHER):
        recording.take(empty)
        assert len(recording._waiting) < TOGETHER
    recording.finish()
    assert (recording.samples, recording.lost) == (0, 0)


def test_a_copy_of_a_true_state_is_dropped(tmp_path: Path) -> None:
    file = tmp_path / "truth.mcap"
    recording = Recording(file, [row for row in TOPICS if not row.onboard], {}, wait=True)
    for tick in (500, 500, 501, 500, 502):
        recording.truth(message("TWODOF_TRUTH", time_usec=4000 * tick, step=tick, theta=0.001 * tick))
    recording.finish()
    assert recording.samples == 3 * len(recording.topics)
    assert np.array_equal(read_log(file)["theta_true"].value, [0.5, 0.501, 0.502])


def test_a_recording_that_cannot_begin_keeps_the_old_file(tmp_path: Path) -> None:
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


def test_a_recording_replaces_the_old_file_once_begun(tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    file.write_bytes(b"the flight before")
    recording = Recording(file, [row for row in TOPICS if not row.onboard], {}, wait=True, overwrite=True)
    recording.truth(message("TWODOF_TRUTH", time_usec=2000, step=500, theta=0.5))
    recording.finish()
    assert np.array_equal(read_log(file)["theta_true"].value, [0.5])
    assert [*tmp_path.iterdir()] == [file]


def test_a_recording_keeps_tuned_parameters_and_the_diagram(tmp_path: Path) -> None:
    mine = to_json(starter("pid-attitude")).encode()
    with (
        on_board(lockstep=True, controllers=["pid-attitude"], trusted=True) as there,
        Drone.connect(there.url) as drone,
    ):
        before = drone.active_controller()
        drone.parameters.update({"POS_KP": 0.7, "SDLOG_MODE": -1})
        flies = drone.active_controller()
        assert dict(flies.parameters) == {**before.parameters, "POS_KP": 0.7, "SDLOG_MODE": -1}
        assert list(flies.diagrams) == ["attitude_control"]
        with drone.record(tmp_path / "flight.mcap"):
            drone.run(0.1)
    (kept,) = attachments(tmp_path / "flight.mcap")
    assert kept.name == "attitude_control.json"
    assert kept.data == flies.diagrams["attitude_control"] == mine
    drone_said = read_log(tmp_path / "flight.mcap").provenance["drone"]
    assert drone_said["parameters"] == dict(flies.parameters)
    (controller,) = drone_said["controllers"].values()
    assert controller["name"] == "pid_attitude"
    assert controller["sha256"] == hashlib.sha256(mine).hexdigest()
    assert controller["diagram"] == json.loads(mine)
    assert controller["parameters"]["M_low"] == -1.0


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


@pytest.mark.slow
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
