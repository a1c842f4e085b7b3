"""The synchronous drone is made of the asynchronous one: the same verbs, arguments, defaults and words."""

import importlib.util
import inspect
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import pytest

from twodof.gcs import AsyncDrone, Drone
from twodof.gcs.files import AsyncFiles, AsyncLogs
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.sync_drone import DroneParameters, DroneSignal
from twodof.gcs.sync_face import SyncFace, synchronous
from twodof.gcs.telemetry import AsyncSignal

TOOL = Path(__file__).resolve().parents[2] / "tools" / "sync_stub.py"


def verbs(kind: type) -> dict[str, Any]:
    """Public methods."""
    found = inspect.getmembers(kind, lambda one: inspect.isfunction(one) or inspect.ismethod(one))
    return {name: one for name, one in found if not name.startswith("_")}


def test_the_stub_for_editors_and_mypy_is_the_one_that_the_tool_writes() -> None:
    spec = importlib.util.spec_from_file_location("sync_stub", TOOL)
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.STUB.read_text() == tool.stub(), "run tools/sync_stub.py"


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


def test_a_class_whose_annotations_are_not_text_is_refused() -> None:
    class There:
        def recording(self) -> AbstractAsyncContextManager[None]:
            raise NotImplementedError

    with pytest.raises(TypeError, match=r"There.recording: its module must import `annotations` from the future"):
        synchronous(There)(SyncFace)
