"""Texts from files and the wire on a terminal: no escape sequence, no markup, no line reversed."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.table import Table

import twodof
from tests.cli.program import Shell
from tests.flightlog.synthetic import attitude_steps
from tests.patience import PATIENCE_S
from twodof.cli import output
from twodof.cli.app import run, show_warning
from twodof.cli.output import IN_SHELL, print_error, progress, say_line, table_console
from twodof.errors import LinkError, LogError, TwodofError
from twodof.flightlog.files import write_log
from twodof.flightlog.log import Channel, FlightLog

pytestmark = pytest.mark.slow

EVIL = "\x1b]0;title\x07\x1b[31m[red]q[/red][link=http://a.b]x[/link]\x9b2J\u202ebackwards\r\x08:smile:"


def clean(said: str) -> None:
    assert [c for c in said if not c.isprintable() and c != "\n"] == []


def evil_log() -> FlightLog:
    log = attitude_steps()
    time = log["q"].time
    channels = {**log.channels, EVIL: Channel(time, np.zeros((len(time), 2)), EVIL, (EVIL, EVIL + "2"))}
    texts = [[1.0, EVIL, EVIL]]
    return FlightLog(
        channels, {"controllers": {EVIL: 1}, "flown": {"controller": EVIL, "reason": EVIL}, "texts": texts}
    )


@pytest.mark.parametrize("suffix", [".mcap", ".parquet"])
def test_names_in_a_log(suffix: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], shell: Shell) -> None:
    path = tmp_path / f"a{suffix}"
    write_log(evil_log(), path)
    said = shell(["log", "info", str(path)])
    clean(said.out + said.err)
    # As it stands, not as rich would read it.
    assert said.out.count("[red]q[/red][link=http://a.b]x[/link]") >= 4
    assert ":smile:" in said.out
    for arguments in (
        ["log", "plot", str(path), "--topics", "none"],
        ["log", "convert", str(path), str(tmp_path / "b.mat")],
        ["log", "convert", str(path), str(tmp_path / f"b{EVIL.replace('/', '')}.mcap")],
        ["replay", str(path), "--gains", "none"],
        ["identify", str(path), "--experiment", "doublet"],
    ):
        run(arguments)
        said = capfd.readouterr()
        assert said.out + said.err
        clean(said.out + said.err)


@pytest.mark.parametrize("suffix", [".svg", ".html"])
def test_names_in_a_picture(suffix: str, tmp_path: Path, shell: Shell) -> None:
    name = f"<script>alert(1)</script>&$\\frac{{$ {EVIL}"
    log = attitude_steps()
    channels = {"q": log["q"], name: Channel(log["q"].time, log["q"].value, f"</svg>{name}")}
    write_log(FlightLog(channels, {"experiment": name, "rig": name}), tmp_path / "a.parquet")
    out = tmp_path / f"a{suffix}"
    clean(shell(["log", "plot", str(tmp_path / "a.parquet"), "--topics", name, "--out", str(out)]).out)
    text = out.read_text(encoding="utf-8")
    assert "<script" not in text
    assert re.search(r"&lt;script&gt;", text)
    if suffix == ".svg":
        ElementTree.fromstring(text)


def test_all_ways_to_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    console = table_console()
    table = Table("[b]head[/b]" + EVIL)
    table.add_row(EVIL)
    console.print(table)
    console.print(EVIL)
    console.print(EVIL, style="bold")
    print_error(LogError(EVIL, EVIL, EVIL))
    say_line(EVIL)
    with progress() as report:
        report(EVIL, 0.5)
    said = capsys.readouterr()
    clean(said.out + said.err)
    assert "[b]head[/b]" in said.out
    assert said.out.count("[red]") == 4
    assert said.err.count("[red]") == 4


def test_colour_is_still_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    """To a terminal our own colour goes through, and nobody else's."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    file = io.StringIO()
    monkeypatch.setattr("sys.stderr", file)
    print_error(LogError("what\x1b[32m"))
    said = file.getvalue()
    assert "\x1b[1;31m" in said
    clean(said.replace("\x1b[1;31m", "").replace("\x1b[0m", ""))


@pytest.mark.parametrize("more", [[], ["--json"]], ids=["people", "json"])
def test_a_closed_pipe_is_not_a_failure(more: list[str], tmp_path: Path) -> None:
    """As `twodof ... | head` does: nobody reads the pipe from the start."""
    ours, theirs = os.pipe()
    os.close(ours)
    command = [sys.executable, "-m", "twodof.cli", "key", str(tmp_path / "key"), *more]
    try:
        done = subprocess.run(command, stdout=theirs, stderr=subprocess.PIPE, timeout=PATIENCE_S, check=False)
    finally:
        os.close(theirs)
    assert (done.returncode, done.stderr) == (0, b"")


def test_an_error_of_ours_as_text() -> None:
    """Where no command prints it: in a traceback, in another program."""
    for kind in (TwodofError, LinkError):
        clean(str(kind(EVIL, EVIL, EVIL)))
    assert str(LinkError("one\ntwo")) == "one\ntwo"


def test_a_warning(capsys: pytest.CaptureFixture[str]) -> None:
    show_warning(EVIL)
    clean(capsys.readouterr().err)


def test_replaced_remedies_stand_in_the_package() -> None:
    """A remedy whose call of Python has been renamed would reach the shell as it is."""
    texts = [path.read_text(encoding="utf-8") for path in Path(twodof.__file__).parent.rglob("*.py")]
    own = Path(output.__file__).read_text(encoding="utf-8")
    assert [call for call in IN_SHELL if not any(call in text for text in texts if text != own)] == []


@pytest.mark.long
@pytest.mark.parametrize(
    "command",
    [
        ["--help"],
        ["--version"],
        ["drones", "--timeout", "0.1"],
        ["key", "FILE"],
        ["diagram", "check", "stock-attitude", "--json"],
    ],
)
def test_a_full_disk_behind_stdout_is_one_line(command: list[str], tmp_path: Path) -> None:
    arguments = [word.replace("FILE", str(tmp_path / "key")) for word in command]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "twodof.cli", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            timeout=PATIENCE_S,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr == b"error: standard output cannot be written: No space left on device\n"


def test_without_stdout_the_work_is_done(tmp_path: Path) -> None:
    """As a service is started, or by the shell's `>&-`."""
    command = 'exec "$0" -m twodof.cli key "$1" >&- 2>&-'
    done = subprocess.run(["sh", "-c", command, sys.executable, str(tmp_path / "key")], timeout=PATIENCE_S, check=False)
    assert done.returncode == 0
    assert (tmp_path / "key").is_file()
