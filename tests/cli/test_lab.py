"""`twodof lab`, and the page of `twodof up`: links, tokens, and the end."""

import http.client
import json
import os
import signal
import socket
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tests.cli.program import program
from tests.fleet.drone_numbers import free_numbers
from tests.gcs.virtual import on_board
from tests.lab.served import holds_samples
from tests.patience import PATIENCE_S, patiently
from tests.processes import alive
from twodof.cli.app import run
from twodof.flightlog.files import read_log

pytestmark = pytest.mark.slow


def status(port: int, path: str, token: str = "", host: str = "127.0.0.1", method: str = "GET", **more: str) -> int:
    """Of a request; `more` are further headers."""
    connection = http.client.HTTPConnection(host, port, timeout=PATIENCE_S)
    try:
        connection.request(method, path, headers=more | ({"Authorization": f"Bearer {token}"} if token else {}))
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.long
def test_links_appear_once_and_tokens_never(tmp_path: Path) -> None:
    with program(
        tmp_path, "lab", "--json", "--host", "0.0.0.0", "--port", "0", "--connect", "udp://127.0.0.1:9"
    ) as lab:
        told = lab.document()
        port = told["port"]
        tokens = {who: parse_qs(urlsplit(link).query)["token"][0] for who, link in told["page"].items()}
        assert tokens["command"] != tokens["watch"]
        assert all(len(token) >= 32 for token in tokens.values())  # 24 random bytes
        assert status(port, "/api/session") == 401
        assert status(port, "/api/session", tokens["watch"]) == 200
        for path in (f"/?token={tokens['command']}", f"/api/nothing?token={tokens['command']}"):
            status(port, path)
        with connect(f"ws://127.0.0.1:{port}/api/telemetry?token={tokens['command']}") as websocket:
            assert json.loads(websocket.recv(PATIENCE_S))["role"] == "command"
            websocket.send("no JSON")
            assert lab.interrupted() == 0
        assert not any(token in line for line in [*lab.out[1:], *lab.err] for token in tokens.values())
        assert list(tmp_path.rglob("*token*")) == []


@pytest.mark.long
def test_with_token_every_client_needs_the_link(tmp_path: Path) -> None:
    with program(tmp_path, "lab", "--json", "--token", "--port", "0", "--connect", "udp://127.0.0.1:9") as lab:
        told = lab.document()
        assert status(told["port"], "/api/session") == 401
        token = parse_qs(urlsplit(told["page"]["command"]).query)["token"][0]
        assert status(told["port"], "/api/session", token) == 200


@pytest.mark.long
def test_a_drone_that_it_flies_is_left_disarmed(tmp_path: Path) -> None:
    with (
        on_board(conditions={"rings": True}) as there,
        program(tmp_path, "lab", "--json", "--port", "0", "--connect", there.url) as lab,
    ):
        port = lab.document()["port"]
        with connect(f"ws://127.0.0.1:{port}/api/telemetry") as websocket:
            while "heard" not in str(websocket.recv(PATIENCE_S)):
                pass
            for method, path, body in (
                ("POST", "arm", ""),
                ("PUT", "setpoint", '{"loop": "theta", "value": 0.0, "thrust": 0.4}'),
            ):
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
                connection.request(method, f"/api/drones/1/{path}", body, {"Content-Type": "application/json"})
                assert connection.getresponse().status == 200
                connection.close()
            assert there.drone.controller.latest.armed
            for _ in patiently():  # what it flies is recorded from a moment after it is armed
                if any(map(holds_samples, (tmp_path / "flights").glob("*.mcap"))):
                    break
            assert lab.interrupted() == 0
        assert not there.drone.controller.latest.armed
        (flight,) = (tmp_path / "flights").glob("*.mcap")
        assert len(read_log(flight)["theta"])


def test_a_port_in_use_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        assert run(["lab", "--port", str(port), "--connect", "udp://127.0.0.1:9"]) == 2
    said = capfd.readouterr().err
    assert f"http://127.0.0.1:{port}" in said
    assert "--port 0" in said


