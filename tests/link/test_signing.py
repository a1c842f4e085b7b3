"""Signing: a differential against pymavlink, keys kept safe, and no stamp accepted twice."""

import asyncio
import copy
import errno
import hashlib
import json
import logging
import os
import pickle
import stat
import tempfile
from pathlib import Path
from typing import Any

import pytest
from fastcrc import crc16
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from tests.faults.virtual_time import on_virtual_time
from tests.link.ends import SOON, in_loop, port
from twodof.errors import LinkError
from twodof.link import signing as signing_module
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Frame, Parser, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import (
    HIGHEST,
    OWN,
    PER_SECOND,
    Key,
    Signing,
    SigningVerdict,
    Stamps,
    read_key,
    wall_stamp,
    write_key,
)
from twodof.link.transport import open_transport
from twodof.link.transport.base import memory_pair

pytestmark = pytest.mark.slow

KEY = Key(bytes(range(32)))
START = 11 * 365 * 24 * 3600 * PER_SECOND


class Clock:
    """A clock that is set by hand."""

    def __init__(self, now: int = START) -> None:
        self.now = now

    def __call__(self) -> int:
        return self.now


def signing(key: Key = KEY, clock: Clock | None = None, path: Path | None = None, link: int = 0) -> Signing:
    """One side of a signed link."""
    return Signing(key, Stamps(path, clock or Clock()), link)


def signed(by: Signing, sequence: int = 0, system: int = 1) -> Frame:
    """A signed command, as it is received."""
    return frame_of(encode(message("COMMAND_LONG", command=400, param1=1.0), system, 1, sequence, by.outgoing()))


def frame_of(raw: bytes) -> Frame:
    """The one frame in some bytes."""
    (frame,) = Parser().feed(raw)
    return frame


def pymavlink(key: Key = KEY, now: int = START) -> Any:
    """pymavlink's own signing end."""
    mav = dialect.load().MAVLink(None, 1, 1)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = key.secret, True, now
    return mav


