"""The line to the flight controller: order kept, nothing lost below capacity, fair shares above, a kill first."""

from collections import Counter
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.companion.ends import Sink
from twodof.companion.uplink_queue import (
    AHEAD_S,
    MOST_BACKLOG_BYTES,
    MOST_QUEUED_BYTES,
    NETWORK_FRAME,
    NETWORK_RATE,
    STALE_S,
    UplinkQueue,
)
from twodof.link.mavlink.framing import LONGEST_FRAME
from twodof.link.transport.base import Transport

pytestmark = pytest.mark.slow

RATE = 11_520.0  # 115200 baud


def made(rate: float | None = RATE) -> tuple[UplinkQueue, Sink]:
    """A line and where it leads."""
    line, sink = UplinkQueue(rate), Sink()
    line.connect(cast(Transport, sink))
    return line, sink


def run(line: UplinkQueue, now: float, until: float) -> float:
    """Let the line send what it has until a time [s], as its timer would."""
    while now < until:
        delay = line.pump(now)
        if delay is None:
            return until
        assert delay > 0.0
        now += delay
    return now


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.integers(10, 280), st.floats(0.0, 0.02)), min_size=1, max_size=200),
    st.sampled_from([RATE, None]),
)
def test_each_sender_keeps_its_order_and_below_capacity_nothing_is_lost(
    offers: list[tuple[str, int, float]], rate: float | None
) -> None:
    line, sink = made(rate)
    now, sent = 10.0, []
    for number, (source, size, wait) in enumerate(offers):
        raw = number.to_bytes(4, "big") + source.encode() * (size - 4)
        # Below capacity: as long as the line needs for the frame, and what is drawn beyond that.
        now = run(line, now, now + size / RATE + wait)
        assert line.offer(source, raw, now)
        sent.append(raw)
    run(line, now, now + 60.0)
    assert Counter(sink.sent) == Counter(sent)
    for source in "abc":
        of_source = [raw for raw in sink.sent if raw[4:5] == source.encode()]
        assert of_source == [raw for raw in sent if raw[4:5] == source.encode()]


def test_a_line_is_given_no_more_than_it_carries() -> None:
    line, sink = made()
    for number in range(400):
        line.offer("a", bytes(100), 10.0 + number * 1e-4)
    now = 10.04
    for end in (10.2, 10.4, 10.6, 10.8):
        now = run(line, now, end)
        carried = sum(map(len, sink.sent))
        assert carried <= RATE * (end - 10.0 + AHEAD_S) + LONGEST_FRAME
        assert carried >= RATE * (end - 10.0) * 0.95  # and no less: the rest is a timer's rounding


def test_a_flood_of_small_frames_leaves_the_flight_controller_time_to_fly() -> None:
    sink = Sink()
    line = UplinkQueue(NETWORK_RATE, NETWORK_FRAME)
    line.connect(cast(Transport, sink))
    now = 10.0
    while now < 11.0:
        for _ in range(100):  # 100 000 a second
            line.offer("flooder", b"f" * 21, now)
        run(line, now, now + 0.001)
        now += 0.001
    assert len(sink.sent) == pytest.approx(NETWORK_RATE / (21 + NETWORK_FRAME), rel=0.02)  # the first 10 ms go ahead


@pytest.mark.parametrize("flooders", [1, 3])
def test_who_floods_loses_its_own_frames_only(flooders: int) -> None:
    line, sink = made()
    fair = RATE / (flooders + 1)
    modest_size, modest_every = 60, 60 / (0.8 * fair)  # four fifths of its share
    now, next_modest, sent = 10.0, 10.0, 0
    while now < 15.0:
        for flooder in range(flooders):
            for _ in range(10):  # 2 Mbyte/s each
                line.offer(f"flooder {flooder}", b"f" * 200, now)
        if now >= next_modest:
            assert line.offer("modest", b"m" * modest_size, now)
            next_modest += modest_every
            sent += 1
        run(line, now, now + 0.001)
        now += 0.001
    run(line, now, now + 2.0)
    arrived = sum(raw[:1] == b"m" for raw in sink.sent)
    assert arrived == sent  # not one of the modest client's was lost
    flood = Counter(len(raw) for raw in sink.sent)[200] * 200
    assert flood > 0.15 * RATE * 5.0  # what nobody else wants they may have


