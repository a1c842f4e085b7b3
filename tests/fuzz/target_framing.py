"""The frame parser: however bytes come, it raises nothing, keeps less than a frame, and finds the same frames.

What it finds decodes, and means the same when it is encoded again.
"""

import random
from itertools import pairwise

from tests.fuzz.target import Target
from tests.link.mavlink.test_framing import NAMES, random_message, repaired
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import LONGEST_FRAME, Parser, decode, encode


def seeds() -> list[bytes]:
    """Frames of both versions, signed and not, one that is cut, and one of each message."""
    module = dialect.load()
    link = module.MAVLink(None, srcSystem=1, srcComponent=1)
    heartbeat = link.heartbeat_encode(2, 12, 0, 0, 3)
    text = link.statustext_encode(6, b"hello")
    plain = heartbeat.pack(link) + text.pack(link)
    link.signing.secret_key, link.signing.sign_outgoing, link.signing.link_id = bytes(32), True, 1
    signed = heartbeat.pack(link)
    old = link.heartbeat_encode(2, 12, 0, 0, 3).pack(link, force_mavlink1=True)
    each = [encode(random_message(name, random.Random(name)), 1, 1, 0) for name in NAMES]
    return [plain, signed, bytes(old), plain[:-3] + signed, b"\xfd" * 300, b"\xfe\xff" + plain, *each]


def attempt(data: bytes) -> None:
    """Whole, in pieces whose lengths are the first bytes, and with the checksum that a hostile sender would give it."""
    stream = Parser()
    frames = stream.feed(data)
    assert stream.waiting < LONGEST_FRAME
    assert all(frame.raw in data for frame in frames)
    pieces = Parser()
    places = sorted({0, len(data), *(at % (len(data) + 1) for at in data[:4])})
    again = [frame for a, b in pairwise(places) for frame in pieces.feed(data[a:b])]
    # For a message that the dialect lacks nothing but its place vouches, which depends on what has come so far.
    if all(frame.known for frame in [*frames, *again]):
        assert [frame.raw for frame in again] == [frame.raw for frame in frames]
    assert pieces.waiting < LONGEST_FRAME
    datagram = Parser(mavlink1=False)
    found = datagram.feed(data, whole=True)
    assert all(frame.version == 2 for frame in found)
    assert sum(len(frame.raw) for frame in found) + datagram.counts.rubbish_bytes == len(data)
    assert datagram.waiting == 0
    for frame in [*frames, *datagram.feed(repaired(data), whole=True)]:
        got = decode(frame)
        assert (got is not None) == frame.known
        if got is not None:
            str(got)
            (copy,) = Parser().feed(encode(got, frame.system, frame.component, frame.sequence))
            assert repr(decode(copy).to_dict()) == repr(got.to_dict())


TARGET = Target("framing", seeds, attempt, 2000)
