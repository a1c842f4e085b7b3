"""Folders of the user's data: files that the user names, and logs with their notes and the deleted ones."""

import re
import secrets
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from stat import S_ISREG
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from pydantic import Field

from twodof.errors import LogError, ParameterError, Rejected, shown
from twodof.flightlog.atomic import make_folder, numbered, write_text
from twodof.flightlog.provenance import read_bytes
from twodof.lab.answers import NotThere

LONGEST_NAME = 80
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9 ._+-]{{0,{LONGEST_NAME - 1}}}")
FileName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
"""Name in a request of a file among NamedFiles."""


class NamedFiles:
    """Files with one suffix in `folder`, each under a name chosen by the user.

    `kind` is the noun for such a file in errors, "model". At most `most` are kept, each of at most `most_bytes`.
    """

    def __init__(self, folder: Path, suffix: str, kind: str, most: int, most_bytes: int = 1 << 20) -> None:
        self.folder, self._suffix, self._kind, self._most, self._most_bytes = folder, suffix, kind, most, most_bytes

    def listed(self) -> list[dict[str, Any]]:
        """List name, size [byte] and time of the last change [s, unix] of each file, the latest first."""
        rows: list[dict[str, Any]] = []
        for path in self.folder.glob(f"*{self._suffix}"):
            with suppress(OSError):  # it was deleted meanwhile
                stat = path.stat()
                if _NAME.fullmatch(path.stem) and S_ISREG(stat.st_mode):
                    rows.append({"name": path.stem, "bytes": stat.st_size, "changed": stat.st_mtime})
        return sorted(rows, key=lambda row: -row["changed"])[: self._most]

    def place(self, name: str) -> Path:
        """Return the place of a file, which may be missing. Raises ParameterError for a wrong name."""
        path = self.folder / f"{name}{self._suffix}"
        if not _NAME.fullmatch(name) or (name.endswith(self._suffix) and not path.is_file()):
            letters = f"at most {LONGEST_NAME} letters, digits, space, . _ + -"
            remedy = f"use {letters}, begin with a letter or digit, and leave {self._suffix} out"
            raise ParameterError(f"{shown(name)} cannot be a {self._kind}'s name", f"{self._kind}s", remedy)
        return path

    def there(self, name: str) -> Path:
        """Return the place of an existing file. Raises ParameterError for a wrong name, NotThere."""
        path = self.place(name)
        if not path.is_file():
            raise NotThere(f"there is no such {self._kind}", f"{self._kind} {name}", "choose one of the list")
        return path

    def content(self, name: str) -> bytes:
        """Return the bytes of a file. Raises NotThere, LogError for a file that is too large."""
        return read_bytes(self.there(name), self._most_bytes)

    def save(self, name: str, text: str, overwrite: bool = False) -> None:
        """Write a file, whole or not at all.

        Raises ParameterError for a wrong name and a text that is too long, Rejected for an existing file.
        """
        path = self.place(name)
        if len(text.encode()) > self._most_bytes:
            raise ParameterError(f"has more than {self._most_bytes} bytes", f"{self._kind} {name}", "keep less in it")
        make_folder(self.folder)
        if not path.exists() and len(self.listed()) >= self._most:
            raise Rejected(f"there are {self._most} {self._kind}s already", f"{self._kind}s", "delete one of them")
        if path.exists() and not overwrite:
            raise Rejected(f"there is a {self._kind} '{name}'", f"{self._kind}s", "choose another name")
        write_text(path, text)

    def delete(self, name: str) -> None:
        """Delete a file. Raises NotThere."""
        self.there(name).unlink()


SUFFIXES = (".mcap", ".mat", ".parquet", ".csv", ".ulg")
"""Suffixes of logs."""
LONGEST = 120
LogName = Annotated[str, Field(min_length=1, max_length=2 * LONGEST + 20)]
"""Name in a request of a log that may be there, as "12:NAME"."""
_NEW = re.compile(r"[A-Za-z0-9][A-Za-z0-9_. +-]*")


def is_log(name: str) -> bool:
    """Return True for the name of a log: printable, not hidden, with a log's suffix."""
    return (
        len(name.encode("utf-8", "replace")) <= 2 * LONGEST  # file systems count bytes; notes have longer names
        and not name.startswith(".")
        and name.isprintable()
        and not set(name) & {"/", "\\"}
        and Path(name).suffix.lower() in SUFFIXES
    )


def new_name(name: str) -> str:
    """Return `name` if it can be that of a new log. Raises LogError with the mistake."""
    if Path(name).suffix.lower() not in SUFFIXES:
        what = f"no log format has the suffix {Path(name).suffix[:20]!r}"
        raise LogError(what, name[:80], f"use {', '.join(SUFFIXES)}")
    if len(name) > LONGEST or not _NEW.fullmatch(name) or ".." in name:
        remedy = f"use letters, digits, spaces, _ . + and -, at most {LONGEST} of them"
        raise LogError("is not a name for a log", name[:80], remedy)
    return name


KEPT_DAYS = 7
"""Days in which a deleted log can be restored."""
_DAY_S = 86_400.0
_ENTRY = re.compile(r"(\d{1,12})-([0-9a-f]{8})-(.+)")
NOTES = ".notes.txt"