def opens(url: str, origin: str) -> bool:
    """Return True if the server accepts a web socket from a page of `origin`."""
    try:
        with connect(url, additional_headers={"Origin": origin}) as websocket:
            return "role" in json.loads(websocket.recv(PATIENCE_S))
    except (InvalidStatus, ConnectionClosed):
        return False


@pytest.mark.long
@pytest.mark.waits
def test_up_serves_its_page_to_link_holders_alone(tmp_path: Path) -> None:
    options = ("--page-port", "0", "--rings", "--host", "0.0.0.0")
    with free_numbers(1) as first, program(tmp_path, "up", "--json", "--first", str(first + 1), *options) as up:
        told = up.document()
        links = {who: urlsplit(link) for who, link in told["page"].items()}
        tokens = {who: parse_qs(link.query)["token"][0] for who, link in links.items()}
        port = links["command"].port
        assert links["command"].hostname == socket.gethostname().lower()
        assert port is not None
        number = told["drones"][0]["system"]
        for host in ("127.0.0.1", "127.0.0.2"):  # any address of this computer
            assert status(port, "/api/session", host=host) == 401
            for path in ("/", f"/api/drones/{number}"):
                for _ in patiently():
                    if status(port, path, tokens["watch"], host) == 200:
                        break
            ours = f"http://{host}:{port}"
            hold = f"/api/drones/{number}/lease"
            assert status(port, hold, tokens["watch"], host, "POST") == 403
            assert status(port, hold, tokens["command"], host, "POST", Origin="http://elsewhere.example") == 403
            assert status(port, hold, tokens["command"], host, "POST", Origin=ours) == 200
            assert status(port, "/api/session", tokens["command"], host, Host="elsewhere.example") == 421
            socket_url = f"ws://{host}:{port}/api/telemetry?token={tokens['watch']}"
            assert opens(socket_url, ours)
            assert not opens(socket_url, "http://elsewhere.example")
        drone = urlsplit(told["drones"][0]["companion"])
        socket.create_connection((drone.hostname, drone.port), PATIENCE_S).close()
        with pytest.raises(ConnectionRefusedError):  # a drone's own ports are those of the loopback's one address
            socket.create_connection(("127.0.0.2", drone.port), PATIENCE_S)
        assert up.interrupted() == 0
        assert not any(token in line for line in [*up.out[1:], *up.err] for token in tokens.values())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--host", "192.0.2.1"), "give --host an address of this computer"),
        (("--host", "0.0.0.0", "--no-page"), "no page is served with --no-page"),
        (("--token", "--lockstep"), "no page is served with --no-page"),
    ],
)
def test_up_refuses_wrong_places_of_its_page(
    options: tuple[str, ...], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with free_numbers(1) as first:
        assert run(["up", "--first", str(first + 1), *options]) == 2
    assert said in " ".join(capfd.readouterr().err.split())


@pytest.mark.long
@pytest.mark.waits
def test_up_serves_restarts_and_ends_its_page(tmp_path: Path) -> None:
    with (
        free_numbers(1) as first,
        program(tmp_path, "up", "--json", "--first", str(first + 1), "--page-port", "0", "--rings") as up,
    ):
        told = up.document()
        link = urlsplit(told["page"]["command"])
        assert (link.hostname, link.query) == ("127.0.0.1", "")
        assert link.port is not None
        assert status(link.port, "/api/session") == 200
        for _ in patiently():
            if status(link.port, f"/api/drones/{first + 1}") == 200:
                break
        processes = up.children()
        (server,) = [one for one, command in processes.items() if " lab --port " in command]
        assert os.getpriority(os.PRIO_PROCESS, server) == os.getpriority(os.PRIO_PROCESS, 0)  # as what flies
        os.kill(server, signal.SIGKILL)
        for _ in patiently():  # it comes back, with its links
            try:
                assert status(link.port, "/api/session") == 200
                break
            except OSError:
                continue
        assert up.interrupted() == 0
        assert not any(map(alive, processes))
