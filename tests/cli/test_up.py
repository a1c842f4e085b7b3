"""`twodof up`: drones that answer where it says, programs that are kept running, and nothing left behind."""

import asyncio
import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from tests.cli.program import Program, Shell, program
from tests.fleet.drone_numbers import free_numbers
from tests.processes import alive
from twodof.cli.up import LocalDrone, _run, print_places
from twodof.errors import Rejected
from twodof.fleet.local_fleet import MOST_RESTARTS, LocalFleet
from twodof.fleet.virtual_drone import child_error
from twodof.gcs.drone import Drone
from twodof.link.signing import Key, write_key

pytestmark = pytest.mark.slow


@pytest.fixture
def first() -> Iterator[int]:
    """The first of two numbers that no other test has at the time."""
    with free_numbers(2) as found:
        yield found


def up(first: int, folder: Path, *options: str) -> AbstractContextManager[Program]:
    """Run `twodof up` in lockstep, its drones from number `first` on."""
    return program(folder, "up", "--json", "--lockstep", "--first", str(first + 1), *options)


def gone(processes: dict[int, str]) -> bool:
    return not any(map(alive, processes))


@pytest.mark.long
def test_two_drones_are_kept_running_until_ctrl_c(first: int, tmp_path: Path, shell: Shell) -> None:
    write_key(tmp_path / "key", Key.fresh())
    options = ("--rings", "--rig", "paper", "--seed", "41", "--key", "key", "--state", "kept", "--no-safety-switch")
    with up(first, tmp_path, "--drones", "2", *options) as running:
        rows = running.document()["drones"]
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
        said = shell(["up", "--first", str(first + 1), "--rig", "paper"], 2).err
        taken = f"TCP port {5790 + first}, where the flight controller of drone {first + 1} listens, is in use"
        assert f"{taken}; process {running.process.pid} (" in said  # who started it, not its child
        assert re.search(r"--first ([1-9]|10)\b", said)
        assert running.err == []
        killed_and_started_again(running, "fcu")
        killed_and_started_again(running, "companion", 1)
        for row in rows:
            with Drone.connect(row["drone"], drone=row["system"], key=row["key"]) as drone:
                assert not drone.state.armed
        children = running.children()
        assert len(children) == 4
        running.process.send_signal(signal.SIGINT)
        assert running.ended() == 0
        assert gone(children)
        assert len(running.err) == 4


def killed_and_started_again(running: Program, name: str, index: int = 0) -> None:
    """Kills the program `name` of the drone at `index`, and waits until it answers again."""
    victim = [one for one, line in running.children().items() if f" {name} " in line][index]
    count = len(running.err)
    os.kill(victim, signal.SIGKILL)
    running.wait(lambda: len(running.err) >= count + 2, f"{name} did not come back")
    assert re.match(r"\d\d:\d\d:\d\d .* ended with status -9 and is restarted", running.err[-2])
    assert "answers again" in running.err[-1]


@pytest.mark.soak
def test_drones_that_fly_do_not_outlive_their_parent(first: int, tmp_path: Path) -> None:
    with up(first, tmp_path) as running:
        running.document()
        children = running.children()
        running.process.kill()
        running.wait(lambda: gone(children), "children outlive it")


def test_the_start_is_announced_before_it_takes_its_time(capfd: pytest.CaptureFixture[str]) -> None:
    printed = []

    class Fleet(LocalFleet):
        async def start(self) -> None:
            printed.append(capfd.readouterr().err)

        async def run(self) -> None:
            """Run nothing."""

    asyncio.run(_run(Fleet([], [], None, print), [LocalDrone(2)], lockstep=True, json=False))
    assert "starting the drone; the first start compiles the flight code" in printed[0]


@pytest.mark.parametrize("lockstep", [False, True])
def test_people_are_told_who_can_connect(lockstep: bool, capfd: pytest.CaptureFixture[str]) -> None:
    print_places([LocalDrone(2)], lockstep, json=False)
    out = capfd.readouterr().out
    assert f'Drone.connect("{"tcp://127.0.0.1:5792" if lockstep else "udp://127.0.0.1:14582"}")' in out
    assert ("udpin://127.0.0.1:14542" in out) is not lockstep
    assert ("--master=tcp:127.0.0.1:5762" in out) is not lockstep
    assert ("stand still" in out) is lockstep


def test_each_group_has_a_link_to_its_own_drones(shell: Shell, capfd: pytest.CaptureFixture[str]) -> None:
    pages = [{"command": f"http://vm:{port}/", "watch": "http://vm/?token=w"} for port in (8080, 8081, 8082)]
    print_places([LocalDrone(k) for k in range(4)], lockstep=False, json=False, pages=pages)
    out = capfd.readouterr().out
    assert "the page         http://vm:8080/\n" in out
    assert "group 1, drone 1, 2: http://vm:8081/\ngroup 2, drone 3, 4: http://vm:8082/\n" in out
    for options in (["--drones", "3", "--groups", "2"], ["--drones", "2", "--groups", "2", "--no-page"]):
        assert "--groups" in shell(["up", *options], 2).err


def test_last_output_of_a_program_is_shown() -> None:
    error = child_error(["Traceback", "  where it was", "ValueError: 3"], "companion 1", 1)
    assert error.what.splitlines() == [
        "it ended with status 1; its last output:",
        "    Traceback",
        "      where it was",
        "    ValueError: 3",
    ]
    assert child_error([], "companion 1", -9).what.splitlines()[1:] == ["    no output"]


@pytest.mark.soak
def test_a_program_that_keeps_dying_ends_all(first: int, tmp_path: Path) -> None:
    with up(first, tmp_path) as running:
        running.document()
        children: dict[int, str] = {}
        for number in range(MOST_RESTARTS + 1):
            children |= running.children()
            (victim,) = [one for one, line in running.children().items() if " companion " in line]
            count = len(running.err)
            os.kill(victim, signal.SIGKILL)
            lines = 2 if number < MOST_RESTARTS else 1
            running.wait(lambda count=count, lines=lines: len(running.err) >= count + lines, "it said nothing")
        assert "too often: the whole fleet ends" in running.err[-1]
        assert running.ended() == 1
        assert gone(children)


@pytest.mark.long
def test_a_program_that_cannot_start_is_named(first: int, tmp_path: Path, shell: Shell) -> None:
    asked = ["up", "--json", "--first", str(first + 1), "--state", str(tmp_path), "--rig", "no-such-rig.json"]
    said = shell(asked, 2)
    error = json.loads(said.out)["error"]
    assert error["what"] == "cannot be read: No such file or directory"
    assert error["where"] == f"flight controller {first + 1}, no-such-rig.json"
    assert error["remedy"].startswith("name a JSON file")
    assert said.err.count("remedy:") == 1


@pytest.mark.long
@pytest.mark.parametrize(("by", "status"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_an_early_end_leaves_no_process(first: int, tmp_path: Path, by: signal.Signals, status: int) -> None:
    os.mkfifo(tmp_path / "rig")  # which nobody writes: the flight controller waits for it for ever
    with up(first, tmp_path, "--rig", "rig") as running:
        running.wait(lambda: len(running.children()) == 2, "not both were started")
        children = running.children()
        running.process.send_signal(by)
        assert running.ended() == status
        running.wait(lambda: gone(children), "children outlive it")
        assert running.out == []


@pytest.mark.parametrize(
    ("options", "said"), [("--key no-such-key", "no-such-key"), ("--first 10 --drones 2", "1 to 10")]
)
def test_wrong_options_are_refused_before_the_start(options: str, said: str, shell: Shell) -> None:
    assert said in shell(["up", *options.split()], 2).err
