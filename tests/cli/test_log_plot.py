"""`twodof log plot`, and `--plot` of the commands that fly."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from twodof.cli.app import run
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import write_log

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "steps.mat"
    write_log(Laboratory("lab").fly("attitude-steps").log, path)
    return path


def test_a_log_is_drawn_beside_itself_and_what_is_left_out_is_said(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["log", "plot", str(log), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {
        "file": str(log.with_suffix(".png")),
        "notes": ["the cart stands still: position and velocity are left out"],
    }
    assert log.with_suffix(".png").stat().st_size > 10_000


def test_topics_come_between_commas_or_repeated(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "some.svg"
    options = ["--topics", "q,x", "--topics", "battery.voltage", "--window", "18", "20"]
    assert run(["log", "plot", str(log), "--out", str(out), *options]) == 0
    text = out.read_text()
    assert all(f">{label}<" in text for label in ("pitch rate q [deg/s]", "position x [m]", "battery.voltage [V]"))
    assert "pitch θ" not in text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--out", "picture.jpg"], "no picture has the suffix '.jpg'"),
        (["--out", "/nowhere/a.png"], "its folder is not there"),
        (["--topics", "gyro"], "the log does not have this signal"),
        (["--window", "90", "99"], "nothing was logged from 90 to 99 s"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    log: Path, options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = [] if "--out" in options else ["--out", str(tmp_path / "a.png")]
    assert run(["log", "plot", str(log), *options, *out]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_simulated_flight_is_drawn_at_once(tmp_path: Path) -> None:
    out = tmp_path / "flight.html"
    assert run(["simulate", "attitude-steps", "--plot", str(out)]) == 0
    assert "<h1>attitude-steps on lab</h1>" in out.read_text()
