"""The recorder: what it takes, refuses, drops and acknowledges; killed at any moment; on a full disk."""

import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.flightlog.conftest import SlowDisk
from tests.flightlog.recording_child import PERIOD_NS, gyro
from tests.patience import PATIENCE_S
from twodof.errors import LogError, RecordingError
from twodof.flightlog.files import attachments, read_log
from twodof.flightlog.mcap_encoder import Attachment
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.mcap_stream import McapStream
from twodof.flightlog.recorder import Recorder
from twodof.signals import TOPICS

pytestmark = pytest.mark.slow

CHILD = Path(__file__).with_name("recording_child.py")
ROOT = Path(__file__).resolve().parents[2]


def test_every_topic_with_its_unit_and_provenance(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    diagram = Attachment("diagram.json", "application/json", b'{"blocks": []}')
    kept = {"seed": 11, "parameters": {"Kp": 0.0854}, "versions": {"twodof": "x"}}
    with Recorder(path, TOPICS, kept, [diagram]) as recorder:
        for row in TOPICS:
            times = np.arange(7) * 1_000_000
            assert recorder.write_many(row.name, times, np.arange(7.0 * row.width).reshape(7, -1))
            assert recorder.write(row.name, 8_000_000, [0.5] * row.width)
        done = recorder.flush()
        assert done.samples == recorder.accepted == 8 * len(TOPICS)
        assert done.position == path.stat().st_size
    log = read_log(path)
    assert {key: log.provenance[key] for key in kept} == kept
    assert attachments(path) == [diagram]
    for row in TOPICS:
        assert (log[row.mat].unit, log[row.mat].fields) == (row.unit, row.fields)
        assert log[row.mat].time.tolist() == [0.0, 0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.008]
        assert log[row.mat].value.ravel()[: 7 * row.width].tolist() == np.arange(7.0 * row.width).tolist()
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert [channel.topic for channel in summary.channels.values()] == [f"/{r.name.replace('.', '/')}" for r in TOPICS]


def test_misfits_are_refused_and_not_recorded(tmp_path: Path) -> None:
    own = McapStream("/own", "twodof_msgs/msg/Own", "own", "K", ("a", "b"), 2)
    with Recorder(tmp_path / "a.mcap", ["q", "imu.gyro", own]) as recorder:
        wrong: list[tuple[str, Any, Any]] = [
            ("estimate.x", 0, 1.0),
            ("estimate.q", -1, 1.0),
            ("estimate.q", 1 << 63, 1.0),
            ("estimate.q", 0.5, 1.0),
            ("estimate.q", 0, [1.0, 2.0]),
            ("estimate.q", 0, "text"),
            ("estimate.q", 0, None),
            ("estimate.q", 0, 10**400),
            ("imu.gyro", 0, 1.0),
            ("imu.gyro", 0, [1.0, 2.0]),
        ]
        for name, stamp, values in wrong:
            with pytest.raises(LogError):
                recorder.write(name, stamp, values)
        many: list[tuple[Any, Any]] = [
            ([0.5], [1.0]),
            ([-1], [1.0]),
            ([[1]], [[1.0]]),
            ([1, 2], [1.0]),
            ([1], ["x"]),
            ([1], [[1.0, 2.0]]),
        ]
        for times, rows in many:
            with pytest.raises(LogError):
                recorder.write_many("estimate.q", times, rows)
        assert recorder.accepted == 0
        recorder.write("/own", 3, (1.0, float("nan")))
        recorder.write("estimate.q", 3, np.float32(0.5))
    log = read_log(tmp_path / "a.mcap")
    assert list(log) == ["q", "own"]
    assert log.provenance["left_out"] == {"own": {"not_finite": 1}}
    with pytest.raises(RecordingError, match="is closed"):
        recorder.write("estimate.q", 4, 1.0)
    with pytest.raises(LogError, match="is there already"):
        Recorder(tmp_path / "a.mcap", ["q"])
    with pytest.raises(LogError, match="cannot be written"):
        Recorder(tmp_path / "none" / "a.mcap", ["q"])
    with pytest.raises(LogError, match="no such signal"):
        Recorder(tmp_path / "b.mcap", ["nothing"])
    with pytest.raises(LogError, match="is recorded twice"):
        Recorder(tmp_path / "b.mcap", ["q", "estimate.q"])
    for wrong_setting in ({"flush_s": 0.0}, {"capacity_bytes": 0}, {"capacity_bytes": 1 << 25}, {"full": "maybe"}):
        with pytest.raises(LogError, match="flush_s"):
            Recorder(tmp_path / "b.mcap", ["q"], **wrong_setting)
    for fields, width, mat in [(("a",), 2, "own"), ((), 0, "own"), ((), 1001, "own"), ((), 1, "")]:
        with pytest.raises(LogError, match="give a name for each column"):
            Recorder(tmp_path / "b.mcap", [McapStream("/own", "twodof_msgs/msg/Own", mat, "", fields, width)])
    with pytest.raises(LogError, match="is recorded twice"):
        Recorder(tmp_path / "b.mcap", ["q", McapStream("/own", "twodof_msgs/msg/Own", "q", "")])
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_samples_dropped_by_a_slow_disk_are_counted(tmp_path: Path, slow_disk: SlowDisk) -> None:
    with Recorder(tmp_path / "a.mcap", ["q", "theta"], flush_s=0.01, capacity_bytes=16 * 100) as recorder:
        slow_disk.stop()
        assert recorder.write("estimate.q", 0, 0.0)
        assert slow_disk.standing.wait(PATIENCE_S)  # with the first; all others wait in memory, or do not
        taken = [True, *(recorder.write("estimate.q", k, 1.0 * k) for k in range(1, 1000))]
        assert not recorder.write_many("estimate.theta", range(100), np.zeros(100))
        assert taken == [True] * 101 + [False] * 899
        assert recorder.dropped == {"estimate.q": 899, "estimate.theta": 100}
        with pytest.raises(LogError, match="1616 bytes at once are more than the buffer of 1600"):
            recorder.write_many("estimate.theta", range(101), np.zeros(101))
        with pytest.raises(RecordingError, match=r"did not answer within 0\.05 s"):
            recorder.flush(0.05)
        slow_disk.go()
        assert recorder.flush().samples == sum(taken)
    log = read_log(tmp_path / "a.mcap")
    assert log["q"].value.tolist() == [k for k, one in enumerate(taken) if one]
    assert log.provenance["dropped"] == recorder.dropped


def test_waiting_recorder_loses_nothing(tmp_path: Path, slow_disk: SlowDisk) -> None:
    with Recorder(tmp_path / "a.mcap", ["q"], flush_s=0.01, capacity_bytes=1600, full="wait") as recorder:
        slow_disk.stop()
        threading.Timer(0.2, slow_disk.go).start()
        assert all(recorder.write("estimate.q", k, 1.0 * k) for k in range(1000))
    assert read_log(tmp_path / "a.mcap")["q"].value.tolist() == list(range(1000))
    assert recorder.dropped == {}


def test_several_threads_record_at_once(tmp_path: Path) -> None:
    names = ["estimate.q", "estimate.theta", "command.M", "command.T"]
    with Recorder(tmp_path / "a.mcap", names, flush_s=0.01) as recorder:

        def run(name: str) -> None:
            for k in range(2000):
                recorder.write(name, k, 1.0 * k)

        threads = [threading.Thread(target=run, args=(name,)) for name in names]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE_S)
    log = read_log(tmp_path / "a.mcap")
    assert all(channel.value.tolist() == list(range(2000)) for channel in log.channels.values())


