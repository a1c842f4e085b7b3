"""Durability: a folder is synced after each change that is reported as done."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from twodof.errors import LogError
from twodof.fcu.mavlink.file_tree import FileTree
from twodof.fcu.onboard_log.log_writer import LogFolder
from twodof.flight.controller_store import ControllerStore
from twodof.flight.starters import starter
from twodof.flightlog.atomic import atomic_write
from twodof.link.signing import Key, write_key


def saved(folder: Path) -> None:
    with atomic_write(folder / "log.txt", "w") as file:
        file.write("all of it")


def erased(folder: Path) -> None:
    (folder / "log_00001.ulg").touch()
    assert LogFolder(folder).erase() == 1


def removed(folder: Path) -> None:
    (folder / "mine.json").touch()
    FileTree(dict, folder).remove("/controllers/mine.json")


def back_to_stock(folder: Path) -> None:
    ControllerStore(folder).file("attitude_control").touch()
    assert ControllerStore(folder).remove("attitude_control")


CHANGES: dict[str, Callable[[Path], object]] = {
    "atomic_write": saved,
    "upload by FTP": lambda folder: FileTree(dict, folder).upload("/controllers/mine.json", b"{}"),
    "removal by FTP": removed,
    "flashing": lambda folder: ControllerStore(folder).flash(starter("lqr-attitude")),
    "back to stock": back_to_stock,
    "erasing of logs": erased,
    "a key": lambda folder: write_key(folder / "key", Key.fresh()),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("made", [False, True])
def test_the_folder_is_synced_behind_the_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str, made: bool
) -> None:
    synced: list[tuple[Path, set[str]]] = []
    folder = tmp_path / "new" if made else tmp_path
    makes = change in ("upload by FTP", "flashing")
    if made and not makes:
        folder.mkdir()

    def fsync(descriptor: int) -> None:
        place = Path(f"/proc/self/fd/{descriptor}").resolve()
        synced.append((place, {one.name for one in place.iterdir()} if place.is_dir() else set()))

    monkeypatch.setattr(os, "fsync", fsync)
    CHANGES[change](folder)
    assert (folder, {one.name for one in folder.iterdir()}) == synced[-1]
    assert not (made and makes) or (tmp_path, {"new"}) in synced, "the folder itself may be gone after a power cut"


def test_a_folder_that_cannot_be_synced_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if Path(f"/proc/self/fd/{descriptor}").resolve().is_dir():
            raise OSError(5, "Input/output error")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(LogError, match="may not outlast a power cut: Input/output error"):
        saved(tmp_path)
