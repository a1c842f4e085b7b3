"""`twodof log`: info, plot and fetch; `--plot` of the commands that fly."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.program import Shell
from twodof.cli.app import run
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import write_log
from twodof.flightlog.log import Channel, FlightLog

pytestmark = pytest.mark.slow

NOTED: list[tuple[dict[str, Any], list[str]]] = [
    ({"texts": "hello"}, []),
    ({"texts": [1, ["a", "b", "c"], [2.5, "info", "fine"]]}, ["     2.500 s  info: fine"]),
    ({"texts": {"a": 1}, "flown": [1], "drone": 3}, []),
    ({"flown": "yes", "drone": {"controller": "mine"}}, ["controller: mine"]),
    ({"texts": [[1, 4, "\x1b[31mred"]], "flown": {"reason": "a\nb"}}, ["broken off: a b", "     1.000 s  4:  [31mred"]),
]


@pytest.mark.parametrize(("noted", "shown"), NOTED)
def test_notes_of_other_programs_are_shown_safely(
    noted: dict[str, Any], shown: list[str], tmp_path: Path, shell: Shell
) -> None:
    """Nor does it command the terminal."""
    path = tmp_path / "theirs.mcap"
    gyr = Channel(0.004 * np.arange(10), np.zeros((10, 3)), "rad/s", ("x", "y", "z"), "gyr")
    write_log(FlightLog({"gyr": gyr}, noted), path)
    lines = shell(["log", "info", str(path)]).out.splitlines()
    assert [line for line in lines if line.startswith(("controller", "broken off", "     "))] == shown


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "steps.mat"
    write_log(Laboratory("lab").fly("attitude-steps").log, path)
    return path


def test_a_log_is_drawn_beside_itself(log: Path, shell: Shell) -> None:
    said = shell(["log", "plot", str(log), "--json"]).json
    steps = said.pop("steps")["steps"]
    assert [one["loop"] for one in steps] == ["attitude"] * 4
    assert all(0.05 < one["rise_time"] < 0.5 for one in steps)
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
    log: Path, options: list[str], said: str, tmp_path: Path, shell: Shell
) -> None:
    out = [] if "--out" in options else ["--out", str(tmp_path / "a.png")]
    assert said in shell(["log", "plot", str(log), *options, *out], 2).err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_simulated_flight_is_drawn_at_once(tmp_path: Path) -> None:
    out = tmp_path / "flight.html"
    assert run(["simulate", "attitude-steps", "--plot", str(out)]) == 0
    assert "<h1>attitude-steps on lab</h1>" in out.read_text()


def test_an_unknown_log_is_refused_with_names(shell: Shell) -> None:
    error = shell(["log", "fetch", "nothing"], 2).err
    assert "no such public log" in error
    assert "doublet-0.03" in error


def test_a_public_log_with_wrong_content_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    (tmp_path / "doublet-0.03.mat").write_bytes(b"something else")
    monkeypatch.setenv("TWODOF_FLIGHT_DATA", str(tmp_path))
    said = shell(["log", "fetch", "doublet-0.03"], 2).err
    assert "sha256" in said or "checksum" in said


def test_what_is_at_hand_is_named(flight_data: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    monkeypatch.setenv("TWODOF_FLIGHT_DATA", str(flight_data))
    assert shell(["log", "fetch", "doublet-0.03", "--json"]).json == {
        "doublet-0.03": str(flight_data / "doublet-0.03.mat")
    }


def test_a_failed_download_exits_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    for name in ("https_proxy", "HTTPS_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    for name in ("TWODOF_FLIGHT_DATA", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    assert shell(["log", "fetch", "doublet-0.03", "--json"], 1).json["error"]["kind"] == "DownloadError"
    assert list(tmp_path.iterdir()) == []
