"""Folder of files that a user names: diagrams, models, snapshots of parameters."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from twodof.errors import LogError, ParameterError, Rejected, shown
from twodof.flightlog.atomic import atomic_write, check_free, make_folder
from twodof.flightlog.provenance import read_bytes
from twodof.lab.answers import NotThere

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,79}")


class NamedFiles:
    """Files with one suffix in `folder`, each under a name that its user chose.

    `kind` is their noun for errors, such as "model". At most `most` are kept, each of at most `most_bytes`.
    """

    def __init__(self, folder: Path, suffix: str, kind: str, most: int, most_bytes: int = 1 << 20) -> None:
        self.folder, self._suffix, self._kind, self._most, self._most_bytes = folder, suffix, kind, most, most_bytes

    def listed(self) -> list[dict[str, Any]]:
        """List name, bytes and time of the last change [s, unix] of each, the latest first."""
        found = [(path.stem, path.stat()) for path in self.folder.glob(f"*{self._suffix}") if path.is_file()]
        rows = [{"name": name, "bytes": stat.st_size, "changed": stat.st_mtime} for name, stat in found]
        return sorted(
            (row for row in rows if _NAME.fullmatch(str(row["name"]))), key=lambda row: -float(row["changed"])
        )

    def place(self, name: str) -> Path:
        """Return the place of a file, which may be missing. Raises ParameterError for a wrong name."""
        if not _NAME.fullmatch(name) or name.endswith(self._suffix):
            remedy = "take letters, digits, space, . _ + -, at most 80, and begin with a letter or digit"
            raise ParameterError(f"{shown(name)} cannot be a {self._kind}'s name", f"{self._kind}s", remedy)
        return self.folder / f"{name}{self._suffix}"

    def there(self, name: str) -> Path:
        """Return the place of a file that is there. Raises ParameterError for a wrong name, NotThere."""
        path = self.place(name)
        if not path.is_file():
            raise NotThere(f"there is no such {self._kind}", f"{self._kind} {name}", "choose one of the list")
        return path

    def content(self, name: str) -> bytes:
        """Return the bytes of a file. Raises NotThere, LogError for a file that is too large."""
        return read_bytes(self.there(name), self._most_bytes)

    def save(self, name: str, text: str, overwrite: bool = False) -> None:
        """Write a file, whole or not at all. Raises ParameterError for a wrong name, Rejected for an existing one."""
        path = self.place(name)
        make_folder(self.folder)
        if not path.exists() and len(self.listed()) >= self._most:
            raise Rejected(f"there are {self._most} {self._kind}s already", f"{self._kind}s", "delete one")
        try:
            check_free(path, overwrite)
        except LogError as reason:
            raise Rejected(f"there is a {self._kind} '{name}'", f"{self._kind}s", "choose another name") from reason
        with atomic_write(path, "w") as file:
            file.write(text)

    def delete(self, name: str) -> None:
        """Delete a file. Raises NotThere."""
        self.there(name).unlink()
