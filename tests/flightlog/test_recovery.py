"""Recovery: after a power cut, on a damaged disk or after a vandal, what was acknowledged is there, and only that."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader

from tests.flightlog.recording_child import PERIOD_NS, gyro
from twodof.cli.app import run
from twodof.errors import LogError
from twodof.flightlog.files import read_log
from twodof.flightlog.mcap_decoder import McapContents, scan
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.recorder import Recorder

pytestmark = pytest.mark.slow

STEP = 5  # samples in a chunk


def record(path: Path, chunks: int) -> tuple[bytes, list[tuple[int, int]]]:
    """A closed recording, and (bytes, samples) of everything that was acknowledged."""
    with Recorder(path, ["imu.gyro"], {"seed": 5}) as recorder:
        acknowledged = [recorder.acknowledged]
        for block in range(chunks):
            k = np.arange(STEP * block, STEP * (block + 1))
            recorder.write_many("imu.gyro", PERIOD_NS * k, gyro(k))
            acknowledged.append(recorder.flush())
    return path.read_bytes(), [(one.position, one.samples) for one in acknowledged]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[tuple[int, int]]]:
    """Of 14 chunks."""
    return record(tmp_path_factory.mktemp("recording") / "a.mcap", 14)


def numbers(contents: McapContents) -> list[int]:
    """Which samples were found, each of them checked to the bit."""
    if not contents.streams:
        return []
    some = contents.joined(1)
    k = (some.time_ns // PERIOD_NS).astype(int)
    assert (some.time_ns == (PERIOD_NS * k).astype(np.uint64)).all()
    assert some.value.tobytes() == gyro(k).tobytes()
    return k.tolist()


@pytest.mark.long
@pytest.mark.parametrize("chunks", [2, pytest.param(14, marks=pytest.mark.soak)])
def test_cut_at_every_byte(chunks: int, tmp_path: Path) -> None:
    whole, acknowledged = record(tmp_path / "a.mcap", chunks)
    for size in range(acknowledged[0][0], len(whole) + 1):
        contents = scan(whole[:size], "cut.mcap", salvage=True)
        expected = max(samples for position, samples in acknowledged if position <= size)
        found = numbers(contents)
        # A chunk may be whole before its index is: then it is there although nobody was told.
        assert found in (list(range(expected)), list(range(expected + STEP))), size
        assert contents.finished == (size == len(whole))
        if size < len(whole):
            with pytest.raises(LogError, match=r"cut\.mcap"):
                scan(whole[:size], "cut.mcap")


def test_cut_head_is_refused(recording: tuple[bytes, list[tuple[int, int]]], tmp_path: Path) -> None:
    whole, acknowledged = recording
    path = tmp_path / "a.mcap"
    for size in [*range(0, acknowledged[0][0], 5), acknowledged[0][0]]:
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"a\.mcap"):
            recover(path)


TAILS = {
    "zeros, as ext4 leaves them": bytes(3000),
    "ones": b"\xff" * 3000,
    "noise": np.random.default_rng(3).bytes(3000),
    "heads of records": b"\x06" + (500).to_bytes(8, "little") + bytes(400),
    "fake chunks": (
        b"\x06" + (90).to_bytes(8, "little") + bytes(16) + b"\x4d" + bytes(11) + b"\4\0\0\0zstd" + bytes(54)
    )
    * 20,
    "the file again": b"again",
}


@pytest.mark.parametrize("name", TAILS)
def test_rubbish_behind_what_was_acknowledged(name: str, recording: tuple[bytes, list[tuple[int, int]]]) -> None:
    whole, acknowledged = recording
    for position, samples in acknowledged:
        for extra in (0, 1, 9, 40, 100):  # the next part had begun to be written
            tail = whole[:2000] if name == "the file again" else TAILS[name]
            contents = scan(whole[: position + extra] + tail, "cut.mcap", salvage=True)
            found = numbers(contents)
            assert found[:samples] == list(range(samples))
            if samples and name != "the file again":
                assert found == list(range(samples))
                assert contents.lost


@pytest.mark.parametrize("rounds", [150, pytest.param(4000, marks=pytest.mark.soak)])
def test_blocks_that_reached_the_disk_in_any_order(rounds: int, recording: tuple[bytes, list[tuple[int, int]]]) -> None:
    """A power cut between two syncs: any block behind the acknowledged byte holds old zeros, noise or new data."""
    whole, acknowledged = recording
    chance = np.random.default_rng(4)
    for _ in range(rounds):
        position, samples = acknowledged[int(chance.integers(len(acknowledged)))]
        data = bytearray(whole[: int(chance.integers(position, len(whole) + 1))])
        block = int(chance.choice([64, 512, 4096]))
        for start in range(position // block * block, len(data), block):
            a, b = max(start, position), min(start + block, len(data))
            kind = chance.integers(3)
            if kind < 2:
                data[a:b] = bytes(b - a) if kind == 0 else chance.bytes(b - a)
        found = numbers(scan(bytes(data), "cut.mcap", salvage=True))
        assert found[:samples] == list(range(samples))
        assert found == sorted(set(found))


def test_damage_in_the_middle_costs_one_chunk(recording: tuple[bytes, list[tuple[int, int]]], tmp_path: Path) -> None:
    whole, acknowledged = recording
    (start, before), (end, after) = acknowledged[6], acknowledged[7]
    for at in range(start, end, 7):
        data = bytearray(whole)
        data[at] ^= 0x55
        contents = scan(bytes(data), "a.mcap", salvage=True)
        found = numbers(contents)
        assert set(range(70)) - set(range(before, after)) <= set(found), at
        with pytest.raises(LogError, match=r"a\.mcap"):
            scan(bytes(data), "a.mcap")
    data = bytearray(whole)
    data[start + 80] ^= 0x55
    (tmp_path / "a.mcap").write_bytes(data)
    found_again = recover(tmp_path / "a.mcap")
    assert found_again.samples == 65
    assert found_again.lost_bytes > 0
    assert "chunk" in found_again.what[0]


def test_what_is_written_is_a_whole_file(recording: tuple[bytes, list[tuple[int, int]]], tmp_path: Path) -> None:
    whole, acknowledged = recording
    for n, (position, samples) in enumerate(acknowledged[1:-1]):
        source, target = tmp_path / f"{n}.mcap", tmp_path / f"{n}-whole.mcap"
        source.write_bytes(whole[: position + 17])
        found = recover(source)
        found.write(target)
        assert found.samples == samples
        assert found.lost_bytes == 17
        for kind in (make_reader, NonSeekingReader):
            with target.open("rb") as file:
                assert sum(1 for _ in kind(file, validate_crcs=True).iter_messages()) == samples
        log = read_log(target)
        assert log.provenance["seed"] == 5
        assert log.provenance["recovered"]["lost_bytes"] == "17"
        assert recover(target).what == ()


def test_the_command(
    recording: tuple[bytes, list[tuple[int, int]]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, acknowledged = recording
    source = tmp_path / "flight.mcap"
    source.write_bytes(whole[: acknowledged[3][0] + 4])
    assert run(["log", "info", str(source)]) == 2
    assert f"twodof log recover {source}\n" in capsys.readouterr().err
    assert run(["log", "recover", str(source)]) == 0
    said = capsys.readouterr().out
    assert "flight.recovered.mcap: 15 samples from 0.000 to 0.056 s" in said
    assert "4 bytes could not be used" in said
    assert len(read_log(tmp_path / "flight.recovered.mcap")["gyr"]) == 15
    assert run(["log", "recover", str(source)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert run(["log", "recover", str(source), str(tmp_path / "b.mcap"), "--json"]) == 0
    assert '"lost_bytes": 4' in capsys.readouterr().out
    for content, says in [
        (b"rubbish" * 100, "is no MCAP file"),
        (whole[: acknowledged[0][0]], "no sample is in it"),
        (b"", "the file is empty"),
    ]:
        source.write_bytes(content)
        assert run(["log", "recover", str(source), str(tmp_path / "c.mcap")]) == 2
        assert says in capsys.readouterr().err
    assert run(["log", "recover", str(tmp_path / "a.mat"), str(tmp_path / "c.mcap")]) == 2
    assert run(["log", "recover", str(source), str(tmp_path / "c.csv")]) == 2
    assert not (tmp_path / "c.mcap").exists()
