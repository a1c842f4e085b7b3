"""Where a command cannot write is said before its work is done, not after."""

from __future__ import annotations

from pathlib import Path

import pytest

from twodof.cli.app import run

# Command with its option for a file, the suffix of that file, and the function that does its work and must not begin.
COMMANDS = (
    ("calibrate --out", ".mat", "twodof.cli.log.calibrate_rig"),
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
    return {**found, "mkdir -p": folder / "nowhere" / f"a{suffix}", **wrong}


@pytest.mark.parametrize(("command", "suffix", "work"), COMMANDS)
def test_a_place_is_checked_before_the_work(
    command: str,
    suffix: str,
    work: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(work, lambda *_, **__: pytest.fail("the work was begun"))
    for said, place in places(tmp_path, command, suffix).items():
        assert run([*command.split(), str(place)]) == 2
        assert said in capsys.readouterr().err
