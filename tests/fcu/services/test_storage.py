"""Command 245: defaults for all parameters, as QGroundControl asks for them; loading and saving change nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fcu.services.world import World
from twodof.errors import ParameterError
from twodof.fcu.asked import ACCEPTED, DENIED, FAILED, TEMPORARILY_REJECTED, UNSUPPORTED, Verdict
from twodof.fcu.store import Store

STORAGE = 245
LOAD, SAVE, RESET_CONFIG, RESET_SENSORS, RESET_ALL = 0.0, 1.0, 2.0, 3.0, 4.0


def changed() -> World:
    world = World()
    world.store.update({"ATT_KP": 9.0, "THRUST_BAR": 0.5})
    world.run(1)
    world.sent.clear()
    return world


@pytest.mark.parametrize("action", [RESET_CONFIG, RESET_ALL])
def test_all_are_set_to_their_defaults_which_is_told_to_all_and_undone_as_one(action: float) -> None:
    world = changed()
    assert world.command(STORAGE, action, -1.0) == ACCEPTED
    assert world.store.changed() == {}
    assert {"ATT_KP", "THRUST_BAR"} <= {value.param_id for value in world.taken("PARAM_VALUE", None)}
    world.store.undo()
    assert world.store.changed() == {"ATT_KP": 9.0, "THRUST_BAR": 0.5}


@pytest.mark.parametrize("action", [LOAD, SAVE])
def test_what_is_set_is_stored_already(action: float) -> None:
    world = changed()
    world.commander.verdict = Verdict(TEMPORARILY_REJECTED, "another has the lease")
    assert world.command(STORAGE, action) == ACCEPTED
    assert world.store.changed() == {"ATT_KP": 9.0, "THRUST_BAR": 0.5}


def test_saving_fails_where_the_disk_does(tmp_path: Path) -> None:
    (tmp_path / "no").write_text("a file, where a folder is to be")
    store = Store(tmp_path / "no" / "parameters.json")
    world = World(store=store)
    store.set("ATT_KP", 9.0)
    with pytest.raises(ParameterError):
        store.close()
    assert world.command(STORAGE, SAVE) == FAILED
    assert "parameters are not stored" in world.texts()


def test_not_in_flight_and_not_by_who_may_not_command() -> None:
    world = changed()
    world.commander.armed = True
    for action in (LOAD, SAVE, RESET_CONFIG, RESET_ALL):
        assert world.command(STORAGE, action) == TEMPORARILY_REJECTED
    world.commander.armed, world.commander.verdict = False, Verdict(TEMPORARILY_REJECTED, "another has the lease")
    assert world.command(STORAGE, RESET_ALL) == TEMPORARILY_REJECTED
    assert "another has the lease" in world.texts()
    assert world.store.changed() == {"ATT_KP": 9.0, "THRUST_BAR": 0.5}


@pytest.mark.parametrize(("action", "answer"), [(RESET_SENSORS, UNSUPPORTED), (5.0, DENIED), (-1.0, DENIED)])
def test_what_there_is_not_is_refused(action: float, answer: int) -> None:
    assert changed().command(STORAGE, action) == answer
    assert changed().command(STORAGE, float("nan")) == DENIED
