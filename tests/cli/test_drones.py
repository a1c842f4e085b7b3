"""`twodof drones`: what is heard is listed, for people and for machines; an empty list is not an error."""

import pytest

from tests.cli.program import Shell
from tests.gcs.virtual import on_board
from tests.patience import patiently
from twodof.cli import connection
from twodof.gcs.discovery import FoundDrone, discover


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Places that are looked at, instead of the ports that somebody else may use while this test runs."""
    places: list[str] = []

    async def look(timeout: float, hosts: list[str]) -> list[FoundDrone]:
        return await discover(timeout, hosts, places=places)

    monkeypatch.setattr(connection, "discover", look)
    return places


@pytest.fixture
def patient(only: list[str], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The same, looked at until each has told all: how soon it does is not what is asked here."""

    async def look(timeout: float, hosts: list[str]) -> list[FoundDrone]:
        for _ in patiently():
            found = await discover(timeout, hosts, places=only)
            if len(found) == len(only) and all(one.changed is not None for one in found):
                return found
        return []

    monkeypatch.setattr(connection, "discover", look)
    return only


def test_a_drone_is_listed(patient: list[str], shell: Shell) -> None:
    with on_board(index=8) as there:
        patient.append(there.url)
        (row,) = shell(["drones", "--timeout", "0.1", "--json"]).json
        assert (row["system"], row["url"], row["mode"], row["armed"], row["autopilot"]) == (
            9,
            there.url,
            "manual",
            False,
            "px4",
        )
        assert (row["controller"], row["changed"]) == ("stock", 0)
        there.drone.assembly.store.update({"ATT_KP": 9.0, "RATE_KP": 0.08})
        said = " ".join(shell(["drones", "--timeout", "0.1"]).out.split())
        assert there.url in said
        assert "flies the stock controllers; 2 parameters differ from their defaults" in said


def test_nobody_is_there(only: list[str], shell: Shell) -> None:
    only.append("mem://nobody")
    assert "no drone was heard within 0.1 s" in shell(["drones", "--timeout", "0.1"]).out
