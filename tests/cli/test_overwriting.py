"""One rule for what is there already: it is kept unless --force, or overwrite=True in Python, says otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gcs.virtual import on_board
from twodof.cli.app import run
from twodof.errors import LogError
from twodof.experiment import Laboratory
from twodof.flight.starters import save_diagram, starter
from twodof.flightlog import numbered, write_log
from twodof.gcs.drone import Drone
from twodof.rig.parameters import lab, save_rig

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("log") / "flown.csv"
    write_log(Laboratory("lab").fly("doublet").log, path)
    return str(path)


COMMANDS = [
    ("simulate doublet --out", "f.csv"),
    ("log convert LOG", "f.mat"),
    ("log plot LOG --out", "f.svg"),
    ("diagram new stock-attitude", "f.json"),
    ("diagram code stock-attitude --out", "f.c"),
    ("diagram code stock-attitude --html", "f.html"),
    ("diagram render stock-attitude --out", "f.svg"),
]


@pytest.mark.parametrize(("command", "name"), COMMANDS)
def test_a_file_that_is_there_is_kept_unless_it_is_said(
    command: str, name: str, log: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / name
    file.write_text("mine")
    arguments = [log if word == "LOG" else word for word in command.split()] + [str(file)]
    assert run(arguments) == 2
    said = capfd.readouterr().err
    assert "is there already" in said
    assert "--force" in said
    assert "overwrite" not in said
    assert file.read_text() == "mine"
    assert run([*arguments, "--force"]) in (0, 1)
    assert file.read_bytes() != b"mine"


def test_before_anything_moves_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there.mcap").write_text("mine")
    for command in (
        ["fly", "doublet", "--rig", "lab", "--out", "there.mcap"],
        ["demo", "--out", "there.mcap"],
        ["calibrate", "--out", "there.mcap"],
    ):
        monkeypatch.chdir(tmp_path)
        assert run(command) == 2


def test_the_functions_keep_to_it_too(tmp_path: Path) -> None:
    made, diagram = Laboratory("lab").fly("doublet").log, starter("stock-attitude")
    for name, write in (
        ("log.csv", lambda path, **how: write_log(made, path, **how)),
        ("diagram.json", lambda path, **how: save_diagram(diagram, path, **how)),
        ("rig.json", lambda path, **how: save_rig(lab(), path, **how)),
    ):
        write(tmp_path / name)
        with pytest.raises(LogError, match=r"is there already.*overwrite=True"):
            write(tmp_path / name)
        write(tmp_path / name, overwrite=True)


def test_a_session_that_repeats_has_numbered_recordings(tmp_path: Path) -> None:
    with on_board(lockstep=True) as there, Drone.connect(there.url) as drone:
        for _ in range(3):
            with drone.record(numbered(tmp_path / "session.mcap")):
                drone.run(0.02)
        with drone.record(tmp_path / "session.mcap", overwrite=True):
            drone.run(0.02)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["session-2.mcap", "session-3.mcap", "session.mcap"]


def test_an_export_into_a_folder_with_something_else_is_the_callers_mistake(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert run(["px4", "export", "stock-attitude", str(tmp_path)]) == 2
