"""Connections: time limits, and places by role that nobody without a token can take."""

import http.client
import select
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from tests.lab.served import COMMAND, WATCH, Served, served
from tests.patience import PATIENCE_S
from twodof.lab import connections, telemetry_client

pytestmark = pytest.mark.slow
PLACES = 4


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setattr(connections, "MOST_PLACES", PLACES)
    monkeypatch.setattr(telemetry_client, "MOST_CLIENTS", 2)
    for name in ("HEAD_S", "BODY_S", "SEND_S"):
        monkeypatch.setattr(connections, name, 0.5)
    with served(tmp_path, command_token=COMMAND, watch_token=WATCH) as found:
        yield found


def opened(server: Served, sent: str = "") -> socket.socket:
    """A connection that has sent something."""
    client = socket.create_connection(("127.0.0.1", server.port), PATIENCE_S)
    client.sendall(sent.encode())
    return client


def ends(client: socket.socket) -> bool:
    """Return True once the server closes a connection."""
    try:
        while client.recv(65536):
            pass
    except ConnectionResetError:
        pass
    return True


HEAD = f"POST /api/excitations/preview HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {WATCH}\r\n"
JSON = "Content-Type: application/json\r\n"


@pytest.mark.parametrize(
    "sent",
    [
        "GET / HTT",
        f"{HEAD}X-A: b",
        f"{HEAD}{JSON}Content-Length: 100\r\n\r\n{{",
        f"{HEAD}{JSON}Transfer-Encoding: chunked\r\n\r\n1\r\n{{\r\n",
        f"GET /api/session HTTP/1.1\r\nHost: localhost\r\n\r\n{HEAD}{JSON}Content-Length: 9\r\n\r\n{{",
    ],
    ids=["head", "headers", "body", "chunks", "pipelined"],
)
def test_a_slow_request_ends_in_its_time(server: Served, sent: str) -> None:
    with closing(opened(server, sent)) as slow:
        assert ends(slow)


def test_an_unread_answer_ends_in_its_time(server: Served) -> None:
    ask = f"GET /api/openapi.json HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {WATCH}\r\n\r\n"
    with closing(socket.socket()) as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", server.port))
        slow.sendall(ask.encode() * 50)
        reset = select.poll()
        reset.register(slow, 0)
        assert reset.poll(1000 * PATIENCE_S)


def test_an_unread_answer_ends_with_the_server(tmp_path: Path) -> None:
    with closing(socket.socket()) as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.settimeout(PATIENCE_S)
        with served(tmp_path, warm_up=False) as server:
            slow.connect(("127.0.0.1", server.port))
            slow.sendall(b"GET /api/openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 50)
            assert slow.recv(64).startswith(b"HTTP/1.1 200")
        assert ends(slow)


def test_a_piece_that_took_long_holds_nobody_up_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a collection of garbage does it, or a first import: such a piece says nothing of the client."""
    read, slow = connections.HttpConnection.take_in, [0.6, 0.6]
    began, ended = list[float](), list[float]()

    def take_in(self: connections.HttpConnection, data: bytes) -> None:
        began.append(time.monotonic())
        end = time.thread_time() + (slow.pop() if slow else 0.0)
        while time.thread_time() < end:
            pass
        read(self, data)
        ended.append(time.monotonic())

    monkeypatch.setattr(connections.HttpConnection, "take_in", take_in)
    asks = "GET /api/drones HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer wrong\r\n\r\n"
    with served(tmp_path, command_token=COMMAND, warm_up=False) as server, ExitStack() as open_ones:
        for client in [open_ones.enter_context(closing(opened(server, asks))) for _ in range(3)]:
            assert client.recv(64).startswith(b"HTTP/1.1 401")
    assert began[2] - ended[1] < 4.0  # 16 times as long as the first piece took is 9.6 s from its end


def test_each_role_has_its_own_places(server: Served) -> None:
    kept = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE_S)
    with ExitStack() as stack, closing(kept):
        kept.request("GET", "/api/session", headers={"Authorization": f"Bearer {COMMAND}"})
        assert kept.getresponse().read()
        place = kept.sock
        for token in (WATCH, "unknown", WATCH):
            ask = f"GET /api/session HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\n\r\n"
            clients = []
            for _ in range(3 * PLACES):
                clients.append(stack.enter_context(closing(opened(server, ask))))
                assert clients[-1].recv(64).startswith(b"HTTP/1.1 ")
            assert ends(clients[0])  # the oldest one made room
        kept.request("GET", "/api/session", headers={"Authorization": f"Bearer {COMMAND}"})
        assert kept.getresponse().status == 200
        assert kept.sock is place


def test_watchers_leave_the_commander_a_socket(server: Served) -> None:
    with server.socket(WATCH) as first, server.socket(WATCH) as second, server.socket(WATCH) as third:
        assert first.event("session")
        assert second.event("session")
        code, why = third.closed()
        assert (code, why) == (1013, "2 clients are connected already")
        with server.socket(COMMAND) as ours:
            assert ours.event("session")["role"] == "command"


def test_a_small_answer_comes_at_once(server: Served) -> None:
    """A client acknowledges after 40 ms; an answer's body must not wait for that of its head."""
    times = []
    with closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE_S)) as kept:
        for _ in range(30):
            began = time.monotonic()
            kept.request("GET", "/api/session", headers={"Authorization": f"Bearer {COMMAND}"})
            assert kept.getresponse().read()
            times.append(time.monotonic() - began)
            time.sleep(0.01)
    assert sorted(times[10:])[5] < 0.03


MANY = {f"k{k}": 1 for k in range(300)}


@pytest.mark.parametrize(
    ("body", "status"), [(MANY, 413), ({"excitation": MANY}, 413), ([[0] * 30_000], 413), ([{"a": {}}] * 9, 422)]
)
def test_too_many_members_are_refused(server: Served, body: object, status: int) -> None:
    answer = server.ask("POST", "/api/excitations/preview", body, token=WATCH)
    assert answer.status == status, answer.content[:200]


def test_a_forged_address_is_not_believed(server: Served) -> None:
    asked = {"experiment": {"name": "doublet"}}
    answers = [
        server.ask("POST", "/api/identification/plan", asked, {"X-Forwarded-For": f"10.0.0.{k}"}, WATCH)
        for k in range(8)
    ]
    assert {answer.status for answer in answers} == {202, 409}  # one person's share
