"""Where a command cannot write is said before its work is done, not after."""

from __future__ import annotations

from pathlib import Path

import pytest

from twodof.cli.app import run

# Command, and what does its work: which must not begin.
COMMANDS = (
    (["calibrate"], "twodof.cli.log.calibrate_rig"),
    (["demo"], "twodof.cli.demo.fly_series"),
    (["diagram", "render", "stock-attitude"], "twodof.cli.diagram.to_svg"),
    (["diagram", "code", "stock-attitude"], "twodof.cli.diagram.emit_program"),
    (["simulate", "doublet"], "twodof.cli.simulate.Laboratory"),
    (["fly", "doublet", "--rig", "lab"], "twodof.cli.fly.virtual_drone"),
)


def places(folder: Path, suffix: str) -> dict[str, Path]:
    """Places that no file can have, as root too, by what is said of them."""
    (folder / f"is a folder{suffix}").mkdir()
    (folder / "a file").touch()
    return {"is a directory": folder / f"is a folder{suffix}", "folder": folder / "a file" / f"below{suffix}"}


@pytest.mark.parametrize(("command", "work"), COMMANDS, ids=[" ".join(command[:2]) for command, _ in COMMANDS])
def test_a_place_that_cannot_be_is_refused_before_the_work(
    command: list[str],
    work: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(work, lambda *_, **__: pytest.fail("the work was begun"))
    for said, place in places(tmp_path, ".svg" if "render" in command else ".mat").items():
        assert run([*command, "--out", str(place)]) == 2
        assert said in capsys.readouterr().err
