"""`twodof up`: drones that answer where it says, programs that are kept running, and nothing left behind."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.fleet.drone_numbers import free_numbers
from tests.patience import PATIENCE_S
from tests.processes import alive
from twodof.cli.app import run
from twodof.cli.up import LocalDrone, print_places
from twodof.errors import Rejected
from twodof.fleet.children import child_error
from twodof.fleet.local_fleet import MOST_RESTARTS
from twodof.gcs.drone import Drone
from twodof.link.signing import Key, write_key

pytestmark = pytest.mark.slow


@pytest.fixture
def first() -> Iterator[int]:
    """The first of two numbers that no other test has at the time."""
    with free_numbers(2) as found:
        yield found


class Up:
    """`twodof up` as a process, its drones from number `first` on, and what it says."""

    def __init__(self, first: int, folder: Path, *options: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twodof.cli", "up", "--json", "--lockstep", "--first", str(first + 1), *options],
            cwd=folder,
            env=os.environ | {"XDG_DATA_HOME": str(folder), "TWODOF_DATA": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.out: list[str] = []
        self.said: list[str] = []
        self._threads = [
            threading.Thread(target=lambda: self.out.extend(iter(self.process.stdout.readline, ""))),
            threading.Thread(target=lambda: self.said.extend(iter(self.process.stderr.readline, ""))),
        ]
        for thread in self._threads:
            thread.start()

    def wait(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"{what}: {self.out} {self.said}"
            time.sleep(0.02)

    def drones(self) -> list[dict[str, Any]]:
        self.wait(lambda: self.out or self.process.poll() is not None, "no drone came up")
        assert self.out, self.said
        rows: list[dict[str, Any]] = json.loads(self.out[0])["drones"]
        return rows

    def children(self) -> dict[int, str]:
        """Its child processes: process id -> command line."""
        ids = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return {int(one): Path(f"/proc/{one}/cmdline").read_text().replace("\0", " ") for one in ids}

    def ended(self) -> int:
        """Its exit status, once it has ended and all its words are in `out` and `said`."""
        status = self.process.wait(PATIENCE_S)
        for thread in self._threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive(), "somebody has its other end"
        return status

    def close(self) -> None:
        self.process.kill()
        self.ended()
        self.process.stdout.close()
        self.process.stderr.close()


@contextmanager
def up(first: int, folder: Path, *options: str) -> Iterator[Up]:
    program = Up(first, folder, *options)
    try:
        yield program
    finally:
        program.close()


def gone(processes: dict[int, str]) -> bool:
    return not any(map(alive, processes))


@pytest.mark.long
def test_two_drones_answer_where_it_says_what_dies_is_started_again_and_all_ends_at_ctrl_c(
    first: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_key(tmp_path / "key", Key.fresh())
    options = ("--rings", "--rig", "paper", "--seed", "41", "--key", "key", "--state", "kept", "--no-safety-switch")
    with up(first, tmp_path, "--drones", "2", *options) as program:
        rows = program.drones()
        assert [row["system"] for row in rows] == [first + 1, first + 2]
        for row, seed in zip(rows, (41, 42), strict=True):
            with Drone.connect(row["drone"], drone=row["system"], key=row["key"]) as drone:
                rig = drone.state.rig
                assert (rig.name, rig.rings_locked, rig.lockstep, rig.seed) == ("paper", True, True, seed)
                drone.run(0.1)
                with pytest.raises(Rejected, match="safety switch"):
                    drone.arm()
            assert (row["controller"], row["changed"]) == ("stock", 0)
            assert Path(row["state"]) == tmp_path / "kept" / f"drone-{row['index']}"
            assert (Path(row["state"]) / "stamps.json").is_file()  # it signs
        assert run(["up", "--first", str(first + 1), "--rig", "paper"]) == 2
        said = capfd.readouterr().err
        taken = f"TCP port {5790 + first}, where the flight controller of drone {first + 1} listens, is in use"
        assert f"{taken}; process {program.process.pid} (" in said  # who started it, not its child
        assert re.search(r"--first ([1-9]|10)\b", said)
        assert program.said == []
        killed_and_started_again(program, "fcu")
        killed_and_started_again(program, "companion", 1)
        for row in rows:
            with Drone.connect(row["drone"], drone=row["system"], key=row["key"]) as drone:
                assert not drone.state.armed
        children = program.children()
        assert len(children) == 4
        program.process.send_signal(signal.SIGINT)
        assert program.ended() == 0
        assert gone(children)
        assert len(program.said) == 4


def killed_and_started_again(program: Up, name: str, index: int = 0) -> None:
    """Kills the program `name` of the drone at `index`, and waits until it answers again."""
    victim = [one for one, line in program.children().items() if f" {name} " in line][index]
    count = len(program.said)
    os.kill(victim, signal.SIGKILL)
    program.wait(lambda: len(program.said) >= count + 2, f"{name} did not come back")
    assert re.match(r"\d\d:\d\d:\d\d .* ended with status -9 and is restarted", program.said[-2])
    assert "answers again" in program.said[-1]


@pytest.mark.soak
def test_drones_that_fly_do_not_outlive_their_parent(first: int, tmp_path: Path) -> None:
    with up(first, tmp_path) as program:
        program.drones()
        children = program.children()
        program.process.kill()
        program.wait(lambda: gone(children), "children outlive it")


@pytest.mark.parametrize("lockstep", [False, True])
def test_people_are_told_who_can_connect(lockstep: bool, capfd: pytest.CaptureFixture[str]) -> None:
    print_places([LocalDrone(2)], lockstep, json=False)
    out = capfd.readouterr().out
    assert f'Drone.connect("{"tcp://127.0.0.1:5792" if lockstep else "udp://127.0.0.1:14582"}")' in out
    assert ("udpin://127.0.0.1:14542" in out) is not lockstep
    assert ("--master=tcp:127.0.0.1:5762" in out) is not lockstep
    assert ("stand still" in out) is lockstep


def test_what_a_program_last_said_is_shown_line_by_line() -> None:
    error = child_error(["Traceback", "  where it was", "ValueError: 3"], "companion 1", 1)
    assert error.what.splitlines() == [
        "it ended with status 1; its last output:",
        "    Traceback",
        "      where it was",
        "    ValueError: 3",
    ]
    assert child_error([], "companion 1", -9).what.splitlines()[1:] == ["    no output"]


@pytest.mark.soak
def test_a_program_that_dies_again_and_again_ends_all(first: int, tmp_path: Path) -> None:
    with up(first, tmp_path) as program:
        program.drones()
        children: dict[int, str] = {}
        for number in range(MOST_RESTARTS + 1):
            children |= program.children()
            (victim,) = [one for one, line in program.children().items() if " companion " in line]
            count = len(program.said)
            os.kill(victim, signal.SIGKILL)
            lines = 2 if number < MOST_RESTARTS else 1
            program.wait(lambda count=count, lines=lines: len(program.said) >= count + lines, "it said nothing")
        assert "too often, all end" in program.said[-1]
        assert program.ended() == 1
        assert gone(children)


@pytest.mark.long
def test_a_program_that_cannot_start_is_named_with_what_it_says(
    first: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    asked = ["up", "--json", "--first", str(first + 1), "--state", str(tmp_path), "--rig", "no-such-rig.json"]
    assert run(asked) == 2
    said = capfd.readouterr()
    error = json.loads(said.out)["error"]
    assert error["what"] == "cannot be read: No such file or directory"
    assert error["where"] == f"flight controller {first + 1}, no-such-rig.json"
    assert error["remedy"].startswith("name a JSON file")
    assert said.err.count("remedy:") == 1


@pytest.mark.parametrize(("by", "status"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_ended_before_all_are_up_it_says_so_by_its_status_and_nothing_outlives_it(
    first: int, tmp_path: Path, by: signal.Signals, status: int
) -> None:
    os.mkfifo(tmp_path / "rig")  # which nobody writes: the flight controller waits for it for ever
    with up(first, tmp_path, "--rig", "rig") as program:
        program.wait(lambda: len(program.children()) == 2, "not both were started")
        children = program.children()
        program.process.send_signal(by)
        assert program.ended() == status
        program.wait(lambda: gone(children), "children outlive it")
        assert program.out == []


def test_a_key_that_cannot_be_read_is_told_before_anything_is_started(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["up", "--key", "no-such-key"]) == 2
    assert "no-such-key" in capfd.readouterr().err


def test_drones_beyond_the_ports_that_clients_know_are_refused(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["up", "--first", "10", "--drones", "2"]) == 2
    assert "1 to 10" in capfd.readouterr().err
