"""`twodof calibrate`: what it prints and writes; that it calibrates is tested where it stands."""

from pathlib import Path

import pytest

from tests.cli.program import Shell
from twodof.calibrate import FLIGHTS, UNKNOWNS, Calibration
from twodof.rig.parameters import lab, load_rig


def made_up(converged: bool) -> Calibration:
    numbers = {unknown.name: unknown.mean for unknown in UNKNOWNS}
    fits = {name: dict.fromkeys(("theta", "q", "x", "v"), 90.0) for name in FLIGHTS}
    return Calibration(lab(), numbers, numbers, fits, fits, fits, 1.0, converged)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("twodof.cli.simulate.calibrate_rig", lambda folder, leave, report: made_up(True))
    return tmp_path


def test_the_written_rig_can_be_flown(folder: Path, shell: Shell) -> None:
    out = folder / "mine.json"
    found = shell(["calibrate", "--data", str(folder), "--out", str(out), "--json"]).json
    assert found["file"] == str(out)
    assert load_rig(out).snapshot() == lab().snapshot() == found["rig"]


def test_people_read_unknowns_and_fits(folder: Path, shell: Shell) -> None:
    out = shell(["calibrate", "--data", str(folder)]).out
    assert all(unknown.name in out for unknown in UNKNOWNS)
    assert all(name in out for name in FLIGHTS)
    assert "converged" in out
    assert out.count("left out") == out.count("ceiling") == len(FLIGHTS)


def test_a_search_without_convergence_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    monkeypatch.setattr("twodof.cli.simulate.calibrate_rig", lambda folder, leave, report: made_up(False))
    assert "NOT converged" in shell(["calibrate", "--data", str(tmp_path)], 1).out


def test_missing_logs_are_the_callers_mistake(tmp_path: Path, shell: Shell) -> None:
    assert shell(["calibrate", "--data", str(tmp_path), "--json"], 2).json["error"]["kind"] == "LogError"
