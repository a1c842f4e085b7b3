"""A recovered recording holds no false value that nobody was told of: every byte of a file is changed in turn."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.flightlog.test_ulog_file import px4_log
from twodof.cli.app import run
from twodof.errors import LogError
from twodof.flightlog import mcap_encoder, mcap_stream, provenance
from twodof.flightlog.files import attachments, read_log
from twodof.flightlog.mcap_decoder import McapContents, scan
from twodof.flightlog.mcap_encoder import Attachment
from twodof.flightlog.mcap_file import recover, to_log
from twodof.flightlog.recorder import Recorder

pytestmark = pytest.mark.slow

TOPICS = ["imu.gyro", "estimate.theta"]


def record(path: Path) -> bytes:
    with Recorder(
        path, TOPICS, {"seed": 31, "rig": "lab"}, [Attachment("d.json", "application/json", b'{"k": 1}')]
    ) as r:
        for block in range(3):
            for k in range(4 * block, 4 * block + 4):
                r.write("imu.gyro", 4_000_000 * k, (0.1 * k, 0.2, -0.3))
                r.write("estimate.theta", 4_000_000 * k, 0.01 * k)
            r.flush()
        r.note("ended", "landed")
    return path.read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record(tmp_path_factory.mktemp("whole") / "a.mcap")


def cut(whole: bytes) -> bytes:
    """As a crash leaves it: before the end of the data."""
    return whole[: whole.index(b"\x0f\x04\0\0\0\0\0\0\0")]


def told(contents: McapContents) -> list[str]:
    return [*(loss.why for loss in contents.lost), *contents.unverified, *contents.ignored]


def facts(contents: McapContents) -> dict[str, object]:
    """All that a log says but samples, which may be missing."""
    kept = provenance_of(contents)
    channels = {s.topic: (s.mat, s.unit, s.fields, s.width, s.schema, s.about) for s in contents.streams.values()}
    files = [(one.name, one.media_type, one.data, one.time_ns) for one in contents.attachments]
    return {"channels": channels, "provenance": kept, "attachments": files}


def provenance_of(contents: McapContents) -> dict[str, object]:
    log = to_log(contents, {}, "a.mcap")
    return {key: value for key, value in log.provenance.items() if key not in ("file", "ignored")}


def samples(contents: McapContents) -> set[tuple[str, int, bytes]]:
    found = set()
    for number, stream in contents.streams.items():
        some = contents.joined(number)
        found |= {(stream.topic, int(t), v.tobytes()) for t, v in zip(some.time_ns, some.value, strict=True)}
    return found


def silent(data: bytes, changes: Iterator[tuple[int, int]]) -> tuple[list[str], Counter[str]]:
    """Changes after which something false or less is recovered without a word, and what came of all of them."""
    truth = scan(data, "a.mcap", salvage=True)
    expected, every, usual = facts(truth), samples(truth), told(truth)
    found, count = [], Counter[str]()
    for at, value in changes:
        damaged = bytearray(data)
        damaged[at] ^= value
        try:
            contents = scan(bytes(damaged), "a.mcap", salvage=True)
            now = facts(contents)
        except LogError:
            count["refused"] += 1
            continue
        more = told(contents) != usual
        count["named" if more else "not noticed"] += 1
        if not samples(contents) <= every and not contents.unverified:
            found.append(f"byte {at} ^ {value:#x}: false samples")
        elif (now != expected or samples(contents) != every) and not more:
            found.append(f"byte {at} ^ {value:#x}: {[key for key in now if now[key] != expected[key]]}")
    return found, count


@pytest.mark.parametrize("closed", [True, False])
def test_no_byte_is_changed_in_silence(whole: bytes, closed: bool) -> None:
    data = whole if closed else cut(whole)
    chance = np.random.default_rng(2)
    # Each byte of the head, where there is most to get wrong, and some of what follows; in all bits over the file.
    head = data.index(b"\x06", data.index(b"d.json"))
    places = [*range(8, head, 5), *range(head, len(data), 13)]
    found, count = silent(data, ((at, 1 << int(chance.integers(8))) for at in places))
    assert found == []
    assert count["named"] > 100
    # What does not matter (times in an index, the maker's version) may go unnoticed where no checksum of all is there.
    assert not closed or count["not noticed"] == 0


@pytest.mark.soak
@pytest.mark.parametrize("closed", [True, False])
def test_every_bit_of_every_byte(whole: bytes, closed: bool) -> None:
    data = whole if closed else cut(whole)
    places = ((at, value) for at in range(8, len(data)) for value in (*(1 << bit for bit in range(8)), 0xFF, 0x55))
    found, count = silent(data, places)
    assert found == []
    assert not closed or count["not noticed"] == 0


def test_file_and_command_tell_the_findings(whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The unit of the gyro, and the seed."""
    path, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for old, new, says in (
        (b'"rad/s"', b'"rad/x"', "the description of topic '/imu/gyro', whose checksum is wrong"),
        (b'"seed": 31', b'"seed": 91', "table 'twodof', which is kept as table 'twodof.unverified'"),
    ):
        path.write_bytes(whole.replace(old, new, 1) if old in whole else whole.replace(old.replace(b'"', b'\\"'), new))
        with pytest.raises(LogError, match="the checksum"):
            read_log(path)
        target.unlink(missing_ok=True)
        assert run(["log", "recover", str(path), str(target)]) == 1
        assert says in capsys.readouterr().out
        log = read_log(target)
        assert says in log.provenance["recovered"]["unverified"]
        assert says in recover(path).log.provenance["recovered"]["what"]
        assert log.provenance.get("seed") != 91
        target.unlink()
        assert run(["log", "recover", str(path), str(target), "--json"]) == 1
        assert '"unverified": [\n' in capsys.readouterr().out
    assert log.provenance["unverified"][0]["table"] == "twodof"
    assert '"seed": 91' in log.provenance["unverified"][0]["provenance"]
    path.write_bytes(whole)
    target.unlink()
    assert run(["log", "recover", str(path), str(target), "--json"]) == 0
    assert '"unverified": []' in capsys.readouterr().out
    # What was recovered is a whole file of this version: schemas have their names, nothing is in doubt.
    again = recover(target)
    assert (again.what, again.unverified) == ((), ())
    assert [one.data for one in attachments(target)] == [b'{"k": 1}']
    assert facts(scan(target.read_bytes(), "b")) == facts(scan(whole, "a"))


