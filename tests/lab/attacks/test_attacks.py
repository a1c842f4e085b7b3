"""Attacks on the server of `twodof up`: kills get through, and the client that commands flies and tunes."""

import http.client
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import inf
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.cli.program import Program, program
from tests.fleet.drone_numbers import free_numbers
from tests.lab.attacks.attacker import ATTACKS
from tests.lab.served import COMMAND, WATCH, Served
from tests.patience import patiently
from twodof.lab.settings import COMMAND_TOKEN, WATCH_TOKEN

pytestmark = pytest.mark.slow
QUICK = {"idle_connections", "many_harmonics", "many_streams", "compilations", "paths_that_end_as_a_kill"}
PYTHON = sys.executable
SAMPLES, MOST_S = 101, 0.3
WITHOUT = " without a token"


class Kills(NamedTuple):
    """Median, 99th percentile and worst of the times of kills [s], infinite for one not confirmed."""

    p50: float
    p99: float
    worst: float

    def __str__(self) -> str:
        return f"p50 {1e3 * self.p50:.0f}, p99 {1e3 * self.p99:.0f}, worst {1e3 * self.worst:.0f} ms"


class Flown(NamedTuple):
    """Server with a drone, and the times of kills without an attack."""

    server: Served
    number: int
    quiet: Kills


def kills(server: Served, number: int, count: int = SAMPLES) -> Kills:
    """Kill and release the drone; return the kills' times.

    Half of the kills come over the page's connection, the others over new ones.
    """
    times = []
    with closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)) as kept:
        for k in range(count):
            connection = kept if k % 2 else http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
            began = time.monotonic()
            headers = {"Authorization": f"Bearer {COMMAND if k % 4 < 2 else WATCH}"}
            connection.request("POST", f"/api/drones/{number}/kill", None, headers)
            answer = connection.getresponse()
            answer.read()
            times.append(time.monotonic() - began if answer.status == 200 else inf)
            assert answer.status in {200, 504}
            if connection is not kept:
                connection.close()
            assert server.ask("POST", f"/api/drones/{number}/release").status == 200
    times.sort()
    return Kills(times[count // 2], times[int(0.99 * count)], times[-1])


@contextmanager
def up(folder: Path, number: int) -> Iterator[tuple[Program, Served]]:
    options = ("--json", "--token", "--first", str(number), "--page-port", "0", "--fresh")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(COMMAND_TOKEN, COMMAND)
        patch.setenv(WATCH_TOKEN, WATCH)
        with program(folder, "up", *options) as running:
            page = running.document()["page"]
            assert page is not None, running.err
            server = Served(int(page["command"].split(":")[2].split("/")[0]), folder, COMMAND)
            assert any(server.ask("GET", f"/api/drones/{number}").status == 200 for _ in patiently())
            yield running, server


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flown]:
    with free_numbers(1) as first, up(tmp_path_factory.mktemp("up"), first + 1) as (_, server):
        kills(server, first + 1, 4)
        yield Flown(server, first + 1, kills(server, first + 1))


@contextmanager
def attacked(flown: Flown, name: str) -> Iterator[None]:
    """Run an attack in a process with a low priority, because attackers have computers of their own."""
    name, bare, _ = name.partition(WITHOUT)
    command = ["nice", "-n", "5", PYTHON, "-m", "tests.lab.attacks.attacker", name, str(flown.server.port)]
    environment = os.environ | {"WATCH": "" if bare else WATCH, "DRONE": str(flown.number)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as attacker:
        try:
            assert attacker.stdout is not None
            assert attacker.stdout.readline() == b"under way\n"
            yield
        finally:
            attacker.kill()


def fly_and_tune(server: Served, number: int) -> None:
    """Fly to set-points, change a gain and hear telemetry, as the page of the client that commands does."""
    drone = f"/api/drones/{number}"
    with server.socket() as client:
        client.subscribe(["estimate.theta"], drone=number)
        assert server.ask("POST", f"{drone}/arm").status == 200
        for k in range(5):
            asked = {"loop": "theta", "value": 0.02 * (-1) ** k}
            assert server.ask("PUT", f"{drone}/setpoint", asked).status == 200
            gains = {"ATT_KP": 11.0 - 0.1 * (k % 2)}
            # A busy computer may answer too late; the remedy is to set it again.
            assert any(server.ask("PATCH", f"{drone}/parameters", gains).status == 200 for _ in range(3))
            now = client.frame().times[-1]
            while client.frame().times[-1] < now + 0.1:
                pass
        assert server.ask("GET", drone).json["armed"]
        assert server.ask("POST", f"{drone}/mode", {"mode": "hold"}).status == 200
        assert server.ask("POST", f"{drone}/disarm").status == 200


TRIES = 3
BARE = ("chunks_of_a_byte", "http_2", "half_closed_connections", "many_headers", "many_cookies", "many_ranges")
NAMES = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.soak)
    for name in (*ATTACKS, *(f"{name}{WITHOUT}" for name in BARE))
]


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_kills_get_through_and_the_commander_flies(flown: Flown, name: str) -> None:
    for turn in range(TRIES):
        with attacked(flown, name):
            if turn == 0:
                fly_and_tune(flown.server, flown.number)
            found = kills(flown.server, flown.number)
        # A busy computer delays everything: the same kills without the attack show by how much. Other tests come and
        # go meanwhile; a server that does not hold misses the limit each time.
        most = MOST_S if found.p99 < MOST_S else max(MOST_S, 3 * kills(flown.server, flown.number).p99)
        if found.p99 < most:
            break
    if path := os.environ.get("ATTACK_FIGURES"):
        with Path(path).open("a") as file:
            file.write(f"{name}: {found}; without: {flown.quiet}\n")
    assert found.p99 < most


@pytest.mark.long
def test_few_descriptors_serve_the_stop_and_end(tmp_path: Path) -> None:
    with free_numbers(1) as first, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "executable", str(_limited(tmp_path)))
        with up(tmp_path, first + 1) as (running, server):
            with attacked(Flown(server, first + 1, kills(server, first + 1, 4)), "idle_connections"):
                kills(server, first + 1, 4)
            running.process.send_signal(signal.SIGTERM)
            assert running.ended() == 0


def _limited(folder: Path) -> Path:
    """Write a program that runs Python with at most 64 open files."""
    script = folder / "python"
    script.write_text(f'#!/bin/sh\nulimit -n 64\nexec "{sys.executable}" "$@"\n')
    script.chmod(0o700)
    return script
