"""State left on a drone is told, and `--fresh` starts without it."""

from pathlib import Path

import pytest

from twodof.errors import DiagramError
from twodof.fcu.control.controllers import Controllers
from twodof.fleet.local_drone import controller_in_words
from twodof.flight.controller_store import ControllerStore
from twodof.flight.starters import starter
from twodof.sim.virtual_drone import VirtualDrone


@pytest.mark.parametrize(
    ("controller", "changed", "words"),
    [
        ("stock", 0, "flies the stock controllers; all parameters are at their defaults"),
        ("mine", 1, "flies mine; 1 parameter differs from its default"),
        ("mine", 3, "flies mine; 3 parameters differ from their defaults"),
    ],
)
def test_it_is_said_in_words(controller: str, changed: int, words: str) -> None:
    assert controller_in_words(controller, changed) == words


def test_fresh_forgets_controllers_and_parameters_and_keeps_the_logs(tmp_path: Path) -> None:
    for folder in ("flying", "controllers"):
        ControllerStore(tmp_path / folder).flash(starter("stock-motor"))
    before = VirtualDrone(lockstep=True, state=tmp_path)
    before.assembly.store.update({"ATT_KP": 9.0, "RATE_KP": 0.08})
    assert before.flown.changed == 2
    before.assembly.close()
    again = VirtualDrone(lockstep=True, state=tmp_path)
    assert again.flown.changed == 2
    again.assembly.close()
    fresh = VirtualDrone(lockstep=True, state=tmp_path, fresh=True)
    assert (fresh.flown.controller, fresh.flown.changed) == ("stock", 0)
    fresh.assembly.close()
    for folder in ("flying", "controllers"):
        assert list((tmp_path / folder).iterdir()) == []
    assert (tmp_path / "logs").is_dir()
    last = VirtualDrone(lockstep=True, state=tmp_path)
    assert last.flown.changed == 0
    last.assembly.close()


def test_what_cannot_be_forgotten_is_said(tmp_path: Path) -> None:
    (tmp_path / "flying" / "attitude_control.json").mkdir(parents=True)
    controllers = Controllers(uploads=tmp_path / "controllers", kept=tmp_path / "flying")
    with pytest.raises(DiagramError, match="cannot be removed"):
        controllers.forget()
