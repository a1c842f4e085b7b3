"""`twodof log fetch`: finds what is at hand, and says in one error what is not."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from twodof.cli.app import run


def fetch(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("twodof")), "log", "fetch", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})


def test_an_unknown_log_is_refused_with_the_names_there_are(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["log", "fetch", "nothing"]) == 2
    error = capfd.readouterr().err
    assert "no such public log" in error
    assert "doublet-0.03" in error


def test_a_file_with_a_public_name_and_another_content_is_refused(tmp_path: Path) -> None:
    (tmp_path / "doublet-0.03.mat").write_bytes(b"something else")
    done = fetch("doublet-0.03", TWODOF_FLIGHT_DATA=str(tmp_path))
    assert done.returncode == 2
    assert "sha256" in done.stderr or "checksum" in done.stderr


def test_what_is_at_hand_is_named(flight_data: Path) -> None:
    done = fetch("doublet-0.03", "--json", TWODOF_FLIGHT_DATA=str(flight_data))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"doublet-0.03": str(flight_data / "doublet-0.03.mat")}


def test_without_a_network_it_is_not_the_callers_mistake(tmp_path: Path) -> None:
    nowhere = {"https_proxy": "http://127.0.0.1:9", "HTTPS_PROXY": "http://127.0.0.1:9"}
    done = fetch("doublet-0.03", "--json", TWODOF_FLIGHT_DATA=str(tmp_path), XDG_CACHE_HOME=str(tmp_path), **nowhere)
    assert done.returncode == 1
    assert json.loads(done.stdout)["error"]["kind"] == "DownloadError"
    assert list(tmp_path.iterdir()) == []
