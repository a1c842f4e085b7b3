"""The synchronous drone is made of the asynchronous one: the same verbs, arguments, defaults and words."""

import inspect
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from twodof import gcs
from twodof.gcs import AsyncDrone, Drone
from twodof.gcs.drone import DroneFiles, DroneLogs, DroneParameters, DroneSignal
from twodof.gcs.files import AsyncFiles, AsyncLogs
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.telemetry import AsyncSignal

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


def test_what_connects_takes_the_same_but_for_the_component_of_a_program_on_board() -> None:
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


def test_what_waits_has_a_deadline_that_can_be_given() -> None:
    """Every verb that waits for an answer takes `timeout`; those that let time pass end by it."""
    by_time = {"run", "run_until"}
    waits = {
        f"{kind.__name__}.{name}": verb
        for kind in (AsyncDrone, AsyncFiles, AsyncLogs, AsyncParameters, AsyncSignal)
        for name, verb in verbs(kind).items()
        if inspect.iscoroutinefunction(verb) and name not in by_time
    }
    assert len(waits) > 30
    assert [name for name, verb in waits.items() if "timeout" not in inspect.signature(verb).parameters] == []


def test_the_mapping_of_parameters_has_what_a_mapping_lacks() -> None:
    for name in ("all", "undo", "describe"):
        assert name in verbs(DroneParameters)
        assert "timeout" in inspect.signature(verbs(DroneParameters)[name]).parameters
    assert {"next", "on"} <= set(verbs(DroneSignal))


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
