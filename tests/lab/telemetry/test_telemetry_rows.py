"""Rows of telemetry: joined by tick, decimated to their extremes, and bounded for a slow client."""

import asyncio

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.lab.telemetry_rows import (
    ACTION,
    COLUMNS,
    MOST_BYTES,
    MOST_EVENTS,
    ONBOARD,
    PATIENCE_TICKS,
    PLACES,
    Decimation,
    Outbox,
    Rows,
    StreamState,
    TickRows,
)

pytestmark = pytest.mark.slow

RATES = st.sampled_from([0.5, 1.0, 7.0, 20.0, 50.0, 60.0, 125.0, 200.0, 249.0])
VALUES = st.lists(
    st.tuples(*[st.one_of(st.floats(-100, 100, width=32), st.just(float("nan")))] * 2), min_size=1, max_size=400
)


@given(VALUES, RATES, st.lists(st.integers(1, 40), min_size=1, max_size=10))
def test_each_bucket_gives_its_minimum_and_maximum(
    values: list[tuple[float, float]], rate: float, pieces: list[int]
) -> None:
    decimation = Decimation(rate)
    rows = np.array(values, dtype=np.float32)
    ticks = np.arange(len(rows), dtype=np.int64)
    times, kept = [], []
    at, turn = 0, 0
    while at < len(rows):
        size = pieces[turn % len(pieces)]
        found = decimation.take(ticks[at : at + size], rows[at : at + size])
        times.append(found[0])
        kept.append(found[1])
        at, turn = at + size, turn + 1
    given_times, given_rows = np.concatenate(times), np.concatenate(kept)
    whole = (len(rows) - 1) // decimation.ticks  # the last bucket is whole once another begins
    assert len(given_rows) == 2 * whole
    assert 2 / (decimation.ticks * 0.004) <= rate * (1 + 1e-12)
    assert (np.diff(given_times) >= 0).all()
    for bucket in range(whole):
        inside = rows[bucket * decimation.ticks : (bucket + 1) * decimation.ticks]
        pair = given_rows[2 * bucket : 2 * bucket + 2]
        for column in range(2):
            seen = inside[:, column][~np.isnan(inside[:, column])]
            if not len(seen):
                assert np.isnan(pair[:, column]).all()
                continue
            assert {float(pair[0, column]), float(pair[1, column])} == {float(seen.min()), float(seen.max())}
            places = [int(np.flatnonzero(inside[:, column] == one)[0]) for one in pair[:, column]]
            assert places == sorted(places)  # a rise is drawn as a rise


@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_the_full_rate_leaves_nothing_out(rate: float) -> None:
    ticks = np.arange(100, dtype=np.int64)
    rows = np.random.default_rng(1).normal(size=(100, 3)).astype(np.float32)
    times, kept = Decimation(rate).take(ticks, rows)
    assert np.array_equal(times, 10.0 + ticks * 0.004)  # as its logs count, from 10 s on
    assert np.array_equal(kept, rows)


_ALL = np.arange(len(ONBOARD), dtype=np.intp)


def put(rows: TickRows, *ticks: int) -> None:
    """Rows of these ticks, each of whose values is its tick."""
    values = np.repeat(np.array(ticks, dtype=np.float32)[:, None], len(ONBOARD), axis=1)
    rows.onboard(np.array(ticks, dtype=np.uint32), values, _ALL)


def taken(rows: TickRows) -> list[int]:
    found = rows.take()
    return [] if found is None else found[0].tolist()


def test_rows_of_several_messages_are_given_in_order_and_once() -> None:
    rows = TickRows()
    put(rows, 3, 4)
    put(rows, 1, 2)
    ticks, values = rows.take() or (None, None)
    assert ticks is not None
    assert values is not None
    assert ticks.tolist() == [1, 2, 3, 4]
    assert values[:, PLACES["estimate.theta"]].tolist() == [1, 2, 3, 4]
    assert np.isnan(values[:, PLACES["truth.theta"]]).all()
    put(rows, 4, 5)
    assert taken(rows) == [5]


def test_rows_wait_for_a_truth_that_comes() -> None:
    rows = TickRows()
    rows.truth(1, (0.1, 0.2, 0.3, 0.4))
    put(rows, 1, 2)
    ticks, values = rows.take() or (None, None)
    assert ticks is not None
    assert values is not None
    assert ticks.tolist() == [1]
    truth = values[0, len(ONBOARD) : PLACES[ACTION]]
    assert truth.tolist() == np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32).tolist()
    assert values.shape[1] == len(COLUMNS)
    put(rows, *range(3, 2 + PATIENCE_TICKS))
    assert taken(rows) == list(range(2, 2 + PATIENCE_TICKS))  # the truth comes no more


def test_a_drone_that_began_anew_begins_anew_here() -> None:
    rows = TickRows()
    put(rows, 1000)
    assert taken(rows) == [1000]
    put(rows, 0, 1)
    assert taken(rows) == [0, 1]


def test_a_slow_client_loses_its_oldest_rows() -> None:
    outbox, slow, other = Outbox(), StreamState(1), StreamState(2)
    size = 1000
    outbox.put(Rows(other, b"x" * size, 1))
    for _ in range(MOST_BYTES // size + 50):
        outbox.put(Rows(slow, b"x" * size, 3))
    assert other.dropped == 1
    assert slow.dropped == 3 * 50


def test_rows_larger_than_the_outbox_are_sent() -> None:
    outbox, stream = Outbox(), StreamState(1)
    outbox.put(Rows(stream, b"x" * (2 * MOST_BYTES), 7))
    assert asyncio.run(outbox.next()) == Rows(stream, b"x" * (2 * MOST_BYTES), 7)
    assert stream.dropped == 0


def test_events_go_first_and_are_bounded_too() -> None:
    outbox, stream = Outbox(), StreamState(1)
    outbox.put(Rows(stream, b"x", 1))
    for number in range(MOST_EVENTS + 3):
        outbox.tell(str(number))
    assert asyncio.run(outbox.next()) == "3"


def test_rows_of_a_subscription_that_ended_are_not_sent() -> None:
    outbox, ended, stream = Outbox(), StreamState(1), StreamState(2)
    outbox.put(Rows(ended, b"x", 1))
    outbox.put(Rows(stream, b"y", 1))
    ended.ended = True
    assert asyncio.run(outbox.next()) == Rows(stream, b"y", 1)


def test_rows_tell_the_action_of_the_failsafe() -> None:
    rows, empty = TickRows(), np.empty(0, dtype=np.intp)

    def told(*ticks: int) -> list[float]:
        rows.onboard(np.array(ticks, dtype=np.uint32), np.zeros((len(ticks), 0), dtype=np.float32), empty)
        found = rows.take()
        assert found is not None
        return [float(value) for value in found[1][:, PLACES[ACTION]]]

    rows.action(0, 0)
    rows.action(102, 1)
    rows.action(104, 0)
    rows.action(104, 0)  # once a second it is told again
    assert told(100, 101, 102, 103, 104, 105) == [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]
    rows.action(1, 4)  # of a drone that has restarted
    assert told(106, 107) == [4.0, 4.0]
