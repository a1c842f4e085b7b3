"""Messages packed on the spot: the same bytes as pymavlink's, for every message of the dialect."""

import random
import struct
from contextlib import closing
from typing import Any

import pytest

from tests.link.mavlink.test_framing import NAMES, random_message
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import Packer, message
from twodof.link.signing import Key, Signing, Stamps


def raw(sent: Any, field: str) -> Any:
    """A field as it is packed: of text the bytes."""
    name = f"_{field}_raw"
    return getattr(sent, name) if hasattr(sent, name) else getattr(sent, field)


def values_in_wire_order(sent: Any) -> list[Any]:
    """A message's values as a Packer takes them."""
    values: list[Any] = []
    kind = type(sent)
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        value = raw(sent, name)
        values += value if length and isinstance(value, list) else [value]
    return values


@pytest.mark.parametrize("name", NAMES)
def test_bytes_are_those_of_pymavlink(name: str) -> None:
    chance = random.Random(name)
    pack = Packer(name)
    for sequence in (0, 255):
        sent = random_message(name, chance)
        packed = pack(*values_in_wire_order(sent))
        assert packed.get_type() == name
        assert encode(packed, 3, 1, sequence) == encode(sent, 3, 1, sequence)


def test_signed_frames_are_pymavlinks(tmp_path: Any) -> None:
    key = Key.of("a long enough passphrase")
    packed = Packer("ATTITUDE")(4, 0.0, 0.1, 0.0, 0.0, 0.3, 0.0)
    own, theirs = (Signing(key, Stamps(tmp_path / name)) for name in ("own", "theirs"))
    with closing(own), closing(theirs):
        signed = encode(packed, 1, 1, 5, own.outgoing())
        (frame,) = Parser().feed(signed)
        assert frame.signed
        assert (decode(frame).get_header().incompat_flags, decode(frame).get_header().compat_flags) == (1, 0)
        assert theirs.check(frame).name == "ACCEPTED"
        assert decode(frame).pitch == struct.unpack("<f", struct.pack("<f", 0.1))[0]


def test_what_no_float32_holds_is_infinite_and_an_integer_that_does_not_fit_is_an_error() -> None:
    pack = Packer("ATTITUDE")
    (frame,) = Parser().feed(encode(pack(0, 1e300, -1e300, 0.0, 0.0, float("nan"), 1.0), 1, 1, 0))
    got = decode(frame)
    assert (got.roll, got.pitch, got.yawspeed) == (float("inf"), float("-inf"), 1.0)
    assert got.pitchspeed != got.pitchspeed
    with pytest.raises(struct.error):
        pack(-1, *(0.0,) * 6)


def test_fields_that_are_not_given_are_zero() -> None:
    packed = Packer("ATTITUDE", "time_boot_ms", "pitch", "pitchspeed")(4, 0.1, 0.3)
    assert packed.payload == Packer("ATTITUDE")(4, 0.0, 0.1, 0.0, 0.0, 0.3, 0.0).payload
    array = Packer("ODOMETRY", "q", "frame_id")(1.0, 2.0, 3.0, 4.0, 5)
    plain = message("ODOMETRY", q=[1.0, 2.0, 3.0, 4.0], frame_id=5)
    assert encode(array, 1, 1, 0) == encode(plain, 1, 1, 0)
