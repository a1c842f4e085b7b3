"""Web sockets that ask for too much, or leave without a word: others go on hearing the drone."""

import json
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.gcs.virtual import on_board
from tests.lab.served import Client, Served, served, wait_for_drone
from twodof.lab.telemetry_client import MOST_STREAMS

pytestmark = pytest.mark.slow

THETA = ["estimate.theta"]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder: Path = tmp_path_factory.mktemp("lab")
    with on_board(conditions={"rings": True}) as there, served(folder, there.url) as found:
        wait_for_drone(found)
        yield found


def hears(client: Client, number: int) -> None:
    """Rows of a subscription come."""
    while client.frame().id != number:
        pass


@pytest.mark.long
def test_of_a_thousand_subscriptions_as_many_are_served_as_may_be(server: Served) -> None:
    with server.socket() as other, server.socket() as greedy:
        other.subscribe(THETA)
        for number in range(1000):
            greedy.subscribe(THETA, number=number)
        refused = greedy.event("refused")
        assert refused["id"] >= MOST_STREAMS
        assert refused["remedy"] == "end one first"
        heard: set[int] = set()
        while len(heard) < MOST_STREAMS:
            message = greedy.next()
            if isinstance(message, bytes):
                heard.add(int.from_bytes(message[2:4], "little"))
        assert heard == {*range(MOST_STREAMS)}
        hears(other, 1)
        greedy.send(do="unsubscribe", id=0)
        greedy.subscribe(THETA, number=5000)
        hears(greedy, 5000)


@pytest.mark.parametrize(
    "last", [b"", b"\x81", b"\x81\xfe\xff\xff", b"\xff" * 50], ids=["silent", "half", "cut", "none"]
)
def test_who_leaves_in_the_middle_takes_nobody_along(server: Served, last: bytes) -> None:
    with server.socket() as other:
        other.subscribe(THETA)
        for _ in range(5):
            with server.socket() as client:
                client.subscribe(THETA)
                hears(client, 1)
                raw = client.websocket.socket
                if last:
                    raw.sendall(last)
                with suppress(OSError):  # what cannot be a frame may have had the server close it already
                    raw.shutdown(socket.SHUT_RDWR)
        hears(other, 1)
    with server.socket() as after:
        assert json.loads(after.next())["event"] == "session"
        after.subscribe(THETA)
        hears(after, 1)
