"""Fields read from raw bytes equal those of the decoded message; a renumbered frame is the same message."""

import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.companion.ends import frame
from tests.link.mavlink.test_framing import random_message
from twodof.companion import frame_fields
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps


@pytest.mark.parametrize("name", sorted(dialect.classes()))
def test_target_and_time_are_those_of_the_decoded_message(name: str) -> None:
    chance = random.Random(name)
    for _ in range(20):
        sent = random_message(name, chance, zeros=0.3)
        (made,) = Parser().feed(encode(sent, 7, 9, 3))
        got = decode(made)
        system = getattr(got, "target_system", getattr(got, "target", 0))
        assert frame_fields.target(made) == (system, getattr(got, "target_component", 0))
        if hasattr(got, "time_boot_ms"):
            assert frame_fields.time_us(made) == got.time_boot_ms * 1000
        elif hasattr(got, "time_usec"):
            assert frame_fields.time_us(made) == got.time_usec
        else:
            assert frame_fields.time_us(made) == -1
        asked = frame_fields.command(made)
        assert (asked is None) == (name not in ("COMMAND_LONG", "COMMAND_INT"))
        if asked is not None:
            assert (asked.command, asked.system, asked.component) == (got.command, system, got.target_component)
            assert asked.params[:4] == (got.param1, got.param2, got.param3, got.param4)


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 2**32 - 1))
def test_a_renumbered_frame_is_the_same_message(before: int, after: int, time: int) -> None:
    original = frame("ATTITUDE", 1, 1, before, time_boot_ms=time, pitch=0.17)
    (got,) = Parser().feed(frame_fields.renumbered(original, after))  # its checksum holds
    assert (got.sequence, got.payload, got.system, got.component) == (after, original.payload, 1, 1)


def test_a_signed_frame_and_one_that_is_not_known_stay_as_they_are() -> None:
    signing = Signing(Key.fresh(), Stamps(None))
    (signed,) = Parser().feed(encode(message("HEARTBEAT"), 1, 1, 5, signing.outgoing()))
    assert frame_fields.renumbered(signed, 6) == signed.raw
    unknown = replace(frame("HEARTBEAT", 1, 1, 5), message_id=60_000)
    assert frame_fields.renumbered(unknown, 6) == unknown.raw
    (old,) = Parser().feed(message("HEARTBEAT", type=2).pack(_MavLink1(), force_mavlink1=True))
    assert old.version == 1
    assert frame_fields.renumbered(old, 6) == old.raw


class _MavLink1:
    seq, srcSystem, srcComponent = 5, 1, 1
    signing = type("Unsigned", (), {"sign_outgoing": False})()


@pytest.mark.parametrize(
    ("command", "params", "stops"),
    [
        (400, (0.0,), True),
        (400, (0.0, 21196.0), True),
        (400, (1.0,), False),
        (400, (1.0, 21196.0), False),
        (400, (float("nan"),), False),
        (185, (1.0,), True),
        (185, (0.0,), False),
        (176, (0.0,), False),
    ],
)
@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
def test_what_stops_the_motors_is_known_by_its_bytes(
    name: str, command: int, params: tuple[float, ...], stops: bool
) -> None:
    fields = {f"param{place}": value for place, value in enumerate(params, 1)}
    asked = frame_fields.command(frame(name, 255, 190, command=command, **fields))
    assert asked is not None
    assert (frame_fields.stop(asked) is not None) is stops


def test_a_forced_disarm_is_not_taken_for_a_repeated_plain_one() -> None:
    kinds = {
        frame_fields.stop(asked)
        for force in (0.0, 21196.0)
        if (asked := frame_fields.command(frame("COMMAND_LONG", 255, 190, command=400, param2=force))) is not None
    }
    assert len(kinds) == 2
