"""A client that is slow loses its oldest rows, counted, and costs no more than its outbox."""

from __future__ import annotations

import asyncio

from twodof.lab.telemetry_rows import MOST_BYTES, MOST_EVENTS, Outbox, Rows, StreamState


def test_a_slow_client_loses_the_oldest_rows_and_is_told_how_many() -> None:
    outbox, slow, other = Outbox(), StreamState(1), StreamState(2)
    size = 1000
    outbox.put(Rows(other, b"x" * size, 1))
    for _ in range(MOST_BYTES // size + 50):
        outbox.put(Rows(slow, b"x" * size, 3))
    assert other.dropped == 1
    assert slow.dropped == 3 * 50
    assert outbox.waiting <= MOST_BYTES


def test_what_alone_is_larger_than_the_outbox_is_sent_all_the_same() -> None:
    outbox, stream = Outbox(), StreamState(1)
    outbox.put(Rows(stream, b"x" * (2 * MOST_BYTES), 7))
    assert asyncio.run(outbox.next()) == Rows(stream, b"x" * (2 * MOST_BYTES), 7)
    assert stream.dropped == 0


def test_events_go_first_and_are_bounded_too() -> None:
    outbox, stream = Outbox(), StreamState(1)
    outbox.put(Rows(stream, b"x", 1))
    for number in range(MOST_EVENTS + 3):
        outbox.tell(str(number))
    assert outbox.missed == 3
    assert asyncio.run(outbox.next()) == "3"


def test_rows_of_a_subscription_that_ended_are_not_sent() -> None:
    outbox, ended, stream = Outbox(), StreamState(1), StreamState(2)
    outbox.put(Rows(ended, b"x", 1))
    outbox.put(Rows(stream, b"y", 1))
    ended.ended = True
    assert asyncio.run(outbox.next()) == Rows(stream, b"y", 1)
