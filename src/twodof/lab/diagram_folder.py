"""DiagramFolder: the diagrams that a user keeps on the server, a file each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from twodof.blocks.schema.json_form import MAX_BYTES
from twodof.errors import DiagramError, Rejected
from twodof.flightlog.atomic import atomic_write, make_folder
from twodof.lab.answers import NotThere

MOST = 1000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_. -]{0,79}")


class DiagramFolder:
    """The folder "diagrams" in the user's data folder. A name is that of a file in it, without .json."""

    def __init__(self, data: Path) -> None:
        self.folder = data / "diagrams"

    def listed(self) -> list[dict[str, Any]]:
        """Name, bytes and time of the last change [s, unix] of each, the latest first."""
        rows: list[dict[str, Any]] = []
        for path in self.folder.glob("*.json") if self.folder.is_dir() else ():
            if path.is_file() and _NAME.fullmatch(path.stem):
                found = path.stat()
                rows.append({"name": path.stem, "bytes": found.st_size, "changed": found.st_mtime})
        return sorted(rows, key=lambda row: -float(row["changed"]))[:MOST]

    def read(self, name: str) -> str:
        """The text of a file. Raises NotThere."""
        path = self._path(name)
        if not path.is_file():
            raise NotThere("there is no such diagram", name, "open one of the list")
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise DiagramError("it is larger than a diagram may be", name, f"at most {MAX_BYTES} bytes are read")
        return data.decode("utf-8", "replace")

    def write(self, name: str, text: str) -> None:
        """Keep `text`, whole or not at all. Raises Rejected where there are too many."""
        path = self._path(name)
        make_folder(self.folder)
        if not path.exists() and len(self.listed()) >= MOST:
            raise Rejected(f"there are {MOST} diagrams already", "diagrams", "delete one")
        with atomic_write(path, "w") as file:
            file.write(text)

    def remove(self, name: str) -> str:
        """Take a file away; returns what was in it. Raises NotThere."""
        text = self.read(name)
        self._path(name).unlink(missing_ok=True)
        return text

    def _path(self, name: str) -> Path:
        if not _NAME.fullmatch(name) or ".." in name:
            raise DiagramError(
                f"{name[:40]!r} is not a name for a file", "diagrams", "use letters, digits, spaces, _ . and -"
            )
        return self.folder / f"{name}.json"
