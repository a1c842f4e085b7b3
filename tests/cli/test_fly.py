"""`twodof fly`: an experiment over MAVLink from the command line, and what is identified from its log."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.cli.program import Shell
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import read_log

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_flown_experiment_equals_the_simulated_one(tmp_path: Path, shell: Shell) -> None:
    file = str(tmp_path / "flight.mat")
    found = shell(["fly", "doublet", "--rig", "paper", "--seed", "3", "--out", file, "--json"]).json
    assert (found["good"], found["reason"], found["rig"], found["seed"]) == (True, None, "paper", 3)
    assert {check["name"] for check in found["checks"]} >= {"flown to its end", "failsafe silent", "samples received"}
    identified = shell(["identify", file, "--experiment", "doublet", "--json"]).json["estimates"]["mu"]["value"]
    assert identified == pytest.approx(358.5, rel=0.02)
    simulated = Laboratory("paper").fly("doublet", 3).log["q"].value
    np.testing.assert_array_equal(read_log(file)["q"].value, simulated.astype(np.float32))


@pytest.mark.long
def test_what_cannot_be_flown_is_said(shell: Shell) -> None:
    assert "no experiment called 'doublt'" in shell(["fly", "doublt", "--rig", "paper"], 2).err
    assert "two drones" in shell(["fly", "doublet", "--rig", "paper", "--url", "tcp://127.0.0.1:5790"], 2).err
    assert "no-such-rig.json" in shell(["fly", "doublet", "--rig", "no-such-rig.json"], 2).err


@pytest.mark.long
def test_progress_goes_to_a_terminal_only(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stage and state of the drone appear on stderr of a terminal; stdout has JSON alone."""
    flown = ["fly", "impulse", "--rig", "paper", "--json"]
    told = shell(flown)
    assert (json.loads(told.out)["good"], told.err) == (True, "")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    seen = shell(flown)
    assert json.loads(seen.out)["good"] is True
    for word in ("starting the drone", "done"):
        assert word in seen.err
    assert re.search(
        r"theta +[+-]\d+\.\d deg +x [+-]0\.\d{3} m +M [+-]0\.\d{3}", re.sub(r"\x1b\[[\d;?]*\w", "", seen.err)
    )
