"""ULog: what is written is read by PX4's own reader, field by field; PX4's topics become the drone's channels."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyulog import ULog as TheirULog

from tests.flightlog.conftest import SlowDisk
from tests.flightlog.recording_child import FORMATS, gyro
from tests.flightlog.test_recorder import kill, start
from tests.patience import PATIENCE_S
from twodof.errors import LogError, RecordingError
from twodof.flightlog.files import convert, read_log, write_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.ulog_file import scan_ulog
from twodof.flightlog.ulog_writer import ULogWriter
from twodof.signals import TOPICS

pytestmark = pytest.mark.slow

EVERY_TYPE = (
    "uint64_t timestamp;int8_t a;uint8_t b;int16_t c;uint16_t d;int32_t e;uint32_t f;int64_t g;uint64_t h;"
    "float i;double j;bool k;float[3] l;uint8_t[5] m;"
)


def test_their_reader_finds_every_field(tmp_path: Path) -> None:
    path = tmp_path / "a.ulg"
    chance = np.random.default_rng(1)
    limits = [np.iinfo(kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")]
    rows = [
        [
            *(int(chance.integers(one.min, one.max, endpoint=True, dtype=one.dtype)) for one in limits),
            *chance.standard_normal(2).tolist(),
            int(chance.integers(2)),
            *chance.standard_normal(3).tolist(),
            *chance.integers(256, size=5).tolist(),
        ]
        for _ in range(200)
    ]
    parameters = {"K_INT": -7, "K_FLOAT": 0.0854}
    with ULogWriter(path, {"every": EVERY_TYPE}, {"ver_hw": "virtual", "ver_n": 3}, parameters, 17) as writer:
        for k, row in enumerate(rows):
            assert writer.write("every", 4000 * k, row)
        assert writer.text("warning", 5000, "thrust off: é")
        assert writer.parameter("K_INT", 12, 800_000)
        assert writer.parameter("K_FLOAT", 0.5, 800_000)
    ours, theirs = scan_ulog(path.read_bytes(), "a.ulg"), TheirULog(str(path))
    assert not theirs.file_corruption
    assert theirs.msg_info_dict == {"sys_name": "twodof", "ver_hw": "virtual", "ver_n": 3}
    assert theirs.initial_parameters == {"K_INT": -7, "K_FLOAT": float(np.float32(0.0854))}
    assert [(name, value) for _, name, value in theirs.changed_parameters] == [("K_INT", 12), ("K_FLOAT", 0.5)]
    assert ours.changes == [(796_000, "K_INT", 12), (796_000, "K_FLOAT", 0.5)]
    (line,) = theirs.logged_messages
    assert (line.log_level_str(), line.timestamp, line.message) == ("WARNING", 5000, "thrust off: é")
    assert ours.texts == [(ord("4"), 5000, "thrust off: é")]
    record = ours.topic("every")
    assert record is not None
    names = ["timestamp", *"abcdefghijk", *(f"l[{k}]" for k in range(3)), *(f"m[{k}]" for k in range(5))]
    for place, name in enumerate(names):
        expected = np.array([[4000 * k, *row][place] for k, row in enumerate(rows)], record[name].dtype)
        assert record[name].tobytes() == expected.tobytes(), name


def test_the_signals_of_topics_come_back_to_the_bit(tmp_path: Path) -> None:
    chance = np.random.default_rng(2)
    onboard = [row for row in TOPICS if row.onboard]
    values = {row.name: chance.standard_normal((50, row.width)) for row in onboard}
    with ULogWriter(tmp_path / "a.ulg") as writer:
        for k in range(50):
            for row in onboard:
                writer.write(row.name.replace(".", "_"), 4000 * k, values[row.name][k].tolist())
    log = read_log(tmp_path / "a.ulg")
    assert list(log) == [row.mat for row in onboard]
    for row in onboard:
        assert log[row.mat].value.tobytes() == values[row.name].tobytes()
        assert log[row.mat].time.tobytes() == (4000 * np.arange(50) / 1e6).tobytes()
        assert (log[row.mat].unit, log[row.mat].fields) == (row.unit, row.fields)
    convert(tmp_path / "a.ulg", tmp_path / "b.mcap")
    convert(tmp_path / "b.mcap", tmp_path / "c.mat")
    assert read_log(tmp_path / "c.mat")["acc"].value.tobytes() == values["imu.acc"].tobytes()
    write_log(log, tmp_path / "d.ulg")
    back = read_log(tmp_path / "d.ulg")
    assert {name: back[name].value.tobytes() for name in back} == {name: log[name].value.tobytes() for name in log}
    with pytest.raises(LogError, match="is there already"):
        write_log(log, tmp_path / "d.ulg")
    write_log(log, tmp_path / "d.ulg", overwrite=True)
    assert [path.name for path in tmp_path.glob(".*")] == []


def message(letter: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(letter)) + body


def px4_log(n: int = 40) -> bytes:
    """As PX4 writes one: padding, nested formats, several instances, definitions with multiple parts."""
    made = struct.pack("<7sBQ", b"ULog\x01\x12\x35", 1, 1000) + message("B", bytes(40))
    formats = {
        "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;uint8_t[4] _padding0;",
        "vehicle_angular_velocity": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;uint8_t[4] _padding0;",
        "vehicle_local_position": "uint64_t timestamp;uint64_t timestamp_sample;float x;float vx;",
        "vehicle_torque_setpoint": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
        "vehicle_thrust_setpoint": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
        "vehicle_attitude_setpoint": "uint64_t timestamp;float[4] q_d;",
        "vehicle_rates_setpoint": "uint64_t timestamp;float roll;float pitch;",
        "vehicle_local_position_setpoint": "uint64_t timestamp;float x;float vx;",
        "distance_sensor": "uint64_t timestamp;float current_distance;",
        "battery_status": "uint64_t timestamp;float voltage_v;float remaining;",
        "vehicle_control_mode": "uint64_t timestamp;bool flag_armed;bool flag_control_position_enabled;"
        "bool flag_control_velocity_enabled;bool flag_control_attitude_enabled;bool flag_control_rates_enabled;",
        "twodof_mine": "uint64_t timestamp;uint32_t tick;float in_theta;float out_m;int32_t log_hits;bool active;",
        "esc": "float rpm;uint8_t n;uint8_t[3] _padding0;",
        "esc_status": "uint64_t timestamp;esc[2] esc;uint8_t count;uint8_t[7] _padding0;",
    }
    made += b"".join(message("F", f"{name}:{text}".encode()) for name, text in formats.items())
    made += message("I", b"\x10char[3] sys_name" + b"PX4")
    made += message("I", b"\x21char[5] perf_counter_preflight-00" + b"a: 12")  # PX4 of 2018 to 2020
    made += message("M", b"\x00\x0fchar[2] perf/0:a" + b"b1") + message("I", b"\x07esc[2] e" + bytes(10))
    made += message("P", b"\x0efloat MC_PITCH" + struct.pack("<f", 6.5))
    made += message("Q", b"\x01\x0efloat MC_PITCH" + struct.pack("<f", 6.5))
    names = list(formats)
    for number, name in enumerate(names):
        if name != "esc":
            made += message("A", struct.pack("<BH", 0, number) + name.encode())
    made += message("A", struct.pack("<BH", 1, 99) + b"distance_sensor")
    for k in range(n):
        t, pitch = 4000 * k + 5000, 0.01 * k
        q = (np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0)
        rows: dict[str, bytes] = {
            "vehicle_attitude": struct.pack("<QQ4f", t, t - 500, *q),
            "vehicle_angular_velocity": struct.pack("<QQ3f", t, t - 500, 9.0, 0.5 * k, 8.0),
            "sensor_combined": struct.pack("<Q6f", t, 1.0, k, 3.0, 4.0, 5.0, -9.8),
            "vehicle_local_position": struct.pack("<QQ2f", t, 0, 0.25 * k, -0.5),
            "vehicle_torque_setpoint": struct.pack("<QQ3f", t, t - 500, 0.0, 0.125, 0.0),
            "vehicle_thrust_setpoint": struct.pack("<QQ3f", t, t - 500, 0.0, 0.0, -0.375),
            "vehicle_attitude_setpoint": struct.pack("<Q4f", t, *q),
            "vehicle_rates_setpoint": struct.pack("<Qff", t, 0.0, 1.5),
            "vehicle_local_position_setpoint": struct.pack("<Qff", t, 0.75 if k % 2 else float("nan"), 0.0),
            "distance_sensor": struct.pack("<Qf", t, 0.5),
            "battery_status": struct.pack("<Qff", t, 11.5, 0.75),
            # disarmed, then by stick, in Acro, level, in offboard by velocity, and at a position
            "vehicle_control_mode": struct.pack("<Q5?", t, k > 5, k > 35, k > 30, k > 20, k > 10),
            "twodof_mine": struct.pack("<QIffi?", t, k, 0.5, 0.25, -k, True),
            "esc_status": struct.pack("<Q", t) + struct.pack("<fB3x", k, 1) + struct.pack("<fB3x", -k, 2) + b"\x02",
        }
        for name, body in rows.items():
            made += message("D", struct.pack("<H", names.index(name)) + body)
        made += message("D", struct.pack("<H", 99) + struct.pack("<Qf", t, 7.0))
        if k % 10 == 9:
            made += message("S", bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12)))
    return made + message("O", struct.pack("<H", 30)) + message("R", struct.pack("<H", 99))


def test_px4s_topics_become_channels(tmp_path: Path) -> None:
    (tmp_path / "a.ulg").write_bytes(px4_log())
    log = read_log(tmp_path / "a.ulg")
    k = np.arange(40)
    stamp, sampled = (4000 * k + 5000) / 1e6, (4000 * k + 4500) / 1e6
    expected = {
        "theta": (sampled, 0.01 * k),
        "q": (sampled, 0.5 * k),
        "gyr": (stamp, np.stack([0 * k + 1.0, k, 0 * k + 3.0], 1)),
        "acc": (stamp, np.tile(np.float32([4.0, 5.0, -9.8]), (40, 1))),
        "x": (stamp, 0.25 * k),  # a stamp of the sample that is 0 is none
        "v": (stamp, 0 * k - 0.5),
        "M": (sampled, 0 * k + 0.125),
        "T": (sampled, 0 * k + 0.375),
        "thrust0": (sampled, 0 * k - 0.375),
        "theta0": (stamp, 0.01 * k),
        "q0": (stamp, 0 * k + 1.5),
        "x0": (stamp[1::2], 0 * k[1::2] + 0.75),
        "v0": (stamp, 0 * k),
        "dist": (stamp, 0 * k + 0.5),
        "voltage": (stamp, 0 * k + 11.5),
        "charge": (stamp, 0 * k + 0.75),
        "mode": (stamp, 1 * (k > 5) + (k > 10) + (k > 20) + (k > 30) + (k > 35)),
        "twodof_mine_in_theta": (stamp, 0 * k + 0.5),
        "twodof_mine_out_m": (stamp, 0 * k + 0.25),
        "twodof_mine_log_hits": (stamp, -k),
    }
    assert set(log) == set(expected)
    for name, (time, value) in expected.items():
        assert log[name].time.tolist() == time.tolist(), name
        if name.startswith("theta"):
            # the quaternion comes in float32: two of its roundings, 6e-8 each, on a pitch below 0.4 rad
            np.testing.assert_allclose(log[name].value, value, rtol=0, atol=2.5e-7)
        else:
            assert log[name].value.tolist() == value.tolist(), name
    assert log["gyr"].fields == ("x", "y", "z")
    assert log.provenance["left_out"] == {"x0": {"not_finite": 20}}
    assert log.provenance["ignored"] == ["esc_status"]
    assert log.provenance["ulog"]["info"] == {"sys_name": "PX4", "perf_counter_preflight-00": "a: 12"}
    assert log.provenance["parameters"] == {"MC_PITCH": 6.5}
    assert log.provenance["dropouts"] == {"count": 1, "total_s": 0.03}


def test_every_topic_becomes_channels_on_request(tmp_path: Path) -> None:
    (tmp_path / "a.ulg").write_bytes(px4_log())
    known, log = read_log(tmp_path / "a.ulg"), read_log(tmp_path / "a.ulg", topics=True)
    assert [*log][: len(known.channels)] == [*known]
    assert log["esc_status/esc[1].rpm"].value.tolist() == (-np.arange(40.0)).tolist()
    assert set(log["distance_sensor.1/current_distance"].value) == {7.0}
    assert len(log["vehicle_local_position_setpoint/x"]) == 20  # the others are NaN
    assert not [name for name in log if "padding" in name or "timestamp" in name]


DAY_US = 86_400_000_000
FIRST_US = 2 * DAY_US


@pytest.mark.parametrize("stamp", [0, 1, FIRST_US - DAY_US // 8, FIRST_US + DAY_US // 8, 2 * 10**15, 2**63, 2**64 - 1])
@pytest.mark.parametrize("at", [[0], [200], [399], [100, 101, 102, 200, 201]])
def test_stamps_far_off_are_left_out(tmp_path: Path, at: list[int], stamp: int) -> None:
    made = struct.pack("<7sBQ", b"ULog\x01\x12\x35", 1, FIRST_US) + message("B", bytes(40))
    made += message("F", b"vehicle_attitude:uint64_t timestamp;float[4] q;")
    made += message("F", b"battery_status:uint64_t timestamp;float voltage_v;")
    made += message("A", b"\0\0\0vehicle_attitude") + message("A", b"\0\1\0battery_status")
    made += message("D", struct.pack("<HQf", 1, FIRST_US + 500, 12.0))
    for k in range(400):
        made += message("D", struct.pack("<HQ4f", 0, stamp if k in at else FIRST_US + 4000 * k, 1.0, 0.0, 0.0, 0.0))
    (tmp_path / "a.ulg").write_bytes(made)
    log = read_log(tmp_path / "a.ulg")
    assert log["theta"].time.tolist() == [(FIRST_US + 4000 * k) / 1e6 for k in range(400) if k not in at]
    assert (len(log["voltage"]), log.provenance["left_out"]) == (1, {"theta": {"far_off": len(at)}})


def test_a_long_pause_and_a_start_at_zero_stay(tmp_path: Path) -> None:
    times = np.concatenate((np.arange(100), 10_000 + np.arange(30))) * 1.0
    write_log(FlightLog({"theta": Channel(times, times), "q": Channel([0.0, 10_010.0], [1, 2])}), tmp_path / "a.ulg")
    log = read_log(tmp_path / "a.ulg")
    assert (log["theta"].time.tolist(), log["q"].time.tolist()) == (times.tolist(), [0.0, 10_010.0])


def test_instances_stay_apart_and_subscriptions_join(tmp_path: Path) -> None:
    again = message("A", struct.pack("<BH", 0, 98) + b"distance_sensor")
    again += b"".join(message("D", struct.pack("<HQf", 98, 10**7 + k, 0.25)) for k in range(5))
    (tmp_path / "a.ulg").write_bytes(px4_log() + again)
    assert read_log(tmp_path / "a.ulg")["dist"].value.tolist() == [0.5] * 40 + [0.25] * 5
    found = scan_ulog(px4_log() + again, "a.ulg").topics
    assert found["distance_sensor", 1]["current_distance"].tolist() == [7.0] * 40


@pytest.mark.long
def test_a_log_that_ends_in_a_message(tmp_path: Path) -> None:
    whole = px4_log(4)
    path = tmp_path / "a.ulg"
    for size in range(len(whole) - 100, len(whole)):
        path.write_bytes(whole[:size])
        log = read_log(path)
        assert len(log["theta"]) in (3, 4)
        found = recover(path)
        assert found.samples == sum(len(channel) for channel in log.channels.values())
        assert found.lost_bytes == log.provenance.get("lost_bytes", 0)


@pytest.mark.long
def test_rubbish_behind_what_was_acknowledged(tmp_path: Path) -> None:
    path = tmp_path / "a.ulg"
    acknowledged = []
    with ULogWriter(path, FORMATS) as writer:
        for block in range(6):
            for k in range(20 * block, 20 * block + 20):
                writer.write("imu_gyro", 4000 * k, gyro(np.array([k]))[0].tolist())
            acknowledged.append(writer.flush())
    whole = path.read_bytes()
    chance = np.random.default_rng(5)
    for one in acknowledged:
        for tail in (b"", bytes(2000), b"\xff" * 2000, chance.bytes(2000), whole[:300], whole[-300:-11]):
            for extra in (0, 1, 3, 30, 61):
                path.write_bytes(whole[: one.position + extra] + tail)
                value = recover(path).log["gyr"].value
                assert value.tobytes()[: 24 * one.samples] == gyro(np.arange(one.samples)).tobytes()
                if tail and tail not in whole:
                    assert len(value) == one.samples
    for _ in range(200):
        one = acknowledged[int(chance.integers(6))]
        data = bytearray(whole[: int(chance.integers(one.position, len(whole) + 1))])
        for block in range(one.position // 512 * 512, len(data), 512):
            a, b = max(block, one.position), min(block + 512, len(data))
            data[a:b] = (data[a:b], bytes(b - a), chance.bytes(b - a))[int(chance.integers(3))]
        path.write_bytes(data)
        found = recover(path).log["gyr"]
        assert found.value[: one.samples].tobytes() == gyro(np.arange(one.samples)).tobytes()


def test_killed_while_logging(tmp_path: Path) -> None:
    path = tmp_path / "a.ulg"
    acknowledged = kill(start("ulg", path), 0.1)
    found = recover(path)
    n = len(found.log["gyr"])
    assert n >= acknowledged > 0
    assert found.log["gyr"].value.tobytes() == gyro(np.arange(n)).tobytes()
    # A kill that comes amid a write leaves a part without its mark: theirs takes what is whole of it, ours none.
    theirs = TheirULog(str(path)).data_list[0].data
    assert len(theirs["timestamp"]) >= n
    for column, name in enumerate("xyz"):
        assert theirs[name][:n].tobytes() == found.log["gyr"].value[:, column].tobytes()


def test_dropped_records_are_logged_as_a_dropout(tmp_path: Path, slow_disk: SlowDisk) -> None:
    path = tmp_path / "a.ulg"
    with ULogWriter(path, FORMATS, flush_s=0.01, capacity_bytes=37 * 50) as writer:
        slow_disk.stop()
        assert writer.write("imu_gyro", 0, (1.0, 2.0, 3.0))
        assert slow_disk.standing.wait(PATIENCE_S)  # with the first; all others wait in memory, or do not
        taken = [writer.write("imu_gyro", 4000 * k, (1.0, 2.0, 3.0)) for k in range(1, 71)]
        assert taken == [True] * 50 + [False] * 20
        slow_disk.go()
        assert writer.flush().samples == 51
        assert writer.write("imu_gyro", 4000 * 100, (1.0, 2.0, 3.0))
        assert writer.dropped == 20
    (theirs,) = TheirULog(str(path)).dropouts
    assert theirs.duration == 4 * (100 - 51)
    assert read_log(path).provenance["dropouts"]["count"] == 1


def test_values_that_ulog_cannot_hold_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ulg"
    wrong: list[dict[str, Any]] = [
        {"formats": {"a": "float x;"}},
        {"formats": {"a": "uint64_t timestamp;text x;"}},
        {"formats": {"a": "uint64_t timestamp;float x;float x;"}},
        {"formats": {"a b": "uint64_t timestamp;"}},
        {"formats": {"a": "uint64_t timestamp;double[9999] x;"}},
        {"info": {"a b": "x"}},
        {"info": {"n": 2**63}},
        {"parameters": {"P": 2**31}},
        {"parameters": {"P": 1e300}},
        {"start_us": -1},
    ]
    for arguments in wrong:
        with pytest.raises(LogError):
            ULogWriter(path, **arguments)
        assert not path.exists()
    with ULogWriter(path, FORMATS) as writer:
        bad: list[tuple[str, Any, Any]] = [
            ("none", 1, (1.0, 2.0, 3.0)),
            ("imu_gyro", -1, (1.0, 2.0, 3.0)),
            ("imu_gyro", 1, (1.0, 2.0)),
            ("imu_gyro", 1, ("x", 2.0, 3.0)),
        ]
        for name, stamp, values in bad:
            with pytest.raises(LogError):
                writer.write(name, stamp, values)
        with pytest.raises(LogError, match="no level"):
            writer.text("loud", 1, "x")
    with pytest.raises(LogError, match="is there already"):
        ULogWriter(path, FORMATS)
    with pytest.raises(RecordingError, match="is closed"):
        writer.write("imu_gyro", 1, (1.0, 2.0, 3.0))
