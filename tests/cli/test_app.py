"""The command line: exit statuses, errors, JSON and Ctrl-C."""

import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from tests.cli.program import Shell
from tests.patience import PATIENCE_S
from tests.processes import started
from twodof.cli.app import COMMANDS, app
from twodof.flightlog.files import write_log
from twodof.flightlog.log import Channel, FlightLog

pytestmark = pytest.mark.slow


@pytest.fixture
def log_file(tmp_path: Path) -> Path:
    """Two seconds of a made-up flight with thrust from 0.5 to 1.5 s."""
    time_s = np.arange(500) * 0.004
    thrust = np.where((time_s >= 0.5) & (time_s <= 1.5), 0.4, 0.0)
    channels = {"T": Channel(time_s, thrust, "-"), "theta": Channel(time_s, 0.1 * np.sin(time_s), "rad")}
    path = tmp_path / "flight.csv"
    write_log(FlightLog(channels), path)
    return path


def test_help_names_commands_and_imports_none() -> None:
    code = (
        "import sys; sys.argv[1:] = ['--help']\nfrom twodof.cli import main\ntry: main()\nfinally: print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    help_text, _, modules = (
        done.stdout.rpartition("\n__main__") if "\n__main__" in done.stdout else done.stdout.rpartition("\nsys ")
    )
    for name, (_, text) in COMMANDS.items():
        assert name in help_text
        assert text in help_text
    assert not {"numpy", "scipy", "matplotlib", "pyarrow"} & set(modules.split())


@pytest.mark.parametrize("arguments", [["nonsense"], ["log", "info"], ["log", "info", "x", "--nonsense"]])
def test_a_wrong_call_is_the_callers_mistake(arguments: list[str], shell: Shell) -> None:
    out, err = shell(arguments, 2)
    assert out == ""
    assert "Usage" in err


def test_an_error_says_what_where_and_remedy(shell: Shell) -> None:
    out, err = shell(["log", "info", "nowhere.mat"], 2)
    assert out == ""
    assert "nowhere.mat" in err
    assert "remedy:" in err
    assert "Traceback" not in err
    error = shell(["log", "info", "nowhere.mat", "--json"], 2).json["error"]
    assert error["kind"] == "LogError"
    assert error["where"] == "nowhere.mat"


def test_log_info_lists_channels_and_thrust(log_file: Path, shell: Shell) -> None:
    found = shell(["log", "info", str(log_file), "--json"]).json
    assert {row["name"] for row in found["channels"]} == {"T", "theta"}
    (armed,) = found["armed_s"]
    assert armed == pytest.approx([0.5, 1.5], abs=0.0041)
    assert "thrust on: 0.500 to 1.500 s" in shell(["log", "info", str(log_file)]).out


def test_ctrl_c_leaves_files_whole_and_exits_130(tmp_path: Path) -> None:
    """A real SIGINT while a file is being written: what stood there before stands there after."""
    target = tmp_path / "report.html"
    target.write_text("before")
    code = f"""
        import sys, time, types
        import typer
        from twodof.cli import app, main
        from twodof.flightlog.atomic import atomic_write
        slow = types.ModuleType("twodof.cli.log")
        def log() -> None:
            with atomic_write({str(target)!r}, "w") as file:
                file.write("half")
                file.flush()
                print("writing", flush=True)
                while True:  # a signal that comes just before a sleep does not end it
                    time.sleep(0.01)
        slow.log = log
        sys.modules["twodof.cli.log"] = slow
        sys.argv[1:] = ["log"]
        main()
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    with started(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert target.read_text() == "before"
    assert list(tmp_path.iterdir()) == [target]


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command below `group`, with what is typed for it."""
    for name in group.list_commands(None) if hasattr(group, "list_commands") else []:
        command = group.get_command(None, name)
        yield (*path, name), command
        yield from commands(command, (*path, name))


EVERY_COMMAND = list(commands(typer.main.get_command(app)))


@pytest.mark.parametrize(("typed", "command"), EVERY_COMMAND, ids=[" ".join(typed) for typed, _ in EVERY_COMMAND])
def test_help_says_every_option_to_the_letter(typed: tuple[str, ...], command: Any, shell: Shell) -> None:
    """Brackets above all, such as those around units, which a markup language takes for its own."""
    text = " ".join(shell([*typed, "--help"]).out.split())
    letters = text.replace(" ", "")  # lines are broken at hyphens too
    assert not re.search(r" [.,;:)](?!\w)", text.replace(" ...", ""))
    said = [command.help or "", *(getattr(parameter, "help", None) or "" for parameter in command.params)]
    for one in said:
        assert "".join(one.split()) in letters
