"""Frames: a differential against pymavlink, resynchronisation, and any bytes at all."""

import math
import random
import struct
import time
from typing import Any

import pytest

from twodof.errors import LinkError
from twodof.link.mavlink import dialect, framing
from twodof.link.mavlink.framing import LONGEST_FRAME, Parser, decode, encode
from twodof.link.mavlink.messages import message

pytestmark = pytest.mark.slow

NAMES = list(dialect.classes())
RANGES = {"int8_t": 8, "int16_t": 16, "int32_t": 32, "int64_t": 64}


def random_message(name: str, chance: random.Random, zeros: float = 0.0) -> Any:
    """A message with every field drawn from its type's whole range, some of them `zeros`, so that ends are cut off."""
    kind = dialect.classes()[name]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))

    def draw(type_name: str) -> Any:
        if zeros and chance.random() < zeros:
            return 0
        if type_name in ("float", "double"):
            # Numbers that a float32 holds, so that they come back equal.
            return struct.unpack("<f", struct.pack("<f", chance.uniform(-1e6, 1e6)))[0]
        bits = RANGES[type_name.removeprefix("u")]
        low = 0 if type_name.startswith("u") else -(1 << bits - 1)
        return low + chance.randrange(1 << bits)

    fields: dict[str, Any] = {}
    for field, type_name in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if type_name == "char":
            fields[field] = "".join(chance.choices("abcXYZ_09", k=chance.randint(0, max(1, lengths[field]))))
        elif lengths[field]:
            fields[field] = [draw(type_name) for _ in range(lengths[field])]
        else:
            fields[field] = draw(type_name)
    return message(name, **fields)


def reference() -> Any:
    """pymavlink's own encoder and decoder of our dialect."""
    return dialect.load().MAVLink(None, srcSystem=7, srcComponent=9)


@pytest.mark.parametrize("name", NAMES)
def test_a_message_goes_round_and_pymavlink_agrees(name: str) -> None:
    chance = random.Random(name)
    for sequence in (0, 1, 255):
        sent = random_message(name, chance)
        theirs = reference()
        theirs.seq = sequence
        raw = encode(sent, 7, 9, sequence)
        assert raw == bytes(sent.pack(theirs))
        (frame,) = Parser().feed(raw)
        assert (frame.system, frame.component, frame.sequence) == (7, 9, sequence)
        ours, judged = decode(frame), theirs.decode(bytearray(raw))
        assert ours is not None
        assert ours.to_dict() == judged.to_dict() == sent.to_dict()
        assert (ours.get_srcSystem(), ours.get_srcComponent(), ours.get_seq()) == (7, 9, sequence)
        assert ours.get_header().mlen == judged.get_header().mlen


def test_mavlink_1_is_read_and_can_be_refused() -> None:
    theirs = reference()
    theirs.seq = 5
    raw = bytes(message("HEARTBEAT", type=2, custom_mode=0x01020304).pack(theirs, force_mavlink1=True))
    assert raw[0] == framing.MARKER_1
    (frame,) = Parser().feed(raw)
    assert (frame.version, frame.system, frame.component, frame.sequence) == (1, 7, 9, 5)
    assert decode(frame).custom_mode == 0x01020304
    strict = Parser(mavlink1=False)
    assert strict.feed(raw) == []
    assert strict.counts.mavlink1_refused == 1


def stream(count: int, seed: int) -> tuple[list[bytes], random.Random]:
    """Frames of random messages, one after another."""
    chance = random.Random(seed)
    return [encode(random_message(chance.choice(NAMES), chance), 1, 1, n % 256) for n in range(count)], chance


def test_it_does_not_matter_where_the_stream_is_cut() -> None:
    frames, chance = stream(300, seed=1)
    data = b"".join(frames)
    parser, got, at = Parser(), [], 0
    while at < len(data):
        step = chance.choice((1, 2, 3, 17, 400))
        got += parser.feed(data[at : at + step])
        assert parser.waiting < LONGEST_FRAME
        at += step
    assert [frame.raw for frame in got] == frames
    assert parser.counts.rubbish_bytes == 0


def test_rubbish_between_frames_costs_no_frame() -> None:
    frames, chance = stream(300, seed=2)
    parser, got, rubbish = Parser(), [], 0
    for frame in frames:
        junk = bytes(chance.choices((0xFD, 0xFE, 0x00, 0x09, 0xFF), k=chance.randint(0, 40)))
        rubbish += len(junk)
        got += parser.feed(junk + frame)
    got += parser.feed(b"", whole=True)
    # Rubbish that has just the length of a frame of an unknown message, whose checksum nobody knows, passes as one.
    strangers = [frame for frame in got if frame.raw not in set(frames)]
    assert not any(frame.known for frame in strangers)
    assert [frame.raw for frame in got if frame.raw in set(frames)] == frames
    assert parser.counts.rubbish_bytes + sum(len(frame.raw) for frame in strangers) == rubbish


def test_a_frame_with_a_wrong_byte_is_lost_alone() -> None:
    frames, chance = stream(200, seed=3)
    damaged = list(frames)
    hit = range(5, 200, 7)
    for index in hit:
        bad = bytearray(frames[index])
        bad[chance.randrange(len(bad))] ^= 1 << chance.randrange(8)
        damaged[index] = bytes(bad)
    parser = Parser()
    got = [frame.raw for frame in parser.feed(b"".join(damaged)) + parser.feed(b"", whole=True)]
    # An unknown id that a flipped bit makes stays visible as such; every frame that was whole arrives.
    kept = [raw for raw in got if raw in set(frames)]
    assert kept == [frame for index, frame in enumerate(frames) if index not in hit]


