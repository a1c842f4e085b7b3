"""MCAP files: read by the readers of others, and files that others wrote."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from tests.flightlog.synthetic import attitude_steps, same_bits
from twodof.flightlog.files import attachments, read_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mcap_encoder import Attachment, McapEncoder, McapSamples
from twodof.flightlog.mcap_file import write_mcap
from twodof.flightlog.mcap_stream import ros_names, seconds, stream_of, streams_of
from twodof.signals import TOPICS, topic

pytestmark = pytest.mark.slow


@given(st.integers(0, 2**53))
def test_nanoseconds_are_exact(time_ns: int) -> None:
    # A whole number up to 2^53 is a float64; one division, correctly rounded, gives the closest stamp there is.
    stamp = float(seconds(np.array([time_ns], np.uint64))[0])
    assert stamp == time_ns / 1e9
    channel = Channel([stamp], [0.0])
    assert not streams_of(FlightLog({"q": channel}))["q"].stamped


def test_the_reader_of_mcap_finds_the_same(tmp_path: Path) -> None:
    log = attitude_steps()
    write_mcap(log, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(len(channel) for channel in log.channels.values())
        found: dict[str, list[tuple[int, bytes]]] = {}
        for _, channel, message in reader.iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
        counts = {summary.channels[n].topic: k for n, k in summary.statistics.channel_message_counts.items()}
    assert counts == {name: len(rows) for name, rows in found.items()}
    for name, stream in streams_of(log).items():
        rows = found[stream.topic]
        value = np.array([np.frombuffer(data[4:], "<f8") for _, data in rows])
        assert [time for time, _ in rows] == np.rint(log[name].time * 1e9).astype(int).tolist()
        stamp, value = (
            (value[:, 0], value[:, 1:]) if stream.stamped else (seconds(np.array([t for t, _ in rows])), value)
        )
        assert stamp.tobytes() == log[name].time.tobytes()
        assert value.tobytes() == log[name].value.tobytes()
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count


def test_a_window_is_found_by_the_index(tmp_path: Path) -> None:
    log = FlightLog({"q": Channel(0.004 * np.arange(50_000), np.zeros(50_000), "rad/s")})
    write_mcap(log, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        times = [
            m.log_time for _, _, m in reader.iter_messages(starting_at=10_000_000_000, ending_before=10_100_000_000)
        ]
        summary = reader.get_summary()
    assert times == list(range(10_000_000_000, 10_100_000_000, 4_000_000))
    assert summary is not None
    assert len(summary.chunk_indexes) > 5


def test_ros_reads_every_topic(tmp_path: Path) -> None:
    streams = [stream_of(row) for row in TOPICS]
    assert ros_names(("M", "enableM", "2nd", "a b", "a_b", "time")) == [
        "m",
        "enable_m",
        "f_2nd",
        "a_b",
        "a_b_4",
        "time_5",
    ]
    assert streams[TOPICS.index(topic("imu.gyro"))].definition.splitlines()[1] == "float64 x  # rad/s"
    encoder = McapEncoder(streams)
    samples = {
        k: McapSamples(np.array([1000 * k, 2000 * k + 1], np.uint64), np.arange(2.0 * s.width).reshape(2, -1) + k)
        for k, s in enumerate(streams)
    }
    path = tmp_path / "a.mcap"
    path.write_bytes(encoder.head({}) + encoder.chunk(samples) + encoder.tail())
    with AnyReader([path]) as reader:
        assert {one.topic: one.msgcount for one in reader.connections} == {stream.topic: 2 for stream in streams}
        seen = 0
        for connection, _, raw in reader.messages():
            stream = next(one for one in streams if one.topic == connection.topic)
            assert connection.msgtype == stream.schema
            message = reader.deserialize(raw, connection.msgtype)
            values = [getattr(message, name) for name in ros_names(stream.fields) or ["value"]]
            assert values in samples[streams.index(stream)].value.tolist()
            seen += 1
    assert seen == 2 * len(streams)


def test_wide_samples_are_read_again(tmp_path: Path) -> None:
    log = FlightLog({"wide": Channel(np.arange(1200.0), np.arange(1_200_000.0).reshape(1200, 1000))})
    write_mcap(log, tmp_path / "a.mcap")
    same_bits(log, read_log(tmp_path / "a.mcap"))


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_that_others_wrote_of_our_topics(tmp_path: Path, compression: CompressionType) -> None:
    gyro, theta = stream_of(topic("imu.gyro")), stream_of(topic("estimate.theta"))
    buffer = BytesIO()
    writer = Writer(buffer, chunk_size=4000, compression=compression)
    writer.start("ros2", "another")
    ids = {}
    for stream in (gyro, theta):
        schema = writer.register_schema(stream.schema, "ros2msg", stream.definition.encode())
        ids[stream.mat] = writer.register_channel(stream.topic, "cdr", schema, stream.metadata)
    other = writer.register_channel("/camera", "json", 0)
    for k in range(500):  # interleaved, as by a writer of message after message
        for name, values in (("gyr", [k, 2.0, 3.0]), ("theta", [0.5 * k])):
            data = b"\0\1\0\0" + np.array(values).tobytes()
            writer.add_message(ids[name], 4_000_000 * k, data, 4_000_000 * k, k)
        writer.add_message(other, k, b"{}", k, k)
    writer.add_attachment(1, 2, "diagram.json", "application/json", b"{}")
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(buffer.getvalue())
    log = read_log(tmp_path / "a.mcap")
    assert log["gyr"].value.tolist() == [[k, 2.0, 3.0] for k in range(500)]
    assert log["theta"].time.tolist() == [k * 4_000_000 / 1e9 for k in range(500)]
    assert log.provenance["ignored"] == {"/camera": 500}
    assert attachments(tmp_path / "a.mcap") == [Attachment("diagram.json", "application/json", b"{}", 2)]


def test_samples_left_out_are_counted(tmp_path: Path) -> None:
    encoder = McapEncoder([stream_of(topic("q"))])
    times = np.array([10, 20, 20, 5, 30, 40], np.uint64) * np.uint64(1_000_000)
    value = np.array([1.0, 2.0, 9.0, 0.0, np.nan, 4.0])[:, None]
    (tmp_path / "a.mcap").write_bytes(encoder.head({}) + encoder.chunk({0: McapSamples(times, value)}) + encoder.tail())
    log = read_log(tmp_path / "a.mcap")
    assert log["q"].time.tolist() == [0.005, 0.01, 0.02, 0.04]
    assert log["q"].value.tolist() == [0.0, 1.0, 2.0, 4.0]
    assert log.provenance["left_out"] == {"q": {"not_finite": 1, "reordered": 1, "repeated": 1}}