def test_an_error_in_the_block_leaves_a_complete_file(tmp_path: Path) -> None:
    def fly() -> None:
        with Recorder(tmp_path / "a.mcap", ["q"]) as recorder:
            recorder.write("estimate.q", 1, 1.0)
            recorder.write("estimate.q", 2, 1 / 0)

    with pytest.raises(ZeroDivisionError):
        fly()
    assert len(read_log(tmp_path / "a.mcap")["q"]) == 1


def test_recording_every_topic_costs_little(tmp_path: Path) -> None:
    """The whole stack may use half of a core; the recorder is given a tenth of that and measured at a fifth of it."""
    rates = {row.name: row.rate_hz or 50.0 for row in TOPICS}
    widths = {row.name: row.width for row in TOPICS}
    events = sorted((round(k * 1e9 / rate), name) for name, rate in rates.items() for k in range(int(15 * rate)))
    rows = {name: [0.25] * width if width > 1 else 0.25 for name, width in widths.items()}
    spent = time.process_time()
    with Recorder(tmp_path / "a.mcap", TOPICS) as recorder:
        due = 0
        for stamp, name in events:
            if stamp >= due:  # as often as in real time
                recorder.flush()
                due += 250_000_000
            assert recorder.write(name, stamp, rows[name])
    spent = time.process_time() - spent
    assert recorder.acknowledged.samples == len(events) > 60_000
    assert recorder.dropped == {}
    assert spent < 0.05 * 15.0
    log = read_log(tmp_path / "a.mcap")
    assert {row.name: len(log[row.mat]) for row in TOPICS} == {name: int(15 * rate) for name, rate in rates.items()}