def test_a_kill_overtakes_everything_that_waits() -> None:
    line, sink = made()
    for number in range(3000):
        line.offer(f"flooder {number % 3}", b"f" * 200, 10.0)
    before = len(sink.sent)
    assert line.offer("kills", b"kill", 10.0, urgent=(400, True))
    run(line, 10.0, 10.0 + AHEAD_S + 2 * LONGEST_FRAME / RATE)
    position = sink.sent.index(b"kill")
    assert position - before <= 1  # at most what had begun


def test_a_kill_is_sent_from_a_client_whose_queue_is_full() -> None:
    line, sink = made()
    taken = 0
    while line.offer("mad", b"f" * 200, 10.0):
        taken += 200
    assert taken > MOST_QUEUED_BYTES - 200
    assert line.offer("mad", b"kill", 10.0, urgent=(400, True))
    run(line, 10.0, 10.1)
    assert b"kill" in sink.sent


def test_kills_in_a_flood_do_not_pile_up() -> None:
    line, sink = made()
    line.offer("a", bytes(280), 10.0)
    for number in range(10_000):
        line.offer("mad", b"kill %d" % number, 10.0, urgent=(400, True))
    line.offer("calm", b"other kill", 10.0, urgent=(400, True))
    run(line, 10.0, 10.1)
    assert b"other kill" in sink.sent
    assert len(sink.sent) < 20


def test_what_is_too_old_is_not_sent() -> None:
    line, sink = made()
    for _ in range(200):
        line.offer("a", b"old" * 60, 10.0)
    run(line, 10.0, 10.0 + STALE_S)
    before = len(sink.sent)
    line.offer("a", b"new", 10.0 + STALE_S + 0.1)
    run(line, 10.0 + STALE_S + 0.1, 13.0)
    assert sink.sent[before:] == [b"new"]


def test_a_cut_throws_away_what_waits() -> None:
    line, _ = made()
    for _ in range(50):
        line.offer("a", bytes(200), 10.0)
    line.offer("a", b"kill", 10.0, urgent=(400, True))
    line.cut()
    assert not line.waiting
    assert not line.offer("a", b"while cut", 10.5)
    again = Sink()
    line.connect(cast(Transport, again))
    assert line.offer("a", b"after", 11.0)
    assert again.sent == [b"after"]


def test_a_network_that_does_not_take_makes_frames_wait_their_turn() -> None:
    line, sink = made(None)
    sink.backlog = MOST_BACKLOG_BYTES
    for number in range(10):
        assert line.offer("a", b"%d" % number, 10.0)
        assert line.offer("b", b"b%d" % number, 10.0)
    assert sink.sent == []
    sink.backlog = 0
    run(line, 10.0, 10.1)
    assert [raw for raw in sink.sent if raw[:1] != b"b"] == [b"%d" % number for number in range(10)]
    assert len(sink.sent) == 20


def test_many_clients_of_one_frame_each_do_not_starve_another() -> None:
    """Ten clients ask for as much as the line carries, each with one frame at a time; an eleventh asks for a fifth."""
    line, sink = made(5000.0)
    offered = 0
    for step in range(5000):
        now = 10.0 + 0.008 * step
        line.offer(f"crowd {step % 10}", bytes(40), now)
        if step % 25 == 0:
            for _ in range(5):
                offered += 1
                line.offer("pilot", b"p" * 40, now)
        run(line, now, now + 0.008)
    served = sum(raw[:1] == b"p" for raw in sink.sent)
    # An eleventh of the line is 9 % of what it carries, 45 % of what the pilot asks for.
    assert served > 0.4 * offered
