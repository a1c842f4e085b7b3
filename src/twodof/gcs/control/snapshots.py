"""Snapshots: sets of parameters kept by name in a folder, each a file that QGroundControl loads."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from twodof.errors import LogError, ParameterError, shown
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.provenance import read_bytes
from twodof.gcs.control.parameter_file import MAX_BYTES, ParameterFile

SUFFIX = ".params"
MOST = 500
"""Snapshots of a folder."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,59}")


class Snapshots(Mapping[str, ParameterFile]):
    """The snapshots in `folder`, by name. A damaged file raises ParameterError where it is read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __iter__(self) -> Iterator[str]:
        found = (path.stem for path in self._folder.glob(f"*{SUFFIX}") if _NAME.fullmatch(path.stem))
        return iter(sorted(found))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._place(name).is_file()

    def __getitem__(self, name: str) -> ParameterFile:
        """Raises KeyError for one that is not there, ParameterError for a name that cannot be, or a damaged file."""
        path = self._place(name)
        if not path.is_file():
            raise KeyError(name)
        try:
            return ParameterFile.read(read_bytes(path, MAX_BYTES), f"snapshot '{name}'")
        except LogError as reason:
            raise ParameterError(reason.what, f"snapshot '{name}'", reason.remedy) from reason

    def kept(self, name: str) -> float:
        """When it was written [s of Unix time]. Raises KeyError."""
        try:
            return self._place(name).stat().st_mtime
        except FileNotFoundError:
            raise KeyError(name) from None

    def save(self, name: str, file: ParameterFile, overwrite: bool = False) -> None:
        """Keep a set under a new name. Raises ParameterError for a name that cannot be, or is there already."""
        path = self._place(name)
        self._folder.mkdir(parents=True, exist_ok=True)
        if len(self) >= MOST and not path.exists():
            raise ParameterError(f"there are {MOST} snapshots", "snapshots", "delete some that you no longer need")
        try:
            check_free(path, overwrite)
        except LogError as reason:
            raise ParameterError(
                f"there is a snapshot '{name}'", "snapshots", "choose another name, or overwrite it"
            ) from reason
        with atomic_write(path, "w") as target:
            target.write(file.text())

    def delete(self, name: str) -> None:
        """Raises KeyError for one that is not there."""
        try:
            self._place(name).unlink()
        except FileNotFoundError:
            raise KeyError(name) from None

    def _place(self, name: str) -> Path:
        if not _NAME.fullmatch(name) or name.endswith(SUFFIX):
            raise ParameterError(
                f"{shown(name)} cannot be a snapshot's name",
                "snapshots",
                "take letters, digits, space, . _ + -, at most 60, and begin with a letter or digit",
            )
        return self._folder / f"{name}{SUFFIX}"
