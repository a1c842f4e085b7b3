"""`twodof px4 export` and `twodof px4 check`: what they print, write and return."""

import json
from pathlib import Path

import pytest

from tests.cli.program import Shell
from tests.compile.px4.golden import GOLDEN
from tests.compile.px4.modules import PITCH_LOG
from twodof.cli.app import run


def test_a_starter_is_exported_with_parameter_names(tmp_path: Path, shell: Shell) -> None:
    printed = shell(["px4", "export", "pid-attitude", str(tmp_path / "out")]).out
    assert "module twodof_pid_attitude" in printed
    assert "TPA_Q_KP          q_kp" in printed
    assert "stops mc_rate_control" in printed
    assert (tmp_path / "out" / "README.md").is_file()


def test_logged_signals_give_the_golden_tree(tmp_path: Path, shell: Shell) -> None:
    diagram = GOLDEN / "pitch" / "diagram.json"
    log = [word for path in PITCH_LOG for word in ("--log", path)]
    told = shell(["px4", "export", str(diagram), str(tmp_path / "out"), *log, "--json"]).json
    assert told["module"] == "twodof_pitch"
    assert told["parameters"]["TPI_DAMPER_KI"] == "damper.ki"
    assert told["parameters"]["TPI_LIVE"] is None
    for path in told["files"]:
        if path.endswith((".cpp", ".hpp", ".msg", "module.yaml", "CMakeLists.txt")):
            assert (tmp_path / "out" / path).read_bytes() == (GOLDEN / "pitch" / path).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["pid-attitude", "--log", "nothing.there"], "nothing"),
        (["pid-attitude", "--prefix", "lower"], "not a prefix"),
        (["no-such-diagram"], "no-such-diagram"),
    ],
)
def test_a_mistake_is_told_and_nothing_is_written(
    tmp_path: Path, shell: Shell, arguments: list[str], what: str
) -> None:
    out = tmp_path / "out"
    assert what in shell(["px4", "export", arguments[0], str(out), *arguments[1:]], 2).err
    assert not out.exists()


@pytest.mark.long
@pytest.mark.parametrize("command", [["px4", "export"], ["flash", "--to", "px4-dir", "--out"]])
def test_a_name_too_long_is_one_error(command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / ("a" * 300))
    arguments = [*command, "pid-attitude", folder] if command[0] == "px4" else [*command, folder, "pid-attitude"]
    assert run(arguments) != 0
    said = capsys.readouterr().err
    assert said.startswith("error: the file system refuses: File name too long")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_something_else_is_not_replaced(tmp_path: Path, shell: Shell) -> None:
    (tmp_path / "mine").write_text("mine")
    told = shell(["px4", "export", "pid-attitude", str(tmp_path), "--force", "--json"], 2)
    assert json.loads(told.out)["error"]["kind"] == "LogError"
    assert "something else in it" in told.err
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]


def test_check_of_an_unfit_tree_exits_1(tmp_path: Path, shell: Shell) -> None:
    arguments = ["px4", "check", str(tmp_path), str(GOLDEN / "rail")]
    assert "is not a source tree of PX4" in shell(arguments, 1).out
    told = shell([*arguments, "--json"], 1).json
    assert told["fits"] is False
    assert told["findings"][0]["level"] == "error"
    assert "holds no exported module" in shell(["px4", "check", str(tmp_path), str(tmp_path)], 1).err
