"""Input of commands: pipes and standard input are read like files, up to the same limit."""

import io
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.cli.program import Shell
from twodof.cli.app import run


@pytest.mark.parametrize(
    ("command", "remark"),
    [
        (["parameters", "--load", "PIPE"], "'nonsense' is not a parameter"),
        (["design", "controller", "PIPE", "--out", "made.json"], "it is not JSON"),
        (["diagram", "linearize", "pid-attitude", "--at", "PIPE"], "this is no JSON"),
    ],
)
def test_a_pipe_is_read_as_a_file(command: list[str], remark: str, capfd: pytest.CaptureFixture[str]) -> None:
    reading, writing = os.pipe()
    os.write(writing, b"nonsense")
    os.close(writing)
    assert run([f"/dev/fd/{reading}" if word == "PIPE" else word for word in command]) == 2
    os.close(reading)
    assert remark in capfd.readouterr().err


def test_long_standard_input_is_refused(tmp_path: Path, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(bytes(20 << 20))))
    assert (
        "more than 16777216 bytes" in shell(["design", "controller", "-", "--out", str(tmp_path / "made.json")], 2).err
    )
