"""`twodof diagram margins`: the table, its JSON, the picture, and the words for an unstable loop."""

from pathlib import Path

import pytest

from tests.cli.program import Shell
from twodof.sim.linear import cascade_loop

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_the_table_has_a_row_for_each_loop(shell: Shell) -> None:
    lines = shell(["diagram", "margins", "--rig", "paper"]).out.splitlines()
    assert lines[0] == "the stock cascade (default) on paper"
    rows = {line.split()[0]: line.split() for line in lines[3:]}
    assert rows["rate"][1:4] == ["33.5", "6.1", "53.1"]
    assert list(rows) == ["motors", "rate", "attitude", "velocity", "position"]


@pytest.mark.long
def test_json_and_picture_of_one_loop(tmp_path: Path, shell: Shell) -> None:
    file = tmp_path / "loop.png"
    asked = ["diagram", "margins", "lqr-attitude", "--rig", "paper", "--loop", "attitude", "--plot", str(file)]
    found = shell([*asked, "--json"]).json["loops"]
    assert list(found) == ["attitude"]
    crossing = found["attitude"]["phase_crossings"][0]
    assert file.read_bytes().startswith(b"\x89PNG")
    assert found["attitude"]["crossover"] == crossing["omega"]
    assert abs(cascade_loop("attitude", rig="paper").response(crossing["omega"])[0]) != pytest.approx(1.0, abs=1e-3)
    assert "--force" in shell(asked, 2).err


@pytest.mark.long
def test_an_unstable_loop_exits_1(tmp_path: Path, shell: Shell) -> None:
    model = tmp_path / "model.json"
    model.write_text('{"mu": 900.0}')
    out = shell(["diagram", "margins", "--rig", str(model), "--loop", "rate"], 1).out
    assert "rate: unstable: swings at" in out
    assert "growing (with 0." in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--rig", "nowhere.json"], "nowhere.json"),
        (["--loop", "yaw"], "there are: motors, rate"),
        (["--plot", "loop.bmp"], "use .png, .svg, .pdf"),
        (["nothing"], "neither a file nor a starter"),
    ],
)
def test_bad_arguments_are_named(arguments: list[str], says: str, shell: Shell) -> None:
    assert says in shell(["diagram", "margins", *arguments], 2).err
