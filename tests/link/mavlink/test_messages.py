"""Messages by name, batches and excitations: everything that goes in comes out."""

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.link.batches import batch
from twodof.errors import LinkError
from twodof.excitation import Doublet, Excitation, Steps
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import (
    ExcitationReceiver,
    batch_rows,
    channel_bits,
    channel_mask,
    excite,
    float_of_int,
    int_of_float,
    message,
    statustext,
)

pytestmark = pytest.mark.slow


def over_the_wire(sent: Any) -> Any:
    """Return the message as the receiver decodes it."""
    (frame,) = Parser().feed(encode(sent, 1, 1, 0))
    return decode(frame)


def test_what_is_not_given_is_zero() -> None:
    got = message("HEARTBEAT", type=2)
    assert (got.type, got.autopilot, got.mavlink_version) == (2, 0, 3)
    with pytest.raises(LinkError, match=r"has no field 'typ'.*its fields are type, autopilot"):
        message("HEARTBEAT", typ=2)
    with pytest.raises(LinkError, match="is not text of at most 16 bytes"):
        message("PARAM_SET", param_id="A_NAME_OF_SEVENTEE")
    with pytest.raises(LinkError, match="at most 8 fit"):
        message("ACTUATOR_CONTROL_TARGET", controls=range(9))


@given(
    count=st.integers(0, 200),
    width=st.integers(1, 26),
    first=st.sampled_from([0, 1, 2**32 - 5]),
    every=st.integers(1, 255),
    seed=st.integers(0, 2**32 - 1),
)
def test_batches_lose_nothing(count: int, width: int, first: int, every: int, seed: int) -> None:
    chance = np.random.default_rng(seed)
    columns = random.Random(seed).sample(sorted(channel_bits()), width)
    rows = chance.standard_normal((count, width)).astype(np.float32)
    rows[chance.random(rows.shape) < 0.2] = np.nan
    sent = batch(first, channel_mask(columns), rows, every)
    ticks, values = zip(*map(batch_rows, map(over_the_wire, sent)), strict=True) if sent else ([], [])
    if count:
        assert np.array_equal(np.concatenate(values), rows, equal_nan=True)
        expected = (first + every * np.arange(count)) % 2**32
        assert np.concatenate(ticks).tolist() == expected.tolist()
    assert len(sent) == -(-count // (60 // width))


def test_a_batch_of_nonsense_is_empty_or_bounded() -> None:
    assert len(batch_rows(message("TWODOF_BATCH", rows=255))[1]) == 0
    assert batch_rows(message("TWODOF_BATCH", channels=2**64 - 1, rows=255))[1].size == 0
    assert batch_rows(message("TWODOF_BATCH", channels=7, rows=255))[1].shape == (20, 3)
    with pytest.raises(LinkError, match=r"no channel 'imu.giro_y'.*IMU_GYRO_Y"):
        channel_mask(["imu.giro_y"])


EXCITATIONS: list[Excitation] = [
    Doublet(0.03, 0.6),
    Steps(tuple((-1.0) ** n * (n + 1) / 1000 for n in range(200)), 0.5),
]


@pytest.mark.parametrize("excitation", EXCITATIONS, ids=lambda e: e.kind)
@pytest.mark.parametrize("seed", range(3))
def test_an_excitation_survives_loss_copies_and_disorder(excitation: Excitation, seed: int) -> None:
    pieces = [over_the_wire(piece) for piece in excite(excitation, 0, 7, 1, 1)]
    assert len(pieces) > 0
    chance = random.Random(seed)
    sent = pieces * 2
    chance.shuffle(sent)
    receiver, whole = ExcitationReceiver(), None
    for piece in sent:
        assert receiver.received <= 65_535
        whole = receiver.take(piece) or whole
    assert whole == excitation.to_json().encode()


def test_pieces_that_do_not_belong_together_give_nothing() -> None:
    one = [over_the_wire(piece) for piece in excite(Doublet(0.03, 0.6), 0, 1, 1, 1)]
    other = [over_the_wire(piece) for piece in excite(Doublet(0.05, 0.6), 0, 2, 1, 1)]
    receiver = ExcitationReceiver()
    assert receiver.take(one[0]) is None or len(one) == 1
    for piece in other[:-1]:
        assert receiver.take(piece) is None
    damaged = message("TWODOF_EXCITE", crc=5, transfer=3, total=10, length=10, data=b"0123456789")
    assert ExcitationReceiver().take(damaged) is None  # its checksum is another
    for wild in ({"offset": 100}, {"offset": 60_000, "total": 10}, {"total": 0}, {"length": 255}):
        fields = {"total": 300, "length": 200, "data": b"x" * 200, **wild}
        assert ExcitationReceiver().take(message("TWODOF_EXCITE", **fields)) is None


@given(st.integers(-(2**31), 2**31 - 1))
def test_an_int32_in_a_float_comes_back_or_is_refused(value: int) -> None:
    try:
        carried = float_of_int(value)
    except LinkError:
        assert value & 0x7F800000 == 0x7F800000  # only patterns of NaN
        return
    got = over_the_wire(message("PARAM_VALUE", param_value=carried, param_id="P"))
    assert int_of_float(got.param_value) == value


def test_what_is_no_int32_is_refused() -> None:
    for value in (2**31, 1.5, "1"):
        with pytest.raises(LinkError, match="not an int32"):
            float_of_int(value)


def test_long_text_goes_in_chunks() -> None:
    assert [m.text for m in statustext("short")] == ["short"]
    text = "a long line " * 20
    chunks = statustext(text, severity=4, number=9)
    assert "".join(m.text for m in chunks) == text
    assert [m.chunk_seq for m in chunks] == list(range(len(chunks)))
    assert {(m.id, m.severity) for m in chunks} == {(9, 4)}
    assert len(statustext("x" * 100_000)) == 255
