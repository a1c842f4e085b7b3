"""`twodof simulate`: a flight from a seed, a flight like a log, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.program import Shell
from twodof.cli.app import run
from twodof.flight.starters import new_diagram
from twodof.flightlog.files import read_log

pytestmark = pytest.mark.slow


def test_a_seed_determines_the_flight(tmp_path: Path, shell: Shell) -> None:
    logs = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        file = tmp_path / f"{name}.parquet"
        found = shell(["simulate", "doublet", "--rig", "paper", "--seed", str(seed), "--out", str(file), "--json"]).json
        assert found["good"] is True
        assert found["file"] == str(file)
        logs.append(read_log(file))
    np.testing.assert_array_equal(logs[0]["q"].value, logs[1]["q"].value)
    assert np.any(logs[0]["q"].value != logs[2]["q"].value)
    assert logs[0].provenance["seed"] == 1


def test_the_document_of_like_has_its_form(flight_data: Path, shell: Shell) -> None:
    log = str(flight_data / "rate-doublets-30dps-student.mat")
    arguments = ["simulate", "--like", log, "--rig", "lab", "--gains", "student", "--window", "346.6", "355.6"]
    found = shell([*arguments, "--json"]).json
    assert set(found) == {"fit_percent", "windows_s"}
    assert set(found["fit_percent"]) == {"theta", "q", "x", "v"}
    assert found["windows_s"] == [[346.6, 355.6]]
    # The bound for this flight.
    assert found["fit_percent"]["q"] >= 88.0


def test_a_public_log_brings_gains_and_window(flight_data: Path, tmp_path: Path, shell: Shell) -> None:
    log = tmp_path / "renamed.mat"
    log.write_bytes((flight_data / "rate-doublets-30dps-student.mat").read_bytes())
    answers = []
    for options in ([], ["--gains", "student", "--window", "346.6", "355.6"]):
        out, err = shell(["simulate", "--like", str(log), "--json", *options])
        answers.append(json.loads(out))
        assert ("its gains (student) and its window (346.6 to 355.6 s)" in err) is not bool(options)
    assert answers[0] == answers[1]
    # What is asked for counts: with the gains it was not flown with, the fit falls.
    assert (
        shell(["simulate", "--like", str(log), "--json", "--gains", "default"]).json["fit_percent"]["q"]
        < answers[0]["fit_percent"]["q"]
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "one of the two"),
        (["doublet", "--like", "x.mat"], "one of the two"),
        (["doublet", "--window", "0", "1"], "--like"),
        (["nonsense"], "no experiment called"),
        (["doublet", "--rig", "nonsense"], "one of paper, lab"),
        (["doublet", "--gains", "nonsense"], "nonsense"),
        (["doublet", "--seed", "4294967296"], "4294967295"),
        (["doublet", "--out", "flight.foo"], ".foo"),
        (["--like", "nowhere.mat"], "nowhere.mat"),
        (["--like", "x.mat", "--controller", "lqr-attitude"], "--controller"),
        *(
            (["doublet", "--charge", charge], "where: --charge")
            for charge in ("full", "1.5", "-0.1", "nan", "estimate")
        ),
    ],
)
def test_a_mistake_is_refused_with_its_remedy(
    arguments: list[str], says: str, shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out, err = shell(["simulate", *arguments], 2)
    assert out == ""
    assert says in err
    assert list(tmp_path.iterdir()) == []


def test_initial_values_are_not_listed_among_gains(shell: Shell) -> None:
    out = shell(["simulate", "attitude-steps", "--controller", "notch-attitude"]).out
    assert "attitude_control.notch_hz = 38 Hz" in out
    assert "attitude_control.notch.initial" not in out
    assert "and 5 more, initial values among them" in out


def test_a_users_controller_flies_tuned(tmp_path: Path, shell: Shell) -> None:
    file = tmp_path / "mine.json"
    new_diagram("lqr-attitude", file)
    arguments = ["simulate", "attitude-steps", "--controller", str(file), "--precision", "float32"]
    found = shell([*arguments, "--tune", "attitude_control.k_i=0.5", "--json"]).json
    assert found["precision"] == "float32"
    made = found["controllers"]["attitude_control"]
    assert made["name"] == "lqr_attitude"
    assert made["parameters"]["k_i"] == 0.5
    assert len(made["parameters"]["k_past"]) == 5
    out = shell([*arguments, "--tune", "attitude_control.k_past=0,0,0,0,0"]).out
    assert "attitude_control.k_past = 0, 0, 0, 0, 0 (-2 to 2): attitude: gains on the past moments" in out
    assert "ok     commands finite: M and T" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--controller", "nothing"], "lqr-attitude"),
        (["--controller", "lqr-attitude", "--controller", "pid-attitude"], "are both of the template"),
        (["--controller", "lqr-attitude", "--tune", "attitude_control.k_q=2"], "outside 0 to 1"),
        (["--controller", "lqr-attitude", "--tune", "k_q=0.1"], "attitude_control.k_q"),
        (["--controller", "lqr-attitude", "--tune", "attitude_control.k_q"], "PATH=VALUE"),
        (["--controller", "flashed"], "twodof flash FILE --to sim"),
        (["--precision", "half"], "float32"),
    ],
)
def test_a_controller_that_cannot_fly_is_refused(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    monkeypatch.setenv("TWODOF_DATA", str(tmp_path))
    assert said in shell(["simulate", "attitude-steps", *arguments], 2).err


def test_thrust_sags_with_the_charge(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """An open loop turns as fast as the supply says: the square of the voltage, at charge .5 84 % of the full one."""
    rates = []
    for charge in ("1", "0.5"):
        file = str(tmp_path / f"{charge}.mat")
        assert run(["simulate", "doublet", "--rig", "lab", "--charge", charge, "--out", file]) == 0
        rates.append(float(np.ptp(read_log(file)["q"].value)))
    capfd.readouterr()
    supply = ((0.5 * (12.6 + 10.5) - 0.03 * 6.0) / (12.6 - 0.03 * 6.0)) ** 2
    # The gusts are of the same seed and in proportion to the thrust, but the hold before answers them otherwise.
    assert rates[1] / rates[0] == pytest.approx(supply, rel=0.06)


@pytest.mark.long
def test_the_charge_is_estimated_from_the_flight(flight_data: Path, shell: Shell) -> None:
    log = str(flight_data / "position-sweep-default.mat")
    found = shell(["simulate", "--like", log, "--charge", "estimate", "--json"]).json
    assert 0.0 <= found["charge"]["charge"] <= 1.0
    assert found["charge"]["deviation"] > 0.0
    assert "charge, from the compared flight itself" in shell(["simulate", "--like", log, "--charge", "estimate"]).out