class Receiver(RuleBasedStateMachine):
    """One receiver with a file of stamps, that crashes and restarts, and two senders; all clocks jump."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.clocks = [Clock() for _ in range(3)]
        self.senders = [signing(clock=clock, link=link) for link, clock in enumerate(self.clocks[:2])]
        self.sent: list[Frame] = []
        self.accepted: set[bytes] = set()
        self.used: list[int] = []
        self.start()

    def start(self) -> None:
        """Begin a run."""
        self.mine = signing(clock=self.clocks[2], path=Path(self.folder.name) / "stamps", link=9)

    def take(self, frame: Frame) -> SigningVerdict:
        """Check a frame; no frame is accepted twice."""
        verdict = self.mine.check(frame)
        if verdict is SigningVerdict.ACCEPTED:
            assert frame.raw not in self.accepted
            self.accepted.add(frame.raw)
        return verdict

    def sign(self) -> Frame:
        """Sign a frame; no stamp is used twice."""
        frame = signed(self.mine, system=7)
        stamp = int.from_bytes(frame.raw[-12:-6], "little")
        assert stamp > max(self.used, default=0)
        self.used.append(stamp)
        return frame

    @rule(sender=st.integers(0, 1))
    def send(self, sender: int) -> None:
        """A frame of a sender arrives."""
        self.sent.append(signed(self.senders[sender]))
        self.take(self.sent[-1])

    @precondition(lambda self: self.sent)
    @rule(data=st.data())
    def replay(self, data: st.DataObject) -> None:
        """Any earlier frame arrives again."""
        self.take(data.draw(st.sampled_from(self.sent)))

    @rule(sender=st.integers(0, 1))
    def talk(self, sender: int) -> None:
        """A sender that hears the receiver is accepted, unless one clock is more than a year ahead."""
        verdict = self.senders[sender].check(self.sign())
        self.sent.append(signed(self.senders[sender]))
        if verdict is SigningVerdict.ACCEPTED:
            assert self.take(self.sent[-1]) in (SigningVerdict.ACCEPTED, SigningVerdict.AHEAD)

    @rule(clock=st.integers(0, 2), jump=st.sampled_from([-400, -1, 1, 300, 400]), unit=st.sampled_from([1, 60, 86_400]))
    def jump(self, clock: int, jump: int, unit: int) -> None:
        """A clock is set."""
        self.clocks[clock].now = max(0, self.clocks[clock].now + jump * unit * PER_SECOND)

    @rule(crash=st.booleans())
    def restart(self, crash: bool) -> None:
        """The receiver ends, by itself or killed."""
        if crash:
            kill(self.mine.stamps)
        else:
            self.mine.close()
        self.start()

    def teardown(self) -> None:
        """Free the file."""
        kill(self.mine.stamps)
        self.folder.cleanup()


TestStamps = Receiver.TestCase
TestStamps.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)


def kill(stamps: Stamps) -> None:
    """Free what the system frees of a killed process; nothing more is written."""
    os.close(stamps._lock)
    assert stamps._pool is not None
    stamps._pool.shutdown(cancel_futures=True)


def test_pymavlink_takes_what_we_sign_and_we_what_it_signs() -> None:
    ours, theirs = signing(), pymavlink()
    for _ in range(5):
        got = theirs.decode(bytearray(signed(ours).raw))
        assert got.get_signed()
        assert ours.check(frame_of(bytes(message("HEARTBEAT").pack(theirs)))) is SigningVerdict.ACCEPTED
    assert theirs.signing.badsig_count == 0
    assert ours.counts[SigningVerdict.ACCEPTED] == 5


def test_the_signature_is_the_published_one() -> None:
    # First 6 bytes of SHA-256 over key, packet, link id and stamp; computed by hand of the definition.
    raw = signed(signing(link=5)).raw
    assert raw[-13] == 5
    assert int.from_bytes(raw[-12:-6], "little") == START
    assert raw[-6:] == hashlib.sha256(KEY.secret + raw[:-6]).digest()[:6]


def test_unsigned_is_refused_a_radios_own_word_too() -> None:
    mine = signing()
    assert mine.check(frame_of(encode(message("COMMAND_LONG", command=400), 1, 1, 0))) is SigningVerdict.UNSIGNED
    assert mine.check(frame_of(encode(message("RADIO_STATUS", rssi=9), 51, 68, 0))) is SigningVerdict.UNSIGNED
    old = bytes(message("COMMAND_LONG", command=400).pack(dialect.load().MAVLink(None, 1, 1), force_mavlink1=True))
    assert mine.check(frame_of(old)) is SigningVerdict.UNSIGNED
    assert (mine.counts[SigningVerdict.UNSIGNED], mine.refused) == (3, 3)


def test_every_changed_bit_is_seen() -> None:
    raw = signed(signing()).raw
    mine = signing()
    kind = dialect.classes()["COMMAND_LONG"]
    for place in range(8 * 3, 8 * len(raw)):  # the marker, length and flags decide what a frame is
        bad = bytearray(raw)
        bad[place // 8] ^= 1 << place % 8
        if place // 8 < len(raw) - 15:
            # A forger mends the checksum, which needs no key.
            bad[-15:-13] = crc16.mcrf4xx(bytes(bad[1:-15]) + bytes([kind.crc_extra])).to_bytes(2, "little")
        found = Parser().feed(bytes(bad), whole=True)
        for frame in found:
            assert mine.check(frame) in (SigningVerdict.FORGED, SigningVerdict.UNSIGNED), place
    assert mine.counts[SigningVerdict.ACCEPTED] == 0
    assert mine.check(frame_of(raw)) is SigningVerdict.ACCEPTED  # none of the forgeries spoilt the true one


def test_a_peer_may_be_a_year_ahead_and_all_follow() -> None:
    """Frames refused for a wrong clock could be replayed later, so that few are refused."""
    day = 24 * 3600 * PER_SECOND
    mine, clock = signing(), Clock(START + 364 * day)
    wrong = signing(clock=clock)
    assert mine.check(signed(signing(clock=Clock(START + 366 * day)))) is SigningVerdict.AHEAD
    early = signed(signing(clock=Clock(START + 2 * day)), system=9)
    assert mine.check(signed(wrong, system=8)) is SigningVerdict.ACCEPTED
    assert mine.stamps.own == wrong.stamps.own
    assert mine.check(early) is SigningVerdict.STALE  # from now on, and for good
    # Its time goes on, beyond a year ahead of ours, which stands still.
    for _ in range(2000):
        clock.now += 60 * PER_SECOND
        assert mine.check(signed(wrong, system=8)) is SigningVerdict.ACCEPTED


@pytest.mark.parametrize("before", [False, True])
@in_loop
async def test_who_has_a_time_of_before_catches_up_by_what_it_is_told(before: bool) -> None:
    """Over UDP nobody is sent to before it was accepted; who signs rightly is told our time nevertheless."""
    day = 24 * 3600 * PER_SECOND
    there = await open_transport("udpin://:0")
    here = await open_transport(f"udp://127.0.0.1:{port(there)}")
    mine, theirs = signing(), signing()
    beat = message("HEARTBEAT", type=6, autopilot=8)
    async with Connection(there, 1, 1, mine) as drone, Connection(here, 9, 190, theirs) as client:
        # Somebody whose clock was ahead has set the time for all; `before`: in the client's own name.
        frame = frame_of(
            encode(beat, *((9, 190) if before else (8, 190)), 0, signing(clock=Clock(START + 5 * day)).outgoing())
        )
        assert mine.check(frame) is SigningVerdict.ACCEPTED
        client.send(beat)
        while not mine.refused:
            assert await drone.receive(0.01) is None
        assert (mine.counts[SigningVerdict.REPEATED], mine.counts[SigningVerdict.STALE]) == (
            (1, 0) if before else (0, 1)
        )
        assert there.peers == ()
        while not theirs.counts[SigningVerdict.ACCEPTED]:  # it hears our question about time, and answers it by itself
            assert await client.receive(0.01) is None
        client.send(beat)
        found = await drone.receive(SOON)
        assert found is not None
        assert found.message.get_type() == "HEARTBEAT"
        assert len(there.peers) == 1


@on_virtual_time
async def test_replayed_packets_are_answered_seldom_and_give_nobody_a_place() -> None:
    here, there = memory_pair()
    loop = asyncio.get_running_loop()
    mine, theirs = signing(), signing()
    async with Connection(there, 1, 1, mine, loop.time) as drone:
        raw = encode(message("HEARTBEAT"), 9, 190, 0, theirs.outgoing())
        here.send(raw)
        assert await drone.receive(0.0) is not None
        for _ in range(100):
            here.send(raw)
            assert await drone.receive(0.01) is None
        assert mine.counts[SigningVerdict.REPEATED] == 100
        answers = 0
        while here.receive_now() is not None:
            answers += 1
        assert 1 <= answers <= 11  # in a second


def test_streams_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twodof.link.signing.MOST_STREAMS", 5)
    mine = signing()
    verdicts = [mine.check(signed(signing(), system=system)) for system in range(1, 9)]
    assert verdicts == [SigningVerdict.ACCEPTED] * 5 + [SigningVerdict.STALE] * 3
    assert mine.check(signed(signing(clock=Clock(START + 1)), system=1)) is SigningVerdict.ACCEPTED  # those known go on


def test_a_packet_does_not_cost_a_write(tmp_path: Path) -> None:
    path, clock = tmp_path / "stamps", Clock()
    with_store = signing(clock=clock, path=path)
    written = set()
    for _ in range(5000):  # 20 s of packets at 250 Hz
        clock.now += PER_SECOND // 250
        with_store.outgoing()
        written.add(path.stat().st_ino)  # an atomic write is another file
    assert 2 <= len(written) <= 8
    assert json.loads(path.read_text())[OWN] > clock.now
    with_store.close()
    assert json.loads(path.read_text())[OWN] == with_store.stamps.own


def test_the_clock_of_stamps_is_the_published_one(monkeypatch: pytest.MonkeyPatch) -> None:
    # 2015-01-01 00:00:00 UTC is 1420070400; a unit is 10 us.
    monkeypatch.setattr("twodof.link.signing.time.time", lambda: 1_420_070_400 + 3.00002)
    assert wall_stamp() == 300_002
    monkeypatch.setattr("twodof.link.signing.time.time", lambda: 0.0)
    assert wall_stamp() == 0


def test_two_processes_do_not_share_stamps(tmp_path: Path) -> None:
    first = Stamps(tmp_path / "stamps")
    with pytest.raises(LinkError, match="another process signs with these time stamps"):
        Stamps(tmp_path / "stamps")
    first.close()
    Stamps(tmp_path / "stamps").close()


def test_a_key_in_a_file_of_its_owner_only(tmp_path: Path) -> None:
    path, key = tmp_path / "key", Key.fresh()
    write_key(path, key)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert read_key(path).secret == key.secret
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())  # as Notepad saves it
    assert read_key(path).secret == key.secret
    with pytest.raises(LinkError, match="is there already"):
        write_key(path, key)
    for mode in (0o640, 0o604, 0o620, 0o666):
        path.chmod(mode)
        with pytest.raises(LinkError, match=f"mode {mode:04o}.*chmod 600"):
            read_key(path)


def test_half_a_key_is_not_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(LinkError, match="No space left"):
        write_key(tmp_path / "key", KEY)
    assert [*tmp_path.iterdir()] == []


def test_what_is_no_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "key"
    with pytest.raises(LinkError, match="cannot be read"):
        read_key(path)
    os.mkfifo(tmp_path / "fifo", 0o600)
    with pytest.raises(LinkError, match="is not a file"):
        read_key(tmp_path / "fifo")  # and it does not wait for a writer
    for text in ("", "secret", "0" * 63, "0" * 64 + "zz", "x" * 10_000):
        path.write_text(text)
        path.chmod(0o600)
        with pytest.raises(LinkError, match="holds no key") as caught:
            read_key(path)
        assert text[:6] not in str(caught.value) or not text
    with pytest.raises(LinkError, match="is easily guessed"):
        Key.of("elevenchars")
    assert Key.of("twelve chars").secret == hashlib.sha256(b"twelve chars").digest()
    for secret in (bytes(31), bytes(33), "0" * 32):
        with pytest.raises(LinkError, match="has 32 bytes"):
            Key(secret)
    assert Key.of("correct horse battery").secret != Key.of("correct horse batterz").secret


def test_a_key_shows_nowhere(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    mine = signing()
    mine.check(signed(signing()))
    shown = f"{mine!r} {mine.key} {mine.outgoing()!r} {vars(mine)} {caplog.text}"
    for form in (KEY.secret.hex(), repr(KEY.secret), repr(list(KEY.secret))):
        assert form not in shown
    assert KEY.fingerprint in repr(mine)
    with pytest.raises(TypeError, match="cannot be pickled"):
        pickle.dumps(KEY)
    with pytest.raises(TypeError, match="cannot be pickled"):
        copy.copy(KEY)


def test_a_file_of_stamps_by_stream_is_read(tmp_path: Path) -> None:
    """As earlier versions wrote it."""
    path = tmp_path / "stamps"
    path.write_text(json.dumps({"own": START, "1:255:190": START + 5}))
    mine, theirs = signing(path=path), signing(clock=Clock(START + 5))
    assert mine.check(signed(theirs)) is SigningVerdict.REPEATED
    assert mine.check(signed(theirs)) is SigningVerdict.ACCEPTED
    mine.close()
    assert json.loads(path.read_text()) == {"own": START + 6}


@pytest.mark.parametrize("behind", [0, 1])
def test_a_new_stream_may_be_a_minute_behind(behind: int) -> None:
    theirs = signing(clock=Clock(START - 60 * PER_SECOND - behind))
    expected = SigningVerdict.STALE if behind else SigningVerdict.ACCEPTED
    assert signing().check(signed(theirs)) is expected


def test_streams_do_not_disturb_each_other() -> None:
    mine, early = signing(), Clock()
    for other in (
        signed(signing(clock=Clock(START + 1000), link=1)),
        signed(signing(clock=early, link=2)),
        signed(signing(clock=early, link=2), system=9),
    ):
        assert mine.check(other) is SigningVerdict.ACCEPTED
    assert mine.check(signed(signing(clock=early, link=1))) is SigningVerdict.REPEATED


def test_a_clock_that_stands_at_1970_judges_nobody_and_catches_up() -> None:
    drone, ground = signing(clock=Clock(0)), signing()
    assert ground.check(signed(drone)) is SigningVerdict.STALE
    assert drone.check(signed(ground, system=255)) is SigningVerdict.ACCEPTED
    assert ground.check(signed(drone)) is SigningVerdict.ACCEPTED


@in_loop
async def test_without_stamps_left_no_question_is_answered_and_nothing_ends() -> None:
    here, there = memory_pair()
    mine, theirs = signing(clock=Clock(0)), signing(clock=Clock(HIGHEST - 10))
    async with Connection(there, 1, 1, mine) as drone:
        mine.stamps.accept("another", HIGHEST)
        for asked in ("PING", "HEARTBEAT"):
            here.send(encode(message(asked), 9, 190, 0, theirs.outgoing()))
        found = await drone.receive(SOON)
        assert found is not None
        assert found.message.get_type() == "HEARTBEAT"
        assert here.receive_now() is None


def test_used_up_stamps_are_an_error() -> None:
    stamps = Stamps(None, lambda: HIGHEST)
    assert stamps.next_own() == HIGHEST == 2**48 - 1
    with pytest.raises(LinkError, match="used up"):
        stamps.next_own()


def test_unsafe_files_of_stamps_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "stamps"
    path.write_text('{"own": 5}')
    for mode in (0o620, 0o602, 0o666):
        path.chmod(mode)
        with pytest.raises(LinkError, match=f"others may write the time stamps.*{mode:04o}.*chmod 600"):
            Stamps(path)
    path.chmod(0o644)  # they are no secret
    Stamps(path).close()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(LinkError, match="time stamps cannot be read"):
        Stamps(tmp_path / "loop")
    os.mkfifo(tmp_path / "fifo", 0o600)
    with pytest.raises(LinkError, match="time stamps: is not a file"):  # and nobody waits for a writer
        Stamps(tmp_path / "fifo")
    (tmp_path / "linked.lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(LinkError, match="cannot be locked"):
        Stamps(tmp_path / "linked")
    assert not (tmp_path / "elsewhere").exists()
    for text in ("", "[]", '{"own": -1}', '{"own": 1e3}', '{"own": true}', "{" * 50_000, "x" * 200_000):
        path.write_text(text)
        for _ in range(2):  # and the file is not left locked
            with pytest.raises(LinkError, match="holds no time stamps"):
                Stamps(path)
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    with pytest.raises(LinkError, match=r"belongs to another user.*change the key: old packets could come back"):
        Stamps(path)


def test_a_failing_disk_stops_no_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine, theirs = signing(path=tmp_path / "stamps"), signing()
    now = [1000.0]
    monkeypatch.setattr(signing_module.time, "monotonic", lambda: now[0])  # however long this takes
    tried = []

    def full(path: Path, stamp: int) -> None:
        tried.append(stamp)
        raise LinkError("the time stamps are not kept: No space left on device", str(path))

    write = signing_module._write
    monkeypatch.setattr(signing_module, "_write", full)
    assert mine.check(signed(theirs)) is SigningVerdict.ACCEPTED
    assert "No space left" in mine.stamps.failure
    frame = signed(theirs)
    assert mine.check(frame) is SigningVerdict.ACCEPTED
    assert mine.check(frame) is SigningVerdict.REPEATED
    for _ in range(100):
        now[0] += 0.0099
        assert mine.check(signed(theirs)) is SigningVerdict.ACCEPTED
    assert len(tried) == 1  # not once a packet: a full disk answers slowly
    now[0] += 0.0101  # a second later there is room
    monkeypatch.setattr(signing_module, "_write", write)
    assert mine.check(signed(theirs)) is SigningVerdict.ACCEPTED
    assert mine.stamps.failure == ""
    monkeypatch.setattr(signing_module, "_write", full)
    with pytest.raises(LinkError, match="No space left"):
        mine.close()
    monkeypatch.setattr(signing_module, "_write", write)
    Stamps(tmp_path / "stamps").close()  # and the file is free
