"""`twodof lab`, and the page of `twodof up`: they serve, say their links once, keep them to themselves, and end."""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from websockets.sync.client import connect

from tests.fleet.drone_numbers import free_numbers
from tests.gcs.virtual import on_board
from tests.lab.served import holds_samples
from tests.patience import PATIENCE_S, patiently
from tests.processes import alive
from twodof.cli.app import run
from twodof.flightlog.files import read_log


class Program:
    """A command of ours that runs until it is told to end, and all that it says."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twodof.cli", *arguments],
            env=os.environ | {"TWODOF_DATA": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.lines: list[str] = []
        self._thread = threading.Thread(target=lambda: self.lines.extend(iter(self.process.stdout.readline, "")))
        self._thread.start()

    def said(self) -> dict[str, Any]:
        """Its line of JSON."""
        for _ in patiently():
            if self.lines:
                found: dict[str, Any] = json.loads(self.lines[0])
                return found
            assert self.process.poll() is None
        raise AssertionError

    def ended(self) -> int:
        """Its exit status, after Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        status = self.process.wait(PATIENCE_S)
        self._thread.join(PATIENCE_S)
        return status

    def close(self) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)
        self._thread.join(PATIENCE_S)
        self.process.stdout.close()


@contextmanager
def program(folder: Path, *arguments: str) -> Iterator[Program]:
    running = Program(folder, *arguments)
    try:
        yield running
    finally:
        running.close()


def status(port: int, path: str, token: str = "") -> int:
    """Of a GET."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request("GET", path, headers={"Authorization": f"Bearer {token}"} if token else {})
        return connection.getresponse().status
    finally:
        connection.close()


def test_for_a_network_it_draws_links_says_them_once_and_logs_no_token(tmp_path: Path) -> None:
    with program(
        tmp_path, "lab", "--json", "--host", "0.0.0.0", "--port", "0", "--connect", "udp://127.0.0.1:9"
    ) as lab:
        told = lab.said()
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
            assert lab.ended() == 0
        assert not any(token in line for line in lab.lines[1:] for token in tokens.values())
        assert list(tmp_path.rglob("*token*")) == []


def test_with_token_nobody_on_this_computer_gets_in_without_the_link(tmp_path: Path) -> None:
    with program(tmp_path, "lab", "--json", "--token", "--port", "0", "--connect", "udp://127.0.0.1:9") as lab:
        told = lab.said()
        assert status(told["port"], "/api/session") == 401
        token = parse_qs(urlsplit(told["page"]["command"]).query)["token"][0]
        assert status(told["port"], "/api/session", token) == 200


def test_a_drone_that_it_flies_is_left_disarmed(tmp_path: Path) -> None:
    with (
        on_board(conditions={"rings": True}) as there,
        program(tmp_path, "lab", "--json", "--port", "0", "--connect", there.url) as lab,
    ):
        port = lab.said()["port"]
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
            assert lab.ended() == 0
        assert not there.drone.controller.latest.armed
        (flight,) = (tmp_path / "flights").glob("*.mcap")
        assert len(read_log(flight)["theta"])


def test_a_port_that_somebody_has_is_said_with_the_remedy(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        assert run(["lab", "--port", str(port), "--connect", "udp://127.0.0.1:9"]) == 2
    said = capfd.readouterr().err
    assert f"http://127.0.0.1:{port}" in said
    assert "--port 0" in said


@pytest.mark.waits
def test_up_serves_the_page_of_its_drones_and_takes_it_along(tmp_path: Path) -> None:
    with (
        free_numbers(1) as first,
        program(tmp_path, "up", "--json", "--first", str(first + 1), "--page-port", "0", "--rings") as up,
    ):
        told = up.said()
        link = urlsplit(told["page"]["command"])
        assert (link.hostname, link.query) == ("127.0.0.1", "")
        assert link.port is not None
        assert status(link.port, "/api/session") == 200
        for _ in patiently():
            if status(link.port, f"/api/drones/{first + 1}") == 200:
                break
        children = [
            int(one) for one in Path(f"/proc/{up.process.pid}/task/{up.process.pid}/children").read_text().split()
        ]
        (server,) = [one for one in children if b"\0lab\0--port\0" in Path(f"/proc/{one}/cmdline").read_bytes()]
        assert os.getpriority(os.PRIO_PROCESS, server) == min(19, os.getpriority(os.PRIO_PROCESS, 0) + 5)
        os.kill(server, signal.SIGKILL)
        for _ in patiently():  # it comes back, with its links
            try:
                assert status(link.port, "/api/session") == 200
                break
            except OSError:
                continue
        assert up.ended() == 0
        assert not any(map(alive, children))
