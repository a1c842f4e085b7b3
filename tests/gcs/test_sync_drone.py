"""The synchronous face and the asynchronous one: the same verbs, the same arguments, the same defaults."""

import inspect
from typing import Any

import pytest

from twodof.gcs import AsyncDrone, Drone
from twodof.gcs.control.parameters import AsyncParameters
from twodof.gcs.mavlink.files import AsyncFiles
from twodof.gcs.mavlink.log_download import AsyncLogs
from twodof.gcs.sync_parts import DroneFiles, DroneLogs, DroneParameters, DroneSignal
from twodof.gcs.telemetry.signals import AsyncSignal

# A transport belongs to its loop; the component of a program on board is no script's.
ONLY_ASYNC = {"over"}
HIDDEN = {"connect": {"component"}}


def verbs(kind: type) -> dict[str, Any]:
    """Public methods."""
    found = inspect.getmembers(kind, lambda one: inspect.isfunction(one) or inspect.ismethod(one))
    return {name: one for name, one in found if not name.startswith("_")}


def arguments(verb: Any) -> list[tuple[str, Any, Any]]:
    """Names, kinds and defaults of its parameters."""
    rows = inspect.signature(verb).parameters.values()
    return [(row.name, row.kind, row.default) for row in rows if row.name != "self"]


@pytest.mark.parametrize("name", sorted(set(verbs(AsyncDrone)) - ONLY_ASYNC))
def test_every_verb_of_a_drone_has_both(name: str) -> None:
    there = [row for row in arguments(verbs(AsyncDrone)[name]) if row[0] not in HIDDEN.get(name, ())]
    assert arguments(verbs(Drone)[name]) == there


def test_every_property_of_a_drone_has_both() -> None:
    def properties(kind: type) -> set[str]:
        return {name for name, one in inspect.getmembers(kind) if isinstance(one, property) and name[0] != "_"}

    assert properties(AsyncDrone) <= properties(Drone)


@pytest.mark.parametrize(("face", "there"), [(DroneFiles, AsyncFiles), (DroneLogs, AsyncLogs)])
def test_files_and_logs_have_both(face: type, there: type) -> None:
    assert {name: arguments(verb) for name, verb in verbs(face).items()} == {
        name: arguments(verb) for name, verb in verbs(there).items()
    }


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