def test_files_of_earlier_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They had no checksums of tables and descriptions: they are read, and recovery says so."""
    monkeypatch.setattr(mcap_encoder, "sealed", lambda record: record)
    own = mcap_stream.McapStream.metadata.fget
    assert own is not None

    def metadata(stream: mcap_stream.McapStream) -> dict[str, str]:
        return {key: text.split(', "schema"')[0] + "}" for key, text in own(stream).items()}

    monkeypatch.setattr(mcap_stream.McapStream, "metadata", property(metadata))
    old = record(tmp_path / "old.mcap")
    assert b"crc32" not in old
    monkeypatch.undo()
    log = read_log(tmp_path / "old.mcap")
    assert (log.provenance["seed"], log["gyr"].unit, len(log["theta"])) == (31, "rad/s", 12)
    closed = recover(tmp_path / "old.mcap")
    assert (closed.what, closed.unverified) == ((), ())
    assert next(iter(scan(closed.file, "a").streams.values())).schema == "twodof_msgs/msg/ImuGyro"
    (tmp_path / "cut.mcap").write_bytes(cut(old))
    broken = recover(tmp_path / "cut.mcap")
    assert broken.samples == 24
    assert "no checksum vouches for the description of topic '/imu/gyro'" in broken.unverified[0]
    assert "table 'twodof'" in broken.unverified[0]


def test_a_log_without_checksums_says_so(tmp_path: Path) -> None:
    (tmp_path / "a.ulg").write_bytes(px4_log())
    found = recover(tmp_path / "a.ulg")
    assert found.unverified == ("every value: a ULog has no checksums",)
    assert found.log.provenance["recovered"]["unverified"] == found.unverified[0]


def test_measure_finds_false_values(whole: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without checksums of tables and descriptions, as before, false values come through."""
    monkeypatch.setattr("twodof.flightlog.mcap_decoder._unsealed", lambda record, _: (record, True))
    found, _ = silent(cut(whole), ((at, 1) for at in range(8, whole.index(b"d.json"), 3)))
    assert len(found) > 10


def test_the_provenance_is_bounded() -> None:
    with pytest.raises(LogError, match="nested over 32 deep"):
        provenance.from_json('{"a": ' + "[" * 40 + "]" * 40 + "}", "a")
