"""A controller is tried on the virtual rig before it is flashed: what is unstable does not fly unless it is forced."""

from dataclasses import replace
from pathlib import Path

import pytest

from twodof.blocks import Diagram
from twodof.cli.app import run
from twodof.fleet import flash as module
from twodof.fleet.flash import trial_flight
from twodof.flight.controller_store import simulator_controllers
from twodof.flight.starters import save_diagram, starter

pytestmark = pytest.mark.slow


def wild() -> Diagram:
    """Four times the rate gain: 70 rad/s is beyond what the rotors follow."""
    d = starter("pid-attitude")
    d.params["q_kp"] = replace(d.params["q_kp"], value=0.35)
    return d


@pytest.mark.long
def test_the_flight_alone_sees_the_swing_that_the_margins_foretell(monkeypatch: pytest.MonkeyPatch) -> None:
    foretold = trial_flight(wild(), "attitude_control")
    motion = foretold.margins["motors"].motion
    assert motion is not None
    assert foretold.fault.endswith("growing")
    monkeypatch.setattr(module, "cascade_margins", lambda *_: {})
    seen = trial_flight(wild(), "attitude_control").fault
    assert seen.startswith("swings at ")
    # It has grown to what the limits allow, where the rotors' gain is less and the swing slower.
    assert float(seen.split()[2]) == pytest.approx(motion.omega, rel=0.15)


@pytest.mark.long
def test_flash_refuses_it_and_can_be_forced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TWODOF_DATA", str(tmp_path / "data"))
    file = tmp_path / "wild.json"
    save_diagram(wild(), file)
    asked = ["flash", str(file), "--to", "sim"]
    assert run(asked) == 2
    assert "unstable on the virtual rig: swings at" in capfd.readouterr().err
    assert not simulator_controllers().flashed()
    assert run([*asked, "--force-unstable"]) == 0
    out = capfd.readouterr().out
    assert "UNSTABLE: swings at" in out
    assert "flashed:" in out
