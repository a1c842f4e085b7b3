"""`twodof fly`: an experiment over MAVLink from the command line, and what is identified from its log."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from twodof.cli.app import run
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import read_log

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_flown_experiment_equals_the_simulated_one(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "flight.mat")
    assert run(["fly", "doublet", "--rig", "paper", "--seed", "3", "--out", file, "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert (found["good"], found["reason"], found["rig"], found["seed"]) == (True, None, "paper", 3)
    assert {check["name"] for check in found["checks"]} >= {"flown to its end", "failsafe silent", "samples received"}
    assert run(["identify", file, "--experiment", "doublet", "--json"]) == 0
    identified = json.loads(capfd.readouterr().out)["estimates"]["mu"]["value"]
    assert identified == pytest.approx(358.5, rel=0.02)
    simulated = Laboratory("paper").fly("doublet", 3).log["q"].value
    np.testing.assert_array_equal(read_log(file)["q"].value, simulated.astype(np.float32))


@pytest.mark.long
def test_what_cannot_be_flown_is_said(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["fly", "doublt", "--rig", "paper"]) == 2
    assert "no experiment called 'doublt'" in capfd.readouterr().err
    assert run(["fly", "doublet", "--rig", "paper", "--url", "tcp://127.0.0.1:5790"]) == 2
    assert "two drones" in capfd.readouterr().err
    assert run(["fly", "doublet", "--rig", "no-such-rig.json"]) == 2
    assert "no-such-rig.json" in capfd.readouterr().err


@pytest.mark.long
def test_progress_goes_to_a_terminal_only(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Stage and state of the drone appear on stderr of a terminal; stdout has JSON alone."""
    flown = ["fly", "impulse", "--rig", "paper", "--json"]
    assert run(flown) == 0
    told = capfd.readouterr()
    assert (json.loads(told.out)["good"], told.err) == (True, "")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    assert run(flown) == 0
    seen = capfd.readouterr()
    assert json.loads(seen.out)["good"] is True
    for word in ("starting the drone", "done"):
        assert word in seen.err
    assert re.search(
        r"theta +[+-]\d+\.\d deg +x [+-]0\.\d{3} m +M [+-]0\.\d{3}", re.sub(r"\x1b\[[\d;?]*\w", "", seen.err)
    )
