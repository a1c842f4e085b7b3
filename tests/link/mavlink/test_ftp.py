"""Packets of MAVLink FTP: the guide's layout, and the answers to a request."""

from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.ftp import MOST_DATA, FtpError, FtpOperation, FtpPacket, packed, read_packet

ASKED = FtpPacket(0xFFFF, 3, FtpOperation.BURST, 8, 0, 0, 0x01020304, b"a/b\0junk")


def test_a_packet_is_laid_out_as_the_guide_says_and_read_back() -> None:
    (frame,) = Parser().feed(encode(packed(ASKED, 7, 8), 1, 1, 0))
    got = decode(frame)
    assert (got.target_system, got.target_component) == (7, 8)
    # Sequence, session, operation, size, operation asked for, end of burst, padding, offset.
    assert bytes(got.payload[:12]) == b"\xff\xff\x03\x0f\x08\x00\x00\x00\x04\x03\x02\x01"
    assert read_packet(bytes(got.payload)) == ASKED._replace(data=ASKED.data.ljust(MOST_DATA, b"\0"))
    assert (ASKED.text, ASKED._replace(size=2).text) == ("a/b", "a/")


def test_answers_follow_the_request() -> None:
    def answer(sequence: int, op: int, data: bytes, offset: int = ASKED.offset, complete: int = 0) -> FtpPacket:
        return FtpPacket(sequence, 3, op, len(data), FtpOperation.BURST, complete, offset, data)

    assert ASKED.ack(b"xy", offset=5) == answer(0, FtpOperation.ACK, b"xy", 5)
    assert ASKED.nak(FtpError.END) == answer(0, FtpOperation.NAK, b"\x06")
    assert ASKED.nak(FtpError.ERRNO, 0x102) == answer(0, FtpOperation.NAK, b"\x02\x02")
    assert ASKED.part(2, 100, b"abc", True) == answer(2, FtpOperation.ACK, b"abc", 100, 1)
    assert ASKED.part(0, 0, b"abc", False) == answer(0, FtpOperation.ACK, b"abc", 0)
