"""A generated tree: its files by relative path, and writing all of them or none."""

import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twodof.errors import CompileError, LogError
from twodof.flightlog.atomic import atomic_write

MANIFEST = "twodof-px4.json"
FORMAT = 1
_LARGEST_MANIFEST = 1_000_000


def manifest(files: Mapping[str, str], facts: Mapping[str, object]) -> str:
    """Return the text of the manifest: `facts`, and the SHA-256 of each file."""
    sums = {path: hashlib.sha256(text.encode()).hexdigest() for path, text in sorted(files.items())}
    return json.dumps({"format": FORMAT, **facts, "files": sums}, indent=2) + "\n"


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a folder, or None if it does not have a valid one."""
    place = folder / MANIFEST
    try:
        if not place.is_file():
            return None
        with place.open("rb") as file:
            data = json.loads(file.read(_LARGEST_MANIFEST))
    except (OSError, ValueError, RecursionError):
        return None
    files = data.get("files") if isinstance(data, dict) else None
    good = isinstance(files, dict) and data.get("format") == FORMAT and all(isinstance(f, str) for f in files.values())
    return data if good else None


def absent(folder: Path) -> list[str]:
    """Return the files of the export that are missing in `folder`, by relative path."""
    return [path for path in sorted(_sums(folder)) if not (folder / path).is_file()]


def strangers(folder: Path) -> list[str]:
    """Return the files in `folder` that are not of the export or were changed, by relative path."""
    sums = _sums(folder)
    found = []
    for root, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(root, name)
            relative = path.relative_to(folder).as_posix()
            if relative == MANIFEST and sums:
                continue
            regular = path.is_file() and not path.is_symlink()
            if not regular or hashlib.sha256(path.read_bytes()).hexdigest() != sums.get(relative):
                found.append(relative)
    return found


def _sums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of the export in `folder`, by relative path."""
    known = read_manifest(folder)
    return known["files"] if known else {}


def write_tree(folder: Path, files: Mapping[str, str], force: bool = False) -> None:
    """Write `files`, whose manifest is among them, as `folder`: wholly or not at all.

    An empty folder and an unchanged export are replaced. An export with other or changed files is replaced only with
    `force`. Raises LogError for any other folder, CompileError where the file system refuses. The new tree is made
    beside its place and renamed into it.
    """
    target = folder.resolve()
    _check_place(target, folder, force)
    mark = secrets.token_hex(6)
    fresh, old = target.with_name(f".{target.name}.{mark}.new"), target.with_name(f".{target.name}.{mark}.old")
    try:
        fresh.mkdir(parents=True)
        for path, text in files.items():
            place = fresh / path
            place.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(place, "w") as file:
                file.write(text)
        if target.exists():
            target.rename(old)
        try:
            fresh.rename(target)
        except BaseException:
            if old.exists():
                old.rename(target)
            raise
    except OSError as refusal:
        raise CompileError(
            f"cannot be written: {refusal.strerror or refusal}",
            str(folder),
            "nothing was changed; choose another place",
        ) from refusal
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        if target.exists():  # otherwise `old` is all there is
            shutil.rmtree(old, ignore_errors=True)


def _check_place(target: Path, folder: Path, force: bool) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise LogError("is a file", str(folder), "name a folder")
    if not any(target.iterdir()):
        return
    if read_manifest(target) is None:
        raise LogError(
            "is a folder with something else in it", str(folder), "name a new or an empty folder, or an earlier export"
        )
    other = strangers(target)
    if other and not force:
        listed = ", ".join(other[:5]) + (f" and {len(other) - 5} more" if len(other) > 5 else "")
        raise LogError(
            f"has files that were added or changed since the export: {listed}",
            str(folder),
            "save them elsewhere, or give --force to lose them",
        )