def start(kind: str, path: Path) -> subprocess.Popen[str]:
    """The child, once it has acknowledged something."""
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'src'}"}
    child = subprocess.Popen([sys.executable, CHILD, kind, path], stdout=subprocess.PIPE, text=True, env=environment)
    assert child.stdout is not None
    deadline = time.monotonic() + PATIENCE_S
    while int(child.stdout.readline() or "0") == 0:
        assert time.monotonic() < deadline
        assert child.poll() is None
    return child


def kill(child: subprocess.Popen[str], after_s: float) -> int:
    """Kills it and returns the last number that it acknowledged."""
    timer = threading.Timer(after_s, child.send_signal, (signal.SIGKILL,))
    timer.start()
    # Read while it writes, or a full pipe would hold it up.
    text, _ = child.communicate(timeout=PATIENCE_S)
    timer.join(PATIENCE_S)
    assert child.returncode == -signal.SIGKILL
    whole = text[: text.rfind("\n") + 1].split()
    return int(whole[-1]) if whole else 1


def killed_while_recording(folder: Path, rounds: int, seed: int) -> None:
    """Check that the acknowledged samples are recovered, nothing false, and that the result is a whole file."""
    moments = random.Random(seed)
    for turn in range(rounds):
        path = folder / f"{turn}.mcap"
        acknowledged = kill(start("mcap", path), moments.uniform(0.0, 0.3))
        with pytest.raises(LogError, match="twodof log recover"):
            read_log(path)
        found = recover(path)
        assert found.what[0] == "the recording was not closed"
        for log in (found.log, rewritten(found, folder / f"{turn}-whole.mcap")):
            assert log.provenance["seed"] == 7
            n = len(log["gyr"])
            assert n >= 50 * acknowledged > 0
            assert log["gyr"].value.tobytes() == gyro(np.arange(n)).tobytes()
            assert log["gyr"].time.tobytes() == (PERIOD_NS * np.arange(n) / 1e9).tobytes()
            assert len(log["theta"]) >= 50 * acknowledged
            assert log["theta"].value.tobytes() == (0.5 * np.arange(len(log["theta"]))).tobytes()


def rewritten(found: Any, path: Path) -> Any:
    found.write(path)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == found.samples
    return read_log(path)


@pytest.mark.long
def test_killed_while_recording(tmp_path: Path) -> None:
    killed_while_recording(tmp_path, 2, seed=1)


@pytest.mark.soak
def test_killed_while_recording_many_times(tmp_path: Path) -> None:
    killed_while_recording(tmp_path, 200, seed=2)


@pytest.fixture
def file_size_limit() -> Iterator[int]:
    """No file may exceed 100 kB: the kernel refuses as a full disk does, in the middle of a write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    yield 100_000
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def fill(path: Path, failure: str) -> None:
    """Records noise until the disk refuses; what was acknowledged must stay, in a file with a proper end."""
    noise = np.random.default_rng(1).standard_normal((100, 3))
    recorder = Recorder(path, ["imu.gyro"], flush_s=0.01)
    acknowledged = 0

    def record() -> None:
        nonlocal acknowledged
        while acknowledged < 10_000_000:
            recorder.write_many("imu.gyro", np.arange(acknowledged, acknowledged + 100), noise)
            acknowledged = recorder.flush().samples

    with pytest.raises(RecordingError, match=failure):
        record()
    with pytest.raises(RecordingError, match=failure):
        recorder.write("imu.gyro", 0, [0.0, 0.0, 0.0])
    with pytest.raises(RecordingError, match=failure):
        recorder.close()
    assert recorder.failure is not None
    assert recorder.acknowledged.samples == acknowledged >= 100
    longest = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (longest, longest))  # the fence hands over what it reads in a long file
    log = recover(path).log
    assert log["gyr"].value.tobytes() == np.tile(noise, (acknowledged // 100, 1)).tobytes()


def test_a_full_disk_ends_the_recording_with_its_reason(tmp_path: Path, file_size_limit: int) -> None:
    fill(tmp_path / "a.mcap", "the disk refused: File too large")
    assert (tmp_path / "a.mcap").stat().st_size <= file_size_limit


def test_a_full_file_system(tmp_path: Path) -> None:
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    if mounted.returncode != 0:
        pytest.skip(f"no file system to fill: {mounted.stderr.strip()} (root can mount one)")
    try:
        fill(tmp_path / "a.mcap", "the disk refused: No space left on device")
    finally:
        subprocess.run(["umount", str(tmp_path)], timeout=PATIENCE_S, check=True)


def test_a_disk_that_is_full_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", refuse)
    with pytest.raises(RecordingError, match=r"No space left on device .*nothing was recorded"):
        Recorder(tmp_path / "a.mcap", ["q"])
    assert list(tmp_path.iterdir()) == []
