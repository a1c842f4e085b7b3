"""`twodof diagram margins`: the table, its JSON, the picture, and the words for an unstable loop."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from twodof.cli.app import run
from twodof.sim.linear import cascade_loop

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_the_table_has_a_row_for_each_loop(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["diagram", "margins", "--rig", "paper"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert lines[0] == "the stock cascade (default) on paper"
    rows = {line.split()[0]: line.split() for line in lines[3:]}
    assert rows["rate"][1:4] == ["33.5", "6.1", "53.1"]
    assert list(rows) == ["motors", "rate", "attitude", "velocity", "position"]


@pytest.mark.long
def test_json_and_picture_of_one_loop(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "loop.png"
    asked = ["diagram", "margins", "lqr-attitude", "--rig", "paper", "--loop", "attitude", "--plot", str(file)]
    assert run([*asked, "--json"]) == 0
    found = json.loads(capfd.readouterr().out)["loops"]
    assert list(found) == ["attitude"]
    crossing = found["attitude"]["phase_crossings"][0]
    assert file.read_bytes().startswith(b"\x89PNG")
    assert found["attitude"]["crossover"] == crossing["omega"]
    assert abs(cascade_loop("attitude", rig="paper").response(crossing["omega"])[0]) != pytest.approx(1.0, abs=1e-3)
    assert run(asked) == 2  # the picture is there already
    assert "--force" in capfd.readouterr().err


@pytest.mark.long
def test_an_unstable_loop_exits_1(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "model.json"
    model.write_text('{"mu": 900.0}')
    assert run(["diagram", "margins", "--rig", str(model), "--loop", "rate"]) == 1
    out = capfd.readouterr().out
    assert "rate: unstable: swings at" in out
    assert "growing (with 0." in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--rig", "nowhere.json"], "nowhere.json"),
        (["--loop", "yaw"], "there are: motors, rate"),
        (["--plot", "loop.bmp"], "use .png, .svg, .pdf"),
        (["nothing"], "no such file or starter"),
    ],
)
def test_bad_arguments_are_named(arguments: list[str], says: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["diagram", "margins", *arguments]) == 2
    assert says in capfd.readouterr().err
