"""Loss, order and rates against sequences whose truth is known."""

import random

import pytest

from twodof.link.connection import MOST_SENDERS, LinkStatistics, RoundTrips, SenderCounts
from twodof.link.mavlink.framing import Frame


def counted(sequences: list[int]) -> SenderCounts:
    """Return the counts of these sequence numbers."""
    counts = SenderCounts()
    for sequence in sequences:
        counts.count(sequence % 256)
    return counts


@pytest.mark.parametrize(
    ("sequences", "lost", "duplicated", "reordered"),
    [
        (list(range(1000)), 0, 0, 0),  # wraps three times
        ([0, 1, 3, 4], 1, 0, 0),
        ([254, 255, 256, 258], 1, 0, 0),
        ([0, 2, 1, 3], 0, 0, 1),
        ([0, 1, 1, 2], 0, 1, 0),
        ([0, 3, 3, 1, 2, 1, 4], 0, 2, 2),
        ([200, 0], 55, 0, 0),
    ],
)
def test_gaps_copies_and_disorder(sequences: list[int], lost: int, duplicated: int, reordered: int) -> None:
    counts = counted(sequences)
    assert (counts.lost, counts.duplicated, counts.reordered, counts.restarts) == (lost, duplicated, reordered, 0)


def test_a_sender_that_begins_anew_is_no_loss() -> None:
    counts = counted([*range(100), *range(10)])
    assert (counts.lost, counts.restarts, counts.received) == (0, 1, 110)


def test_the_window_ends_where_it_says() -> None:
    # 63 behind the newest is within it, 64 behind is a sender that begins anew.
    assert counted([100, 163, 100]).duplicated == 1
    assert counted([99, 163, 99]).restarts == 1
    assert counted([100, 163, 101]).lost == 61
    late = counted([100, *range(163, 226), 162])
    assert (late.lost, late.restarts, late.duplicated) == (61, 0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_against_a_channel_whose_losses_are_known(seed: int) -> None:
    chance = random.Random(seed)
    sent = range(5000)
    kept = [number for number in sent if chance.random() > 0.3]
    copies = 0
    arrived: list[tuple[float, int]] = []
    for number in kept:
        # Up to 15 places late: within the window, so every one must be told apart.
        arrived.append((number + chance.uniform(0, 15), number))
        if chance.random() < 0.1:
            arrived.append((number + chance.uniform(0, 15), number))
            copies += 1
    order = [number for _, number in sorted(arrived)]
    counts = counted(order)
    # What was late before the first that came, or is missing behind the last, leaves no gap to be seen.
    start, end = order.index(max(order[:16])), 20
    assert counts.duplicated == pytest.approx(copies, abs=3)
    assert counts.lost == pytest.approx(5000 - len(kept), abs=start + end)
    assert counts.loss == pytest.approx(0.3, abs=0.03)  # standard deviation .0065


def test_round_trips_and_the_other_clock() -> None:
    trips = RoundTrips()
    for step, there_and_back in enumerate((0.010, 0.002, 0.030)):
        trips.asked(step, 100.0 + step)
        # The other clock is 7 s ahead and the way takes as long there as back.
        assert trips.answered(step, 100.0 + step + there_and_back, 107.0 + step + there_and_back / 2) == pytest.approx(
            there_and_back
        )
    assert trips.least == pytest.approx(0.002)
    assert trips.offset == pytest.approx(7.0)
    assert trips.count == 3
    assert trips.mean == pytest.approx(0.01128)  # a tenth of the difference each time: .01, .0092
    assert trips.answered(1, 200.0) is None  # twice
    assert trips.answered(99, 200.0) is None  # never asked
    for token in range(1000):
        trips.asked(token, 0.0)
    assert trips.answered(0, 1.0) is None  # long forgotten: what is kept is bounded


def test_the_link_s_loss_is_over_all_senders() -> None:
    statistics = LinkStatistics()
    assert statistics.loss == 0.0
    for system, sequences in ((1, (0, 1, 1, 3)), (2, (0, 4))):
        for sequence in sequences:
            statistics.count(Frame(b"", 2, 0, system, 1, sequence, False))
    # Sender 1: 4 sent, 1 lost (one came twice); sender 2: 5 sent, 3 lost.
    assert statistics.senders[1, 1].loss == pytest.approx(1 / 4)
    assert statistics.loss == pytest.approx(4 / 9)
    assert repr(statistics) == "<6 frames of 2 senders, 44 % lost>"
    statistics.round_trips.asked(1, 0.0)
    statistics.round_trips.answered(1, 0.0125)
    assert repr(statistics) == "<6 frames of 2 senders, 44 % lost, round trip 12.5 ms>"


def test_senders_are_bounded() -> None:
    statistics = LinkStatistics()
    for system in range(256):
        for component in (1, 2, 3):
            statistics.count(Frame(b"", 2, 0, system, component, 0, False))
    assert len(statistics.senders) == MOST_SENDERS
    assert statistics.loss == 0.0