class LogTrash:
    """Folder ".trash" beside the logs; an entry's name has the time of deletion and the log's name."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._logs = folder / ".trash", folder

    def put(self, path: Path) -> dict[str, Any]:
        """Move a log and its notes here; return its entry. Raises LogError."""
        make_folder(self.folder)
        now, name = int(time.time()), path.name
        entry = self.folder / f"{now}-{secrets.token_hex(4)}-{name}"
        _move(path, entry)
        return {"entry": entry.name, "name": name, "until": now + KEPT_DAYS * _DAY_S}

    def restore(self, entry: str) -> str:
        """Restore a log and its notes; return its name, numbered if that is taken. Raises NotThere, LogError."""
        found = next((row for row in self.listed() if row["entry"] == entry), None)
        if found is None:
            raise NotThere("there is no such deleted log", entry[:40], "choose one of the list; old ones are removed")
        path = numbered(self._logs / found["name"])
        _move(self.folder / entry, path)
        return path.name

    def listed(self) -> list[dict[str, Any]]:
        """Remove expired entries; list entry, name and end [s, unix] of the others, the latest first."""
        rows: list[dict[str, Any]] = []
        for path in [*self.folder.iterdir()] if self.folder.is_dir() else ():
            match = _ENTRY.fullmatch(path.name)
            if match is None or not is_log(match[3]):
                continue
            until = int(match[1]) + KEPT_DAYS * _DAY_S
            if until >= time.time():
                rows.append({"entry": path.name, "name": match[3], "until": until})
            else:
                path.unlink(missing_ok=True)
                path.with_name(path.name + NOTES).unlink(missing_ok=True)
        return sorted(rows, key=lambda row: -float(row["until"]))


def _move(path: Path, target: Path) -> None:
    """Move a log with its notes. Raises LogError."""
    notes = path.with_name(path.name + NOTES)
    try:
        path.rename(target)
    except OSError as refusal:
        remedy = "check that it is there, that its name is short, and that the disk has room"
        raise LogError(f"cannot be moved: {refusal.strerror}", path.name, remedy) from refusal
    if notes.is_file():
        notes.rename(target.with_name(target.name + NOTES))


MOST = 2000
"""Most logs listed of each folder, the latest first."""
_LEFT_S = 3600.0
MOST_NOTES = 20_000
"""Most letters of a log's notes."""


class LogShelf:
    """Logs in the folder "flights" of the user's data, and in the folders `others`, which are only read.

    The name of a log is that of its file; a log in the k-th other folder is called "k:NAME".
    """

    def __init__(self, data: Path, others: Sequence[Path] = ()) -> None:
        self.folder = data / "flights"
        self.trash = LogTrash(self.folder)
        self._others = tuple(others)

    def listed(self) -> list[dict[str, Any]]:
        """List the logs, the latest first; `folder` is "" for the own one, `changed` in seconds of Unix time."""
        rows = [row for number, folder in enumerate(self._folders()) for row in self._rows(number, folder)]
        return sorted(rows, key=lambda row: -float(row["changed"]))

    def place(self, name: str) -> Path:
        """Return the place of a log. Raises NotThere for an unknown name."""
        head, colon, rest = name.partition(":")
        number = int(head) if colon and head.isascii() and head.isdigit() and len(head) <= 4 else 0
        file = rest if number else name
        folders = self._folders()
        if number < len(folders) and is_log(file):
            path = folders[number] / file
            if path.is_file():
                return path
        raise NotThere("there is no such log", name[:80], "choose one of the list")

    def ours(self, name: str) -> Path:
        """Return the path of a log that may be changed. Raises NotThere, Rejected."""
        path = self.place(name)
        if path.parent != self.folder:
            raise Rejected("logs of that folder cannot be changed here", name[:80], "change it in its folder")
        return path

    def notes(self, name: str) -> str:
        """Return a log's notes."""
        file = self._notes(self.place(name))
        if not file.is_file():
            return ""
        with file.open("rb") as stream:
            return stream.read(4 * MOST_NOTES).decode("utf-8", "replace")[:MOST_NOTES]

    def write_notes(self, name: str, text: str) -> None:
        """Keep notes beside the log; "" removes them. Raises NotThere, Rejected."""
        file = self._notes(self.ours(name))
        if text:
            write_text(file, text)
        else:
            file.unlink(missing_ok=True)

    def check_new(self, name: str) -> None:
        """Raise LogError if `name` cannot be that of a new log, Rejected if there are too many logs."""
        new_name(name)
        if len(self._rows(0, self.folder)) >= MOST:
            raise Rejected(f"there are {MOST} logs already", "logs", "delete some")

    def scratch(self) -> TemporaryDirectory[str]:
        """Return a new folder for a file in transfer, and remove the old ones of a killed server."""
        folder = self.folder / ".scratch"
        make_folder(folder)
        for left in folder.iterdir():
            with suppress(OSError):  # the end of another transfer has removed it
                if time.time() - left.stat().st_mtime > _LEFT_S:
                    rmtree(left)
        return TemporaryDirectory(dir=folder, ignore_cleanup_errors=True)

    def take_in(self, path: Path, name: str) -> str:
        """Move an uploaded log to its place; return its name, numbered if that is taken."""
        target = numbered(self.folder / new_name(name))
        _move(path, target)
        return target.name

    def _folders(self) -> list[Path]:
        return [self.folder, *self._others]

    def _rows(self, number: int, folder: Path) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        for path in folder.iterdir() if folder.is_dir() else ():
            with suppress(OSError):  # it was deleted meanwhile
                found = path.stat()
                if not is_log(path.name) or not S_ISREG(found.st_mode):
                    continue
                name = f"{number}:{path.name}" if number else path.name
                row = {"name": name, "file": path.name, "folder": folder.name if number else "", "bytes": found.st_size}
                rows.append(row | {"changed": found.st_mtime, "notes": self._notes(path).is_file()})
        return sorted(rows, key=lambda row: -float(row["changed"]))[:MOST]

    @staticmethod
    def _notes(path: Path) -> Path:
        return path.with_name(path.name + NOTES)
