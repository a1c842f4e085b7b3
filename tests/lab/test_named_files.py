"""Folder of files that a user names: kept whole, never replaced unasked, and never outside the folder."""

from pathlib import Path

import pytest

from twodof.errors import LogError, ParameterError, Rejected
from twodof.lab.answers import NotThere, without_folders
from twodof.lab.folders import NamedFiles


def test_files_are_kept_listed_and_deleted(tmp_path: Path) -> None:
    kept = NamedFiles(tmp_path / "snapshots", ".params", "snapshot", 2, 10)
    assert kept.listed() == []
    kept.save("before the flight", "text")
    assert [(row["name"], row["bytes"]) for row in kept.listed()] == [("before the flight", 4)]
    assert kept.content("before the flight") == b"text"
    with pytest.raises(Rejected, match="there is a snapshot"):
        kept.save("before the flight", "other")
    with pytest.raises(ParameterError, match="more than 10 bytes"):
        kept.save("before the flight", "a longer text", overwrite=True)
    (tmp_path / "snapshots" / "before the flight.params").write_text("a longer text")
    with pytest.raises(LogError):
        kept.content("before the flight")
    kept.save("second", "")
    with pytest.raises(Rejected, match="there are 2 snapshots"):
        kept.save("third", "")
    kept.delete("before the flight")
    with pytest.raises(NotThere):
        kept.delete("before the flight")


def test_a_name_with_the_suffix_is_found_not_made(tmp_path: Path) -> None:
    (tmp_path / "old.params.params").write_text("text")
    assert NamedFiles(tmp_path, ".params", "snapshot", 2).content("old.params") == b"text"


@pytest.mark.parametrize("name", ["", "../up", "a/b", ".hidden", "x" * 81, "a\0b", "n.params"])
def test_a_name_stays_in_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ParameterError, match="cannot be a snapshot's name"):
        NamedFiles(tmp_path, ".params", "snapshot", 2).save(name, "")


@pytest.mark.parametrize(
    ("told", "shown"),
    [
        ("/home/a b/flights/x.mat: cannot be read", "x.mat: cannot be read"),
        ("/srv/1:2/x.mat: twodof log recover /srv/1:2/x.mat", "x.mat: twodof log recover x.mat"),
        ("no room: /é/x.csv.", "no room: x.csv."),
        ("/a/x.mat and /b/c/y.mat", "x.mat and y.mat"),
        ("GET /api/logs/x, http://127.0.0.1:80/a/b, 3 m/s", "GET /api/logs/x, http://127.0.0.1:80/a/b, 3 m/s"),
    ],
)
def test_texts_name_files_without_folders(told: str, shown: str) -> None:
    assert without_folders(told) == shown
