"""Files that commands write: one that is there is kept without --force, and a wrong place is refused first."""

from pathlib import Path

import pytest

from tests.cli.program import Shell
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
def test_an_existing_file_is_kept_without_force(
    command: str, name: str, log: str, tmp_path: Path, shell: Shell
) -> None:
    file = tmp_path / name
    file.write_text("mine")
    arguments = [log if word == "LOG" else word for word in command.split()] + [str(file)]
    said = shell(arguments, 2).err
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


def test_an_export_into_a_foreign_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert run(["px4", "export", "stock-attitude", str(tmp_path)]) == 2


# Command with its option for a file, the suffix of that file, and the function that does its work and must not begin.
WORK = (
    ("calibrate --out", ".mat", "twodof.cli.simulate.calibrate_rig"),
    ("demo --out", ".html", "twodof.cli.demo.fly_series"),
    ("diagram render stock-attitude --out", ".svg", "twodof.cli.diagram.to_svg"),
    ("diagram code stock-attitude --out", ".mat", "twodof.cli.diagram.emit_program"),
    ("simulate doublet --out", ".mat", "twodof.cli.simulate.Laboratory"),
    ("simulate doublet --plot", ".png", "twodof.cli.simulate.Laboratory"),
    ("fly doublet --rig lab --out", ".mat", "twodof.cli.fly.virtual_drone"),
    ("fly doublet --rig lab --plot", ".png", "twodof.cli.fly.virtual_drone"),
)


def places(folder: Path, command: str, suffix: str) -> dict[str, Path]:
    """Return places where no file can be, also for root, by what the error says about them."""
    (folder / f"is a folder{suffix}").mkdir()
    (folder / "a file").touch()
    found = {"is a directory": folder / f"is a folder{suffix}", "folder": folder / "a file" / f"below{suffix}"}
    wrong = {"suffix '.h5'": folder / "flight.h5"} if command.startswith(("simulate", "fly")) else {}
    return {**found, "mkdir -p '": folder / "not there" / f"a{suffix}", **wrong}


@pytest.mark.parametrize(("command", "suffix", "work"), WORK)
def test_a_place_is_checked_before_the_work(
    command: str, suffix: str, work: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    monkeypatch.setattr(work, lambda *_, **__: pytest.fail("the work was begun"))
    for said, place in places(tmp_path, command, suffix).items():
        assert said in shell([*command.split(), str(place)], 2).err
