"""`twodof replay`: the form that others rely on, and that what we compile is what flew."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.cli.program import Shell
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog

pytestmark = pytest.mark.slow


def test_the_replay_document_has_its_form(flight_data: Path, shell: Shell) -> None:
    log = str(flight_data / "velocity-doublets-0.25.mat")
    found = shell(["replay", log, "--gains", "student", "--precision", "float64", "--json"]).json
    assert set(found) == {"nrms", "coverage", "windows_s"}
    assert set(found["nrms"]) == set(found["coverage"]) == {"M", "q0", "theta0", "T"}
    # The bound of the drone's own float32 logging (platform.md: 2.5e-7 or better).
    assert max(found["nrms"].values()) <= 3e-7
    assert min(found["coverage"].values()) >= 0.85
    assert all(start < stop for start, stop in found["windows_s"])


def test_only_loops_that_were_active_are_compared(flight_data: Path, shell: Shell) -> None:
    log = str(flight_data / "attitude-steps-10deg-default.mat")
    out, err = shell(["replay", log, "--json"])
    assert set(json.loads(out)["nrms"]) == {"M", "q0"}
    assert err == ""


def test_gains_from_a_file_are_those_that_count(flight_data: Path, tmp_path: Path, shell: Shell) -> None:
    """The default gains with another attitude gain: q0 is off in proportion, M still fits."""
    gains = {"rate": [0.0854, 0.251, 0.00054], "attitude": 5.5, "velocity": [2.4, 2.81], "position": 1.5}
    file = tmp_path / "gains.json"
    file.write_text(json.dumps(gains))
    log = str(flight_data / "attitude-steps-10deg-default.mat")
    out, err = shell(["replay", log, "--gains", str(file), "--json"])
    assert "not the gains it was flown with?" in err
    nrms = json.loads(out)["nrms"]
    assert nrms["q0"] == pytest.approx(0.5, abs=1e-6)
    assert nrms["M"] <= 3e-7


def test_gains_named_by_the_log_are_used(tmp_path: Path, shell: Shell) -> None:
    flight = Laboratory("lab", gains="student").fly("attitude-steps")
    log = str(tmp_path / "student.mcap")
    write_log(flight.log, log)
    for options, right in (([], True), (["--gains", "student"], True), (["--gains", "default"], False)):
        out, err = shell(["replay", log, "--json", *options])
        assert (max(json.loads(out)["nrms"].values()) < 1e-6) is right
        assert ("not the gains it was flown with?" in err) is not right


@pytest.mark.parametrize("gains", ["nowhere.json", "[]"])
def test_bad_gains_are_the_callers_mistake(gains: str, flight_data: Path, tmp_path: Path, shell: Shell) -> None:
    if gains == "[]":
        (tmp_path / "gains.json").write_text(gains)
        gains = str(tmp_path / "gains.json")
    out, err = shell(["replay", str(flight_data / "doublet-0.03.mat"), "--gains", gains], 2)
    assert out == ""
    assert gains in err.replace("\n", "")


@pytest.mark.parametrize("noted", [{"drone": 3}, {"controllers": 3}, {"controllers": ["\x1b[31mred", 4]}])
def test_what_somebody_else_noted_does_not_end_it(
    noted: dict[str, Any], flight_data: Path, tmp_path: Path, shell: Shell
) -> None:
    flown = read_log(flight_data / "attitude-steps-10deg-default.mat")
    log = str(tmp_path / "theirs.mcap")
    write_log(FlightLog(flown.channels, noted), log)
    out, err = shell(["replay", log, "--json"])
    assert set(json.loads(out)["nrms"]) == {"M", "q0"}
    assert "\x1b" not in err
    assert ("a controller of the user's flew" in err) is ("controllers" in noted)
