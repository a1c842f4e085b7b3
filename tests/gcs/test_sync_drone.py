"""Synchronous drone: the verbs, arguments and words of the asynchronous one, and the code of its page."""

import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.gcs.virtual import on_board
from twodof import fleet, gcs
from twodof.gcs import AsyncDrone
from twodof.gcs.drone import Drone, DroneFiles, DroneLogs
from twodof.gcs.files import AsyncFiles, AsyncLogs

SCRIPT = """
from twodof.gcs import Drone

with Drone.connect("udpin://127.0.0.1:14540") as drone:
    drone.set_pitch(0.1, thrust=0.4, timeout=2.0)
    with drone.record("flight.mcap") as recording:
        drone.run(1.0)
    reveal_type(drone.version)
    reveal_type(drone.files.read("/a"))
    reveal_type(drone.batch)
    reveal_type(recording)
    drone.set_pitch("up")
    drone.arm(tiemout=3.0)
"""


def verbs(kind: type) -> dict[str, Any]:
    """Public methods."""
    found = inspect.getmembers(kind, lambda one: inspect.isfunction(one) or inspect.ismethod(one))
    return {name: one for name, one in found if not name.startswith("_")}


def test_both_faces_connect_with_the_same_arguments() -> None:
    there = inspect.signature(AsyncDrone.connect).parameters
    here = inspect.signature(Drone.connect).parameters
    assert [(row.name, row.default) for row in here.values()] == [
        (row.name, row.default) for row in there.values() if row.name != "component"
    ]


@pytest.mark.parametrize("name", ["arm", "record", "batch", "state", "stop_setpoints"])
def test_a_call_shows_its_own_words_and_no_async(name: str) -> None:
    member = getattr(Drone, name)
    assert member.__doc__
    assert "async" not in member.__doc__
    if callable(member):
        assert "Async" not in str(inspect.signature(member))
        assert not inspect.iscoroutinefunction(member)


@pytest.mark.parametrize(
    ("here", "there"),
    [(Drone, AsyncDrone), (DroneFiles, AsyncFiles), (DroneLogs, AsyncLogs)],
    ids=lambda one: one.__name__,
)
def test_no_public_member_is_missing(here: type, there: type) -> None:
    members = {name for name in dir(there) if not name.startswith("_")} - {"over"}
    assert members <= set(dir(here))


@pytest.mark.long
def test_type_checkers_see_the_synchronous_signatures(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, "-m", "mypy", "--no-error-summary", "--follow-imports=silent", "script.py"]
    environment = {**os.environ, "MYPYPATH": str(Path(gcs.__file__).parents[2])}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    lines = done.stdout.replace("twodof.gcs.", "").splitlines()
    expected = [
        "def (timeout: float =) -> tuple[str, str, str, str, int, fallback=drone_state.DroneVersion]",
        'Revealed type is "bytes"',
        "AbstractContextManager[full_rate.BatchRows",
        'Revealed type is "recording.Recording"',
        'incompatible type "str"; expected "float"',
        'Unexpected keyword argument "tiemout"',
    ]
    found = [line for line in lines if "Revealed" in line or "error:" in line]
    assert len(found) == len(expected), done.stdout + done.stderr
    for line, text in zip(found, expected, strict=True):
        assert text in line


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "fly-from-python.md"


@contextmanager
def virtual_drone(rig: str = "lab", rings: bool = False) -> Iterator[str]:
    """As that of `fleet`, which tests/fleet holds, without a process of its own."""
    with on_board(rig=rig, lockstep=True, conditions={"rings": rings, "seed": 1}) as there:
        yield there.url


@pytest.mark.long
def test_the_code_on_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 6
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fleet, "virtual_drone", virtual_drone)
    exec(compile("\n".join(blocks), str(PAGE), "exec"), {"__name__": "__main__"})
    assert "done" in capsys.readouterr().out
    assert (tmp_path / "flight.mat").is_file()


def test_every_verb_in_the_table_is_one_of_the_drones() -> None:
    table = PAGE.read_text(encoding="utf-8").split("| verb | is |")[1].split("\n\n")[0]
    verbs = re.findall(r"`(\w+)\(", table)
    assert len(verbs) > 15
    assert [verb for verb in verbs if not callable(getattr(Drone, verb, None))] == []
