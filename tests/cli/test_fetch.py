"""`twodof log fetch`: finds what is at hand, and says in one error what is not."""

import json
from pathlib import Path

import pytest

from twodof.cli.app import run


def test_an_unknown_log_is_refused_with_the_names_there_are(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["log", "fetch", "nothing"]) == 2
    error = capfd.readouterr().err
    assert "no such public log" in error
    assert "doublet-0.03" in error


def test_a_file_with_a_public_name_and_another_content_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "doublet-0.03.mat").write_bytes(b"something else")
    monkeypatch.setenv("TWODOF_FLIGHT_DATA", str(tmp_path))
    assert run(["log", "fetch", "doublet-0.03"]) == 2
    said = capfd.readouterr().err
    assert "sha256" in said or "checksum" in said


def test_what_is_at_hand_is_named(
    flight_data: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TWODOF_FLIGHT_DATA", str(flight_data))
    assert run(["log", "fetch", "doublet-0.03", "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == {"doublet-0.03": str(flight_data / "doublet-0.03.mat")}


def test_without_a_network_it_is_not_the_callers_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("https_proxy", "HTTPS_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    for name in ("TWODOF_FLIGHT_DATA", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    assert run(["log", "fetch", "doublet-0.03", "--json"]) == 1
    assert json.loads(capfd.readouterr().out)["error"]["kind"] == "DownloadError"
    assert list(tmp_path.iterdir()) == []
