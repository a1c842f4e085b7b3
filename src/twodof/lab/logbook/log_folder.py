"""LogShelf: the logs that the page shows: recorded flights, logs that were dropped on it, folders that were named."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.errors import LogError, Rejected
from twodof.flightlog.atomic import atomic_write, make_folder, numbered
from twodof.lab.logbook.log_trash import NOTES, LogTrash
from twodof.lab.logbook.names import is_log, new_name
from twodof.lab.refusals import NotThere

MOST = 2000
"""Logs that are listed, the latest of each folder."""
_LEFT_S = 3600.0
MOST_NOTES = 20_000
"""Letters of a log's notes."""


@dataclass(frozen=True)
class LogPlace:
    """Where a log is; `ours` is False in a folder that is only read."""

    path: Path
    ours: bool


class LogShelf:
    """The logs in the folder "flights" of the user's data, and those in `others`, which are only read.

    A log is named by its file there; one in the k-th other folder is called "k:NAME".
    """

    def __init__(self, data: Path, others: Sequence[Path] = ()) -> None:
        self.folder = data / "flights"
        self.trash = LogTrash(self.folder)
        self._others = tuple(others)

    def listed(self) -> list[dict[str, Any]]:
        """The logs, the latest first. `folder` is "" for ours, `changed` is in seconds of Unix time."""
        rows = [row for number, folder in enumerate(self._folders()) for row in self._rows(number, folder)]
        return sorted(rows, key=lambda row: -float(row["changed"]))

    def place(self, name: str) -> LogPlace:
        """Where a log is. Raises NotThere for what is not in the list."""
        head, colon, rest = name.partition(":")
        number = int(head) if colon and head.isascii() and head.isdigit() and len(head) <= 4 else 0
        file = rest if number else name
        folders = self._folders()
        if number < len(folders) and is_log(file):
            path = folders[number] / file
            if path.is_file():
                return LogPlace(path, number == 0)
        raise NotThere("there is no such log", name[:80], "choose one of the list")

    def ours(self, name: str) -> Path:
        """Where one is that may be changed. Raises NotThere, Rejected."""
        place = self.place(name)
        if not place.ours:
            raise Rejected("logs of that folder are only read here", name[:80], "change it there")
        return place.path

    def notes(self, name: str) -> str:
        """What was noted about it."""
        file = self._notes(self.place(name).path)
        if not file.is_file():
            return ""
        with file.open("rb") as stream:
            return stream.read(4 * MOST_NOTES).decode("utf-8", "replace")[:MOST_NOTES]

    def write_notes(self, name: str, text: str) -> None:
        """Keep notes beside the log; "" removes them. Raises NotThere, Rejected."""
        file = self._notes(self.ours(name))
        if text:
            with atomic_write(file, "w") as stream:
                stream.write(text)
        else:
            file.unlink(missing_ok=True)

    def check_new(self, name: str) -> None:
        """Whether a log of this name is taken in. Raises LogError, Rejected."""
        new_name(name)
        if len(self._rows(0, self.folder)) >= MOST:
            raise Rejected(f"there are {MOST} logs already", "logs", "delete some")

    def scratch(self) -> Path:
        """Where files are while they come in or go out; what a server that was killed has left there goes."""
        folder = self.folder / ".scratch"
        make_folder(folder)
        for path in folder.iterdir():
            if time.time() - path.stat().st_mtime > _LEFT_S:
                path.unlink(missing_ok=True)
        return folder

    def take_in(self, path: Path, name: str) -> str:
        """Put a log that was read into its place; returns its name, numbered where that is taken."""
        target = numbered(self.folder / new_name(name))
        try:
            path.rename(target)
        except OSError as refusal:
            raise LogError(f"cannot be kept: {refusal.strerror}", name, "see that the disk has room") from refusal
        return target.name

    def _folders(self) -> list[Path]:
        return [self.folder, *self._others]

    def _rows(self, number: int, folder: Path) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        for path in folder.iterdir() if folder.is_dir() else ():
            if not is_log(path.name) or not path.is_file():
                continue
            found = path.stat()
            name = f"{number}:{path.name}" if number else path.name
            row = {"name": name, "file": path.name, "folder": str(folder) if number else "", "bytes": found.st_size}
            rows.append(row | {"changed": found.st_mtime, "notes": self._notes(path).is_file()})
        return sorted(rows, key=lambda row: -float(row["changed"]))[:MOST]

    @staticmethod
    def _notes(path: Path) -> Path:
        return path.with_name(path.name + NOTES)
