"""Command 245 is acknowledged when it is true: `twodof fcu` as a process, killed with -9 right after the answer."""

from contextlib import suppress
from pathlib import Path

import pytest

from bench.stack.programs import running
from tests.patience import PATIENCE_S
from twodof.errors import LinkError, LinkLost, Timeout
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.gcs.drone import Drone

pytestmark = pytest.mark.slow

STORE, DEFAULTS = 1, 2


def kept_after_a_kill(folder: Path, gain: float, action: int = STORE) -> float:
    """Sets a gain, stores it or all defaults, and kills the program as soon as that is acknowledged; what is kept."""
    options = ("--listen", "tcpin://127.0.0.1:0", "--state", "state")
    # RuntimeError: it did not end by itself. The client cannot say goodbye either.
    with suppress(RuntimeError, LinkLost, LinkError, Timeout), running("fcu", *options, urls=1, folder=folder) as fcu:
        acknowledged = False
        with Drone.connect(fcu.urls[0].replace("tcpin", "tcp"), timeout=PATIENCE_S) as drone:
            drone.parameters["ATT_KP"] = gain
            drone.command("PREFLIGHT_STORAGE", action, timeout=PATIENCE_S)
            fcu.process.kill()
            acknowledged = True
    assert acknowledged
    assert fcu.process.returncode == -9
    return ParameterStore(folder / "state" / "parameters.json")["ATT_KP"]


@pytest.mark.long
def test_what_was_acknowledged_is_stored_when_the_program_is_killed(tmp_path: Path) -> None:
    assert kept_after_a_kill(tmp_path, 9.0) == 9.0, "an acknowledged saving is lost"


@pytest.mark.soak
def test_defaults_that_were_acknowledged_are_stored_when_the_program_is_killed(tmp_path: Path) -> None:
    with ParameterStore(tmp_path / "state" / "parameters.json", values={"ATT_KP": 7.0}) as store:
        default = store.row("ATT_KP").default
    assert kept_after_a_kill(tmp_path, 9.0, DEFAULTS) == default


@pytest.mark.soak
def test_hundreds_of_kills_lose_nothing_that_was_acknowledged(tmp_path: Path) -> None:
    gains = [round(7.0 + 0.01 * number, 2) for number in range(200)]
    lost = sum(kept_after_a_kill(tmp_path, gain) != gain for gain in gains)
    assert lost == 0, f"{lost} of 200 acknowledged savings are lost"
