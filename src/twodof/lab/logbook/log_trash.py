"""LogTrash: deleted logs, kept for a while beside the others, so that deleting can be undone."""

from __future__ import annotations

import re
import secrets
import time
from pathlib import Path
from typing import Any

from twodof.errors import Rejected
from twodof.flightlog.atomic import make_folder, numbered
from twodof.lab.logbook.names import is_log
from twodof.lab.refusals import NotThere

KEPT_DAYS = 7
"""How long a deleted log can be brought back."""
_DAY_S = 86_400.0
_ENTRY = re.compile(r"(\d{1,12})-([0-9a-f]{8})-(.+)")
NOTES = ".notes.txt"


class LogTrash:
    """The folder ".trash" in that of the logs; an entry is named by the time of its deletion and the log's name."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._logs = folder / ".trash", folder

    def put(self, path: Path) -> dict[str, Any]:
        """Move a log here, its notes with it; returns its entry."""
        make_folder(self.folder)
        entry = f"{int(time.time())}-{secrets.token_hex(4)}-{path.name}"
        notes = path.with_name(path.name + NOTES)
        path.rename(self.folder / entry)
        if notes.is_file():
            notes.rename(self.folder / (entry + NOTES))
        return self._row(entry)

    def restore(self, entry: str) -> str:
        """Bring a log back, its notes with it; returns its name, another one where that is taken meanwhile.

        Raises NotThere.
        """
        match = _ENTRY.fullmatch(entry)
        if match is None or entry not in self._entries():
            raise NotThere("there is no such deleted log", entry[:40], "it may have been removed for good")
        path = numbered(self._logs / match[3])
        (self.folder / entry).rename(path)
        notes = self.folder / (entry + NOTES)
        if notes.is_file():
            notes.rename(path.with_name(path.name + NOTES))
        return path.name

    def listed(self) -> list[dict[str, Any]]:
        """Entry, name, and until when it is kept [s, unix], the latest first; what is older is removed for good."""
        now = time.time()
        rows = [self._row(entry) for entry in self._entries()]
        for row in rows:
            if row["until"] < now:
                for name in (row["entry"], row["entry"] + NOTES):
                    (self.folder / name).unlink(missing_ok=True)
        return sorted((row for row in rows if row["until"] >= now), key=lambda row: -float(row["until"]))

    def _entries(self) -> list[str]:
        if not self.folder.is_dir():
            return []
        names = [path.name for path in self.folder.iterdir()]
        return [name for name in names if (match := _ENTRY.fullmatch(name)) and is_log(match[3])]

    def _row(self, entry: str) -> dict[str, Any]:
        match = _ENTRY.fullmatch(entry)
        if match is None:
            raise Rejected("is not the name of a deleted log", entry[:40])
        return {"entry": entry, "name": match[3], "until": int(match[1]) + KEPT_DAYS * _DAY_S}
