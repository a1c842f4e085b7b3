"""Full-rate batches through the companion: each client gets what the flight controller would have sent it alone."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.companion.ends import SYSTEM, Ends, frame
from twodof.companion.client import CompanionClient
from twodof.companion.frame_fields import BATCH
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import batch, batch_rows
from twodof.link.signing import Key, Signing, Stamps

CHANNELS = 26
LATEST_TICKS = 25


def value(tick: int, channel: int) -> float:
    """A number that tells where it belongs; NaN where a channel has no new sample."""
    return float("nan") if channel == 6 and tick % 14 else tick * 32.0 + channel


@dataclass
class Vehicle:
    """Sends batches by the flight controller's rule to one subscriber."""

    mask: int = 0
    every: int = 1
    begun: int = 0
    rows: list[list[float]] = field(default_factory=list)

    def asked(self, ends: Ends) -> None:
        """Obey and acknowledge until nothing more is asked."""
        while frames := ends.up.take():
            for one in map(decode, frames):
                if one.get_type() == "COMMAND_LONG" and one.command == 511:
                    if one.param1 == BATCH:
                        self.flush(ends)
                        self.mask = int(one.param3) | int(one.param4) << 16 if one.param2 > 0 else 0
                        self.every = max(1, round(one.param2 / 4000))
                    ends.vehicle("COMMAND_ACK", command=511, target_system=1, target_component=191)

    def tick(self, ends: Ends, tick: int) -> None:
        """One control period."""
        if not self.mask or tick % self.every:
            return
        if not self.rows:
            self.begun = tick
        self.rows.append([value(tick, bit) for bit in range(CHANNELS) if self.mask >> bit & 1])
        if len(self.rows) == max(1, min(60 // self.mask.bit_count(), LATEST_TICKS // self.every + 1)):
            self.flush(ends)

    def flush(self, ends: Ends) -> None:
        """Send what waits."""
        if self.rows:
            rows: NDArray[np.float32] = np.array(self.rows, np.float32)
            (sent,) = batch(self.begun, self.mask, rows, self.every)
            ends.router.from_vehicle(Parser().feed(encode(sent, SYSTEM, 1, ends._sequence))[0])
            ends._sequence = (ends._sequence + 1) & 0xFF
            self.rows = []


def subscribe(ends: Ends, client: CompanionClient, mask: int, interval: int) -> None:
    """Ask for channels."""
    ends.says(
        client, "COMMAND_LONG", 250, command=511, target_system=SYSTEM, target_component=1, param1=BATCH,
        param2=interval, param3=mask & 0xFFFF, param4=mask >> 16,
    )  # fmt: skip


def received(ends: Ends, client: CompanionClient) -> list[tuple[int, int, int, bytes]]:
    """Batches that a client got: (tick, mask, every, rows as bytes)."""
    got = [decode(one) for one in ends.heard(client)]
    return [
        (one.tick, one.channels, one.every, batch_rows(one)[1].tobytes())
        for one in got
        if one.get_type() == "TWODOF_BATCH"
    ]


def alone(mask: int, every: int, ticks: range, end: bool) -> list[tuple[int, int, int, bytes]]:
    """What the flight controller sends to a client that asks it directly."""
    most = max(1, min(60 // mask.bit_count(), LATEST_TICKS // every + 1))
    chosen = [tick for tick in ticks if tick % every == 0]
    pieces = [chosen[at : at + most] for at in range(0, len(chosen), most)]
    if not end and pieces and len(pieces[-1]) < most:
        pieces.pop()
    return [
        (
            piece[0],
            mask,
            every,
            np.array([[value(tick, bit) for bit in range(CHANNELS) if mask >> bit & 1] for tick in piece], np.float32)
            .tobytes(),
        )
        for piece in pieces
    ]  # fmt: skip


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.integers(1, 2**CHANNELS - 1), st.sampled_from([1, 2, 3, 4, 5, 8, 25])), min_size=1, max_size=3
    ),
    st.integers(0, 50),
)
def test_a_client_gets_the_very_messages_it_would_get_alone(wanted: list[tuple[int, int]], start: int) -> None:
    ends, vehicle = Ends(*["none"] * len(wanted)), Vehicle()
    for client, (mask, every) in zip(ends.clients, wanted, strict=True):
        subscribe(ends, client, mask, every * 4000)
    vehicle.asked(ends)
    ends.settle()
    ticks = range(start, start + 120)
    for tick in ticks:
        vehicle.tick(ends, tick)
    # Lockstep: time stands still after what is left has been sent.
    vehicle.flush(ends)
    ends.vehicle("TWODOF_TICK", tick=ticks.stop, until=ticks.stop)
    for client, (mask, every) in zip(ends.clients, wanted, strict=True):
        assert received(ends, client) == alone(mask, every, ticks, end=True)


def test_one_subscriber_gets_the_frames_as_they_are() -> None:
    ends, vehicle = Ends("none"), Vehicle()
    subscribe(ends, ends.clients[0], 0b11, 4000)
    vehicle.asked(ends)
    ends.settle()
    for tick in range(26):
        vehicle.tick(ends, tick)
    (got,) = ends.heard(ends.clients[0])
    assert batch_rows(decode(got))[0].tolist() == list(range(26))


def test_a_lost_batch_is_a_gap_for_everybody() -> None:
    ends, vehicle = Ends("none", "none"), Vehicle()
    subscribe(ends, ends.clients[0], 2**CHANNELS - 1, 4000)  # two rows a message
    subscribe(ends, ends.clients[1], 1, 4000)
    vehicle.asked(ends)
    ends.settle()
    for tick in range(40):
        vehicle.tick(ends, tick)
        if tick == 8:
            vehicle.rows.clear()  # lost on the way
    ends.vehicle("TWODOF_TICK", tick=40, until=40)
    got = received(ends, ends.clients[1])
    ticks = [tick + place for tick, _, _, rows in got for place in range(len(rows) // 4)]
    assert ticks == [tick for tick in range(39) if tick != 8]  # 39 waits for its second row
    for tick, _, _, rows in got:
        assert np.frombuffer(rows, np.float32).tolist() == [value(tick + at, 0) for at in range(len(rows) // 4)]


def test_what_waits_comes_before_the_subscription_ends() -> None:
    ends, vehicle = Ends("none", "none"), Vehicle()
    subscribe(ends, ends.clients[0], 0b111, 4000)
    subscribe(ends, ends.clients[1], 0b1, 4000)
    vehicle.asked(ends)
    ends.settle()
    for tick in range(20):
        vehicle.tick(ends, tick)
    assert received(ends, ends.clients[1]) == []
    subscribe(ends, ends.clients[1], 0b1, -1)
    vehicle.asked(ends)
    got = [decode(one).get_type() for one in ends.heard(ends.clients[1])]
    assert got == ["TWODOF_BATCH", "COMMAND_ACK"]
    for tick in range(20, 60):
        vehicle.tick(ends, tick)
    assert received(ends, ends.clients[1]) == []
    assert vehicle.mask == 0b111


@pytest.mark.parametrize("mask", [0])
def test_a_subscription_to_nothing_is_refused(mask: int) -> None:
    ends = Ends("none")
    subscribe(ends, ends.clients[0], mask, 4000)
    assert decode(ends.heard(ends.clients[0])[0]).result == 2


def test_signed_batches_pass_as_they_are_where_we_have_no_key() -> None:
    ends, signing = Ends("none", "none"), Signing(Key.fresh(), Stamps(None))
    subscribe(ends, ends.clients[0], 0b11, 4000)
    subscribe(ends, ends.clients[1], 0b01, 4000)
    ends.settle()
    (sent,) = batch(0, 0b11, np.zeros((5, 2), np.float32))
    (signed,) = Parser().feed(encode(sent, SYSTEM, 1, 0, signing.outgoing()))
    ends.router.from_vehicle(signed)
    assert [ends.sinks[client].sent for client in ends.clients] == [[signed.raw], [signed.raw]]


def test_numbers_that_make_no_sense_are_dropped() -> None:
    ends = Ends("none", "none")
    subscribe(ends, ends.clients[0], 0b11, 4000)
    subscribe(ends, ends.clients[1], 0b01, 4000)
    ends.settle()
    for fields in ({"channels": 0}, {"channels": 2**64 - 1, "rows": 255, "every": 1}, {"channels": 3, "rows": 9}):
        ends.router.from_vehicle(frame("TWODOF_BATCH", SYSTEM, 1, **fields))
    ends.router.from_vehicle(frame("TWODOF_BATCH", SYSTEM, 1, channels=3, rows=255, every=1))
    assert [len(rows) for _, _, _, rows in received(ends, ends.clients[1])] == [26 * 4]
