"""MCAP: bit for bit there and back, against the readers of others, and within bounds."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from scipy.io import loadmat

from tests.flightlog.synthetic import attitude_steps, same_bits
from twodof.errors import LogError
from twodof.flightlog.files import attachments, convert, read_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mcap_encoder import MAGIC, Attachment, McapEncoder, McapSamples
from twodof.flightlog.mcap_file import write_mcap
from twodof.flightlog.mcap_stream import ros_names, seconds, stream_of, streams_of
from twodof.signals import TOPICS, topic

pytestmark = pytest.mark.slow

FINITE = st.floats(allow_nan=False, allow_infinity=False)


def test_real_logs_pass_through_mcap_channel_for_channel(flight_data: Path, tmp_path: Path) -> None:
    paths = sorted(flight_data.glob("*.mat"))
    assert len(paths) == 7
    for path in paths[::3]:
        convert(path, tmp_path / "a.mcap", overwrite=True)
        convert(tmp_path / "a.mcap", tmp_path / "b.mat", overwrite=True)
        same_bits(read_log(path), read_log(tmp_path / "b.mat"))
        theirs, ours = loadmat(path, mat_dtype=True), loadmat(tmp_path / "b.mat", mat_dtype=True)
        for name in [name for name in theirs if not name.startswith("__")]:
            for part in theirs[name].dtype.names:
                before, after = theirs[name][0, 0][part], ours[name][0, 0][part]
                assert (before.dtype, before.shape) == (after.dtype, after.shape), (path.name, name, part)
                assert before.tobytes() == after.tobytes(), (path.name, name, part)


def test_a_log_survives_a_tour_of_all_formats(tmp_path: Path) -> None:
    log = attitude_steps()
    write_mcap(log, tmp_path / "a.mcap")
    for source, target in [("a.mcap", "b.parquet"), ("b.parquet", "c.mcap"), ("c.mcap", "d.csv"), ("d.csv", "e.mcap")]:
        convert(tmp_path / source, tmp_path / target, overwrite=True)
    back = read_log(tmp_path / "e.mcap")
    same_bits(log, back)
    assert [one["name"] for one in back.provenance["history"]] == ["a.mcap", "b.parquet", "c.mcap", "d.csv"]


@settings(max_examples=40)
@given(st.data())
def test_any_channels_round_trip(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    sizes = data.draw(st.dictionaries(st.text(min_size=1, max_size=9), st.integers(0, 9), min_size=1, max_size=4))
    channels = {}
    for name, n in sizes.items():
        steps = arrays(float, n, elements=st.floats(1e-6, 1e6))
        width = data.draw(st.integers(1, 3))
        value = data.draw(arrays(float, (n, width), elements=FINITE))
        fields = data.draw(st.sampled_from([(), tuple(f"f {k}" for k in range(width))]))
        channels[name] = Channel(np.cumsum(data.draw(steps)), value, data.draw(st.text(max_size=5)), fields)
    path = tmp_path_factory.getbasetemp() / "any.mcap"
    log = FlightLog(channels)
    write_mcap(log, path)
    same_bits(log, read_log(path))


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
    for channels in ({"w": Channel([0.0], np.zeros((1, 1001)))}, {f"c{k}": Channel([], []) for k in range(1001)}):
        with pytest.raises(LogError, match="at most 1000"):
            write_mcap(FlightLog(channels), tmp_path / "b.mcap")


def test_schemas_name_units() -> None:
    assert stream_of(topic("imu.gyro")).definition.splitlines()[1:] == [f"float64 {axis}  # rad/s" for axis in "xyz"]
    assert ros_names(("M", "enableM", "openloop", "2nd", "a b", "a_b", "time")) == [
        *("m", "enable_m", "openloop", "f_2nd", "a_b", "a_b_5", "time_6")
    ]
    assert {stream_of(row).topic for row in TOPICS} == {"/" + row.name.replace(".", "/") for row in TOPICS}


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
    writer.add_attachment(
        1,
        2,  # created, logged
        "diagram.json",
        "application/json",
        b"{}",
    )
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(buffer.getvalue())
    log = read_log(tmp_path / "a.mcap")
    assert log["gyr"].value.tolist() == [[k, 2.0, 3.0] for k in range(500)]
    assert log["theta"].time.tolist() == [k * 4_000_000 / 1e9 for k in range(500)]
    assert log.provenance["ignored"] == {"/camera": 500}
    assert attachments(tmp_path / "a.mcap") == [Attachment("diagram.json", "application/json", b"{}", 2)]


def test_what_a_channel_cannot_hold_is_left_out_and_counted(tmp_path: Path) -> None:
    encoder = McapEncoder([stream_of(topic("q"))])
    times = np.array([10, 20, 20, 5, 30, 40], np.uint64) * np.uint64(1_000_000)
    value = np.array([1.0, 2.0, 9.0, 0.0, np.nan, 4.0])[:, None]
    (tmp_path / "a.mcap").write_bytes(encoder.head({}) + encoder.chunk({0: McapSamples(times, value)}) + encoder.tail())
    log = read_log(tmp_path / "a.mcap")
    assert log["q"].time.tolist() == [0.005, 0.01, 0.02, 0.04]
    assert log["q"].value.tolist() == [0.0, 1.0, 2.0, 4.0]
    assert log.provenance["left_out"] == {"q": {"not_finite": 1, "reordered": 1, "repeated": 1}}


def test_foreign_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    buffer = BytesIO()
    writer = Writer(buffer)
    writer.start()
    writer.add_message(writer.register_channel("/camera", "json", 0), 1, b"{}", 1)
    writer.finish()
    for content, says in [
        (b"", "the file is empty"),
        (b"PK\3\4" + bytes(100), "is no MCAP file"),
        (MAGIC, "was not closed"),
        (MAGIC + b"\x06" + b"\xff" * 8, "promises 18446744073709551615 bytes"),
        (buffer.getvalue(), "no topic of a flight log is in it; topics: /camera"),
        (buffer.getvalue() + b"x", "goes on after its end"),
    ]:
        path.write_bytes(content)
        with pytest.raises(LogError, match=says):
            read_log(path)
    with pytest.raises(LogError, match="MCAP counts from 0"):
        write_mcap(FlightLog({"q": Channel([-1.0], [0.0])}), path)
