"""The on-board log: every bit of every step, in words that PX4's tools read, also after a crash or on a bad disk."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyulog import ULog

from tests.fcu import flights
from tests.fcu.onboard_log.logging_child import FLUSHED_EACH
from tests.fcu.steps import any_step, numbers_of, plain_step
from tests.patience import PATIENCE_S
from twodof.errors import LogError
from twodof.experiment.flight import flight_log
from twodof.fcu.control.flight_code import ControlStep, FlightCode
from twodof.fcu.onboard_log import logger
from twodof.fcu.onboard_log.log_topics import COLUMNS, PX4_TOPICS, STEP_TOPIC
from twodof.fcu.onboard_log.log_writer import MARGIN, LogWriter
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.flightlog import read_log, recover
from twodof.flightlog.ulog_file import scan_ulog

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[3]
ALWAYS = {"SDLOG_MODE": 2}


def steps_in(path: Path) -> Mapping[str, np.ndarray]:
    topic = scan_ulog(path.read_bytes(), str(path)).topic(STEP_TOPIC)
    assert topic is not None
    return topic


def logged(folder: Path, steps: list[ControlStep], **values: float) -> list[Path]:
    with OnboardLogger(folder, ParameterStore(values=values), lockstep=True) as log:
        for step in steps:
            log.step(step)
    assert (log.failure, log.dropped) == (None, 0)
    return [one.path for one in log.logs()]


def bits(value: Any) -> bytes:
    """Bits of a number as the log holds it; a NaN is any NaN."""
    made = np.float64(value) if isinstance(value, float) else np.int64(value)
    return b"nan" if isinstance(value, float) and np.isnan(made) else made.tobytes()


def test_every_number_of_every_step_comes_back_to_the_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    steps = [any_step(tick, rng) for tick in range(200)]
    (path,) = logged(tmp_path, steps, **ALWAYS)
    rows = steps_in(path)
    assert rows["tick"].tolist() == [*range(200)]
    for name, kind in COLUMNS:
        read = [float(v) if kind is float else int(v) for v in rows[name]]
        given = [numbers_of(step)[name] for step in steps]
        assert [bits(v) for v in read] == [bits(v if kind is float else int(v)) for v in given], name


def test_a_log_of_a_flight_is_the_log_of_the_simulated_one(tmp_path: Path) -> None:
    """One flight on the rig, read from arrays in memory and from its ULog file."""
    script = flights.Script(disarm_at=900)
    controller = flights.controller(FlightCode(), script)
    with OnboardLogger(tmp_path, ParameterStore(values=ALWAYS), lockstep=True) as log:
        controller.bus.subscribe(ControlStep, log.step)
        for _ in range(1000):
            controller.step()
    found = read_log(log.logs()[0].path)
    columns = [numbers_of(step) for step in script.steps]
    out = {name: np.array([row[name] for row in columns], dtype=np.float64) for name in columns[0]}
    expected = flight_log(out, out["asked_mode"].astype(np.int32), {})
    assert sorted(found) == sorted([*expected, "safety"])
    safety = np.column_stack([out[name] for name in ("action", "reason", "causes")])
    held = found["safety"].index(found["mode"].time)  # the last that was told is what held in each step
    np.testing.assert_array_equal(found["safety"].value[held], safety)
    for name in expected:
        assert found[name].unit == expected[name].unit
        np.testing.assert_array_equal(found[name].time, expected[name].time)
        np.testing.assert_array_equal(found[name].value, expected[name].value)
    assert found.armed()
    assert found.provenance["parameters"]["RATE_KP"] == pytest.approx(0.0854, rel=1e-7)  # a float32


def test_pyulog_reads_what_px4s_tools_show(tmp_path: Path) -> None:
    steps = [plain_step(tick, armed=True) for tick in range(1000)]
    (path,) = logged(tmp_path, steps, **ALWAYS)
    log = ULog(str(path))
    assert not log.file_corruption
    data = {one.name: one.data for one in log.data_list}
    assert data.keys() == {STEP_TOPIC, *(topic.name for topic in PX4_TOPICS)}
    rows = steps_in(path)
    single = np.finfo(np.float32).eps  # these topics are in PX4's own precision
    attitude = data["vehicle_attitude"]
    pitch = np.arcsin(2.0 * (attitude["q[0]"] * attitude["q[2]"]).astype(np.float64))
    folded = np.arcsin(np.sin(rows["theta"]))
    np.testing.assert_allclose(pitch, folded, atol=1e-3)  # asin's slope near 90 deg
    for topic, field, expected in [
        ("vehicle_angular_velocity", "xyz[1]", rows["q"]),
        ("sensor_combined", "gyro_rad[1]", rows["gyro_y"]),
        ("sensor_combined", "accelerometer_m_s2[0]", rows["acc_x"]),
        ("vehicle_torque_setpoint", "xyz[1]", rows["M"]),
        ("vehicle_thrust_setpoint", "xyz[2]", -rows["T"]),
        ("actuator_motors", "control[0]", rows["fore"]),
        ("actuator_motors", "control[1]", rows["aft"]),
        ("vehicle_rates_setpoint", "pitch", rows["q0"]),
        ("vehicle_local_position_setpoint", "x", rows["x0"]),
    ]:
        np.testing.assert_allclose(data[topic][field], expected, rtol=single, err_msg=f"{topic}.{field}")
    assert np.isnan(data["actuator_motors"]["control[4]"]).all()
    assert len(data["distance_sensor"]["timestamp"]) == rows["dist_new"].sum()
    assert len(data["vehicle_local_position"]["timestamp"]) == 400  # 100 Hz for 4 s
    assert set(data["vehicle_status"]["arming_state"]) == {2}
    assert set(data["vehicle_status"]["nav_state"]) == {14}
    assert {"ver_sw", "ver_hw", "sys_name"} <= log.msg_info_dict.keys()
    assert log.initial_parameters["COM_DL_LOSS_T"] == 10


def test_a_drone_on_the_ground_is_not_in_failsafe(tmp_path: Path) -> None:
    flown = [(False, 3), (True, 0), (True, 1), (False, 3)]  # the action of a disarmed drone is to keep its motors off
    steps = [replace(plain_step(k, armed), action=action) for k, (armed, action) in enumerate(flown)]
    (path,) = logged(tmp_path, steps, **ALWAYS)
    status = scan_ulog(path.read_bytes(), "log").topic("vehicle_status")
    assert status is not None
    assert status["failsafe"].tolist() == [0, 0, 1, 0]


def ticks_of(paths: list[Path]) -> list[tuple[int, int]]:
    return [(int(rows["tick"][0]), int(rows["tick"][-1])) for rows in map(steps_in, paths)]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (0, [(400 - MARGIN, 799 + MARGIN), (1800 - MARGIN, 2199 + MARGIN)]),
        (1, [(0, 799 + MARGIN), (1800 - MARGIN, 2199 + MARGIN)]),
        (2, [(0, 2999)]),
        (-1, []),
    ],
)
def test_when_it_logs(tmp_path: Path, mode: int, expected: list[tuple[int, int]]) -> None:
    steps = [plain_step(tick, armed=400 <= tick < 800 or 1800 <= tick < 2200) for tick in range(3000)]
    assert ticks_of(logged(tmp_path, steps, SDLOG_MODE=mode)) == expected


def test_time_that_begins_anew_begins_a_new_log(tmp_path: Path) -> None:
    steps = [plain_step(tick, armed=True) for tick in (*range(700), *range(300))]
    assert ticks_of(logged(tmp_path, steps)) == [(0, 699), (0, 299)]


def test_each_run_has_its_own_seed_however_late_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late, take = threading.Event(), LogWriter.rows

    def held(writer: LogWriter, rows: np.ndarray) -> None:
        late.wait(PATIENCE_S)
        take(writer, rows)

    monkeypatch.setattr(LogWriter, "rows", held)
    run = {"seed": 0}
    with OnboardLogger(tmp_path, ParameterStore(values=ALWAYS), lockstep=True, info=lambda: dict(run)) as log:
        for run["seed"] in range(3):
            for tick in range(20):
                log.step(plain_step(tick))
        late.set()
    found = [scan_ulog(one.path.read_bytes(), "log").info for one in log.logs()]
    assert [info["seed"] for info in found] == [0, 1, 2]
    assert {info["ver_hw"] for info in found} == {"TWODOF"}


def test_on_request_it_logs_whatever_the_mode(tmp_path: Path) -> None:
    with OnboardLogger(tmp_path, ParameterStore(values={"SDLOG_MODE": -1}), lockstep=True) as log:
        for tick in range(1000):
            if tick == 300:
                log.start()
            if tick == 600:
                log.stop()
            log.step(plain_step(tick))
    assert ticks_of([one.path for one in log.logs()]) == [(300 - MARGIN, 599)]


def test_changes_and_words_are_in_it_where_they_belong(tmp_path: Path) -> None:
    store = ParameterStore()
    with OnboardLogger(tmp_path, store, lockstep=True, info=lambda: {"rig": "lab", "seed": 5}) as log:
        for tick in range(600):
            if tick == 50:
                log.note("warning", "long before arming: gone")
            if tick == 350:
                log.remark(3, "not armed: tilted")
            if tick == 500:
                store.update({"RATE_KP": 0.07})
                log.remark(6, "flying")
            log.step(plain_step(tick, armed=tick >= 400))
    (path,) = [one.path for one in log.logs()]
    found = scan_ulog(path.read_bytes(), "log")
    assert (found.info["rig"], found.info["seed"]) == ("lab", 5)
    assert found.parameters["RATE_KP"] == np.float32(0.0854)
    assert found.changes == [(4000 * 499, name, np.float32(0.07)) for name in ("FC_PARAM_4", "RATE_KP")]
    assert [(level - ord("0"), stamp, text) for level, stamp, text in found.texts] == [
        (3, 4000 * 349, "not armed: tilted"),
        (6, 4000 * 499, "flying"),
    ]
    assert read_log(path).provenance["changes"][-1] == [pytest.approx(11.996), "RATE_KP", pytest.approx(0.07)]


def test_a_slow_disk_drops_rows_in_real_time_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow, going, take = threading.Event(), threading.Event(), LogWriter.rows

    def held(writer: LogWriter, rows: np.ndarray) -> None:
        going.set()
        slow.wait(PATIENCE_S)
        take(writer, rows)

    monkeypatch.setattr(LogWriter, "rows", held)
    monkeypatch.setattr(logger, "LONGEST_QUEUE", 300)
    with OnboardLogger(tmp_path, ParameterStore(values=ALWAYS)) as log:
        log.step(plain_step(0))
        assert going.wait(PATIENCE_S)  # it has the first row and hangs in it
        for tick in range(1, 801):
            log.step(plain_step(tick))
        assert log.dropped == 500
        slow.set()
        log.flush(PATIENCE_S)
        log.step(plain_step(801))
    (path,) = [one.path for one in log.logs()]
    assert steps_in(path)["tick"].tolist() == [*range(301), 801]
    assert ULog(str(path)).dropouts[0].duration == 500 * 4
    assert read_log(path).gaps("M")[0].missing == 500


def test_in_lockstep_nothing_is_dropped_however_slow_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = LogWriter.rows

    def slow(writer: LogWriter, rows: np.ndarray) -> None:
        time.sleep(0.002)
        take(writer, rows)

    monkeypatch.setattr(LogWriter, "rows", slow)
    monkeypatch.setattr(logger, "LONGEST_QUEUE", 50)
    (path,) = logged(tmp_path, [plain_step(tick) for tick in range(2000)], **ALWAYS)
    assert steps_in(path)["tick"].tolist() == [*range(2000)]


def test_the_oldest_logs_go(tmp_path: Path) -> None:
    (tmp_path / "log_00001.ulg").symlink_to("/etc/passwd")
    (tmp_path / "mine.txt").write_text("mine")
    for _ in range(5):
        logged(tmp_path, [plain_step(tick, armed=True) for tick in range(10)], SDLOG_DIRS_MAX=3)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["log_00001.ulg", *(f"log_0000{n}.ulg" for n in (4, 5, 6)), "mine.txt"]


def test_bytes_are_bounded_and_a_long_flight_goes_on_in_a_new_file(tmp_path: Path) -> None:
    most = 2_000_000
    with OnboardLogger(tmp_path, ParameterStore(values=ALWAYS), lockstep=True, max_bytes=most) as log:
        for tick in range(6000):
            log.step(plain_step(tick))
            if tick % 250 == 0:
                log.flush()
                assert 0 < sum(one.size for one in log.logs()) <= most
    spans = ticks_of([one.path for one in log.logs()])
    assert len(spans) > 1
    assert spans[-1][1] == 5999
    assert all(later[0] == earlier[1] + 1 for earlier, later in pairwise(spans))


def run_child(*arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    command = [sys.executable, "-m", "tests.fcu.onboard_log.logging_child", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=PROJECT, env=environment)


def test_what_was_flushed_survives_kill_9(tmp_path: Path) -> None:
    with run_child("until-killed", str(tmp_path)) as child:
        timer = threading.Timer(PATIENCE_S, child.kill)
        timer.start()
        assert child.stdout is not None
        said = [int(child.stdout.readline()) for _ in range(5)]
        child.kill()
        said += [int(line) for line in child.stdout.read().split()]
        timer.cancel()
    (path,) = tmp_path.iterdir()
    steps = scan_ulog(path.read_bytes(), "log", salvage=True).topic(STEP_TOPIC)
    assert steps is not None
    ticks = steps["tick"].tolist()
    assert ticks == [*range(len(ticks))]
    assert len(ticks) >= said[-1] >= 5 * FLUSHED_EACH
    assert len(recover(path).log["M"]) == len(ticks)


def test_a_full_disk_ends_the_log_and_not_the_flight(tmp_path: Path) -> None:
    child = run_child("full", str(tmp_path), "600000")
    said, _ = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0
    full, later = said.splitlines()
    assert "refused" in full
    first, second = sorted(tmp_path.iterdir())
    # As much as went in is readable.
    kept = recover(first).log
    assert 0 < first.stat().st_size <= 600_000
    assert 0 < len(kept["M"]) < (2600 - 400) + 2 * MARGIN
    assert not kept.gaps("M")
    assert later == "None"
    assert ticks_of([second]) == [(3300 - MARGIN, 3599 + MARGIN)]


def test_a_disk_that_is_not_there_stops_nothing(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="folder"):
        OnboardLogger("/proc/none", ParameterStore())
    with OnboardLogger(tmp_path / "gone", ParameterStore(values=ALWAYS), lockstep=True) as log:
        (tmp_path / "gone").rmdir()
        for tick in range(100):
            log.step(plain_step(tick))
        with pytest.raises(LogError, match="cannot be"):
            log.flush()