def test_the_end_of_a_datagram_is_the_end() -> None:
    heartbeat = encode(message("HEARTBEAT"), 1, 1, 0)
    parser = Parser()
    # The marker promises 255 bytes that never come; in a datagram the frame behind it is found at once.
    assert [f.raw for f in parser.feed(b"\xfd\xff\x00" + heartbeat, whole=True)] == [heartbeat]
    assert parser.waiting == 0
    assert parser.feed(heartbeat[:9], whole=True) == []
    assert [f.raw for f in parser.feed(heartbeat, whole=True)] == [heartbeat]


def unknown_frame() -> bytes:
    """A frame of a message that the dialect lacks."""
    return b"\xfd\x03\x00\x00\x05\x01\x01" + (300_000).to_bytes(3, "little") + b"abc" + b"\x12\x34"


def test_unknown_messages_pass_as_frames_where_frames_are() -> None:
    heartbeat = encode(message("HEARTBEAT"), 1, 1, 0)
    parser = Parser()
    got = parser.feed(heartbeat + unknown_frame() + heartbeat)
    assert [f.message_id for f in got] == [0, 300_000, 0]
    assert decode(got[1]) is None
    assert not got[1].known
    assert parser.counts.unknown == 1
    assert parser.feed(b"\x01" + unknown_frame() + heartbeat)[0].message_id == 0  # after rubbish nothing vouches for it


@pytest.mark.parametrize("old", [False, True], ids=["MAVLink 2", "MAVLink 1"])
def test_rubbish_that_looks_like_an_unknown_message_hides_no_frame(old: bool) -> None:
    inside = bytes(message("HEARTBEAT", type=2).pack(reference(), force_mavlink1=old))
    rubbish = bytearray(unknown_frame())[:-2] + b"\x00" * 20
    rubbish[1] = 3 + 20 + len(inside) - 2  # its end is that of the frame inside, or of what follows
    parser = Parser()
    got = parser.feed(encode(message("HEARTBEAT"), 1, 1, 0) + bytes(rubbish) + inside)
    assert [f.message_id for f in got] == [0, 0]
    assert got[1].raw == inside
    assert (decode(got[1]).get_header().incompat_flags, decode(got[1]).get_seq()) == (0, 0)
    assert parser.counts.unknown == 0
    assert parser.counts.rubbish_bytes == len(rubbish)


def test_a_newer_dialect_s_longer_payload_is_read() -> None:
    longer = bytearray(encode(message("CURRENT_MODE", custom_mode=5, intended_custom_mode=7), 1, 1, 0))
    body = bytes([longer[1] + 4]) + bytes(longer[2:-2]) + b"\0\0\0\x09"
    crc = framing.crc16.mcrf4xx(body + bytes([dialect.classes()["CURRENT_MODE"].crc_extra]))
    (frame,) = Parser().feed(b"\xfd" + body + crc.to_bytes(2, "little"))
    assert decode(frame).intended_custom_mode == 7


def test_flags_that_nobody_knows_are_refused() -> None:
    raw = bytearray(encode(message("HEARTBEAT"), 1, 1, 0))
    raw[2] = 0x02
    assert Parser().feed(bytes(raw), whole=True) == []


def test_what_does_not_fit_is_named() -> None:
    with pytest.raises(LinkError, match=r"HEARTBEAT: cannot be encoded: type = 256 does not fit uint8_t"):
        encode(message("HEARTBEAT", type=256), 1, 1, 0)
    with pytest.raises(LinkError, match="pitch = 'up' does not fit float"):
        encode(message("ATTITUDE", pitch="up"), 1, 1, 0)
    with pytest.raises(LinkError, match="pitch = 1e\\+300 does not fit float"):
        encode(message("ATTITUDE", pitch=1e300), 1, 1, 0)
    short = message("ODOMETRY")
    short.q = [1.0]
    with pytest.raises(LinkError, match="q has 1 numbers, not 4"):
        encode(short, 1, 1, 0)
    (frame,) = Parser().feed(encode(message("ATTITUDE", pitch=math.nan, roll=math.inf), 1, 1, 0))
    assert math.isnan(decode(frame).pitch)
    assert decode(frame).roll == math.inf


def repaired(raw: bytes) -> bytes:
    """The frame with the length and checksum that a hostile sender who knows the protocol would give it."""
    if len(raw) < 12 or raw[0] != framing.MARKER_2:
        return raw
    kind = dialect.load().mavlink_map.get(int.from_bytes(raw[7:10], "little"))
    if kind is None:
        return raw
    body = bytes([min(255, len(raw) - 12), 0]) + raw[3 : 10 + min(255, len(raw) - 12)]
    return b"\xfd" + body + framing.crc16.mcrf4xx(body + bytes([kind.crc_extra])).to_bytes(2, "little")


@pytest.mark.long
def test_the_worst_rubbish_costs_linear_time() -> None:
    # Every twelfth byte opens a frame of the longest kind whose message is known, so that its checksum is computed.
    def cost(size: int) -> float:
        data = (b"\xfd\xff\x00" + b"\x00" * 4 + b"\x1e\x00\x00" + b"\x00" * 2) * (size // 12)
        parser, start = Parser(), time.process_time()
        parser.feed(data)  # a stream, of which no datagram's end relieves us
        spent = time.process_time() - start
        assert parser.counts.bad_checksum > size // 12 - 24
        return spent

    costs = [(cost(30_000), cost(480_000)) for _ in range(4)]
    small, large = (min(each) for each in zip(*costs, strict=True))
    assert large < 48 * small  # 16 for linear, 256 for quadratic
    assert large < 1.0  # measured .04 s
