"""The drone's .mat layout: bit for bit there and back, against scipy's reader, and through damage."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import loadmat, savemat

from tests.flightlog.synthetic import attitude_steps, channel, same_bits
from twodof.errors import LogError
from twodof.flightlog.files import read_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mat_file import write_mat

pytestmark = pytest.mark.slow

FINITE = st.floats(allow_nan=False, allow_infinity=False)


def struct(n: int = 5, **parts: Any) -> dict[str, Any]:
    return {"timestamp": np.arange(n, dtype=float)[:, None], "value": np.zeros((n, 1)), **parts}


def test_synthetic_log_round_trips_to_the_bit(tmp_path: Path) -> None:
    log = attitude_steps()
    write_mat(log, tmp_path / "a.mat")
    back = read_log(tmp_path / "a.mat")
    same_bits(log, back)
    assert back.provenance["seed"] == 1
    assert back.provenance["rig"] == "synthetic"
    assert len(back.provenance["file"]["sha256"]) == 64
    write_mat(back, tmp_path / "b.mat")
    again = read_log(tmp_path / "b.mat")
    same_bits(log, again)
    assert again.provenance["history"] == [back.provenance["file"]]


@pytest.mark.long
def test_real_logs_round_trip_to_the_bit(flight_data: Path, tmp_path: Path) -> None:
    paths = sorted(flight_data.glob("*.mat"))
    assert len(paths) == 7
    for path in paths:
        log = read_log(path)
        write_mat(log, tmp_path / path.name)
        same_bits(log, read_log(tmp_path / path.name))
        theirs = loadmat(path, mat_dtype=True)
        ours = loadmat(tmp_path / path.name, mat_dtype=True)
        names = [name for name in theirs if not name.startswith("__")]
        assert [name for name in ours if not name.startswith("__")] == [*names, "provenance"]
        for name in names:
            assert theirs[name].dtype == ours[name].dtype
            for part in theirs[name].dtype.names:
                before, after = theirs[name][0, 0][part], ours[name][0, 0][part]
                assert before.dtype == after.dtype, (path.name, name, part)
                assert before.shape == after.shape
                assert before.tobytes() == after.tobytes()


@pytest.mark.long
@settings(max_examples=30)
@given(
    st.dictionaries(st.from_regex(r"[A-Za-z]\w{0,8}", fullmatch=True).filter(str.isascii), st.integers(0, 9)),
    st.data(),
)
def test_any_channels_round_trip(tmp_path_factory: pytest.TempPathFactory, sizes: dict[str, int], data: Any) -> None:
    reserved = {"acc", "gyr", "lmnf", "provenance"}
    channels = {}
    for name, n in {"q": 3, **sizes}.items():
        if name not in reserved:
            time = np.cumsum(data.draw(arrays(float, n, elements=st.floats(1e-6, 1e6))))
            channels[name] = Channel(time, data.draw(arrays(float, n, elements=FINITE)), name=name)
    path = tmp_path_factory.getbasetemp() / "any.mat"
    log = FlightLog(channels)
    write_mat(log, path)
    back = read_log(path)
    assert list(back) == list(log)
    for name in log:
        assert back[name].time.tobytes() == log[name].time.tobytes()
        assert back[name].value.tobytes() == log[name].value.tobytes()


def test_reads_integers_big_endian_and_uncompressed(tmp_path: Path) -> None:
    content = {"T": struct(value=np.arange(5, dtype=np.uint8)[:, None]), "q": struct(value=np.ones((1, 5)))}
    savemat(tmp_path / "a.mat", content)
    log = read_log(tmp_path / "a.mat")
    assert log["T"].value.tolist() == [0, 1, 2, 3, 4]
    assert (log["T"].unit, log["q"].unit) == ("-", "rad/s")
    assert log["q"].value.tolist() == [1] * 5


def test_one_sample_of_three_axes(tmp_path: Path) -> None:
    log = FlightLog({"acc": channel("acc", np.array([1.0]), np.array([[1.0, 2.0, 3.0]]))})
    write_mat(log, tmp_path / "a.mat")
    same_bits(log, read_log(tmp_path / "a.mat"))


def test_a_cut_file_says_so_wherever_it_is_cut(tmp_path: Path) -> None:
    write_mat(attitude_steps(), tmp_path / "whole.mat")
    whole = (tmp_path / "whole.mat").read_bytes()
    path = tmp_path / "cut.mat"
    ends = _variable_ends(whole)
    for size in sorted({*range(0, 200, 7), *np.linspace(1, len(whole) - 1, 150, dtype=int).tolist()}):
        path.write_bytes(whole[:size])
        if size in ends:
            continue  # a file of fewer variables is a whole file
        with pytest.raises(LogError) as caught:
            read_log(path)
        assert "cut.mat" in str(caught.value)


def _variable_ends(data: bytes) -> set[int]:
    ends, at = set(), 128
    while at < len(data):
        at += 8 + int.from_bytes(data[at + 4 : at + 8], "little")
        ends.add(at)
    return ends


@given(st.data())
def test_damage_is_a_log_error_or_a_valid_log(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    base = tmp_path_factory.getbasetemp()
    whole = base / "fuzz-whole.mat"
    compress = data.draw(st.booleans())
    savemat(whole, {"q": struct(), "T": struct(3), "note": "text"}, do_compression=compress)
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = base / "fuzz.mat"
    path.write_bytes(content)
    try:
        log = read_log(path)
    except LogError as reason:
        said = str(reason)
    else:
        said = "fuzz.mat"
        assert all(np.isfinite(log[name].value).all() for name in log)
    assert "fuzz.mat" in said


def test_foreign_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    for content, says in [
        (b"", "the file is empty"),
        (b"PK\x03\x04" + bytes(500), "is not a MATLAB v5 file"),
        (b"MATLAB 7.3 MAT-file" + bytes(500), "v7.3 .HDF5. file .save it in MATLAB with save"),
        (b"\x89HDF\r\n\x1a\n" + bytes(500), "HDF5"),
        (bytes(124) + b"\x00\x02IM" + bytes(8), "unknown MAT-file version"),
        (bytes(124) + b"\x00\x01IM" + b"\x63\x00\x00\x00\x00\x00\x00\x00", "is truncated or damaged"),
    ]:
        path.write_bytes(content)
        with pytest.raises(LogError, match=says):
            read_log(path)
    with pytest.raises(LogError, match="cannot be read: No such file"):
        read_log(tmp_path / "none.mat")
    savemat(path, {"A": np.eye(3), "name": "x"})
    with pytest.raises(LogError, match=r"no struct \{timestamp, value\} in the file, which holds: A, name"):
        read_log(path)


def test_absurd_dimensions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"q": struct(value=np.arange(5, dtype=float)[:, None] + 0.5)})
    content = path.read_bytes()
    dims = np.array([5, 1], dtype="<i4").tobytes()
    assert content.count(dims) == 2
    path.write_bytes(content.replace(dims, np.array([2**31 - 1, 2**20], dtype="<i4").tobytes()))
    with pytest.raises(LogError, match=r"a\.mat"):
        read_log(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"q": np.zeros(3)}, "channel 'q' is not a struct"),
        ({"q": {"timestamp": np.arange(3.0)}}, "channel 'q' is not a struct"),
        ({"q": struct(value=np.zeros((4, 1)))}, "4 samples for 5 time stamps"),
        ({"q": struct(value=np.zeros((5, 2)))}, "2 columns where 'q' has 1"),
        ({"q": struct(value=np.full((5, 1), np.nan))}, "value is nan at sample 0"),
        ({"q": struct(timestamp=np.array([[0.0], [1], [1], [2], [3]]))}, "time does not increase: sample 2"),
        ({"q": struct(timestamp=np.ones((5, 2)))}, "timestamp is .5, 2., not a column"),
        ({"q": struct(value=np.ones((5, 1)) * 1j)}, "channel 'q' is not a struct"),
        ({"q": struct(value="text")}, "channel 'q' is not a struct"),
        ({"lmnf": struct()}, "expected M, T, openloop"),
        ({"q": struct(), "provenance": "no json"}, "provenance kept in the file is not JSON"),
        ({"q": struct(), "provenance": "[1]"}, "not a table of entries"),
    ],
)
def test_wrong_channels_say_what_and_where(tmp_path: Path, content: dict[str, Any], says: str) -> None:
    savemat(tmp_path / "a.mat", content)
    with pytest.raises(LogError, match=says) as caught:
        read_log(tmp_path / "a.mat")
    assert "a.mat" in str(caught.value)


def test_what_is_no_channel_is_named_as_ignored(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"q": struct(), "A": np.eye(2), "who": "me", "odd": {"a": 1.0}})
    assert read_log(tmp_path / "a.mat").provenance["ignored"] == ["A", "who", "odd"]


def test_names_that_matlab_lacks_are_refused_and_nothing_is_written(tmp_path: Path) -> None:
    for name in ("2fast", "a b", "provenance", "x" * 64):
        with pytest.raises(LogError, match="cannot name a MATLAB variable"):
            write_mat(FlightLog({name: Channel([0.0], [1.0])}), tmp_path / "a.mat")
    with pytest.raises(LogError, match="provenance is not JSON"):
        write_mat(FlightLog({"q": Channel([0.0], [1.0])}, {"rig": object()}), tmp_path / "a.mat")
    assert list(tmp_path.iterdir()) == []
