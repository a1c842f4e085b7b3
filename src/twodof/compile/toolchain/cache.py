"""Cache of compiled files by the digest of their sources and options, in a folder of this user alone."""

import hashlib
import os
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

Read = TypeVar("Read")
VERSION = "twodof-cache-4"
MOST_ENTRIES = 2000
MOST_BYTES = 2 * 1024**3
FORSAKEN_S = 1200.0
"""Age from which a build folder belongs to a killed process: twice the longest build."""


def cache_folder() -> Path:
    """Return the folder of compiled files: TWODOF_CACHE, or XDG_CACHE_HOME/twodof, or ~/.cache/twodof."""
    named = os.environ.get("TWODOF_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "twodof"
    except RuntimeError:  # no home
        return Path(tempfile.gettempdir()) / f"twodof-{os.getuid()}"


def cached(key: Sequence[str], suffix: str, make: Callable[[Path], None], read: Callable[[Path], Read]) -> Read:
    """Return `read(file)` of the file that `make(file)` writes for `key`, from the cache if it can be read there.

    An entry appears whole or not at all, so several processes may make the same one. An entry for which `read` raises
    an exception is damaged, or another process has just removed it: it is made again. `make` may leave other files in
    the folder of its path. Without a folder that only this user can write, the file is made and not kept.
    """
    folder = _own_folder()
    name = hashlib.sha256("\0".join((VERSION, *key)).encode()).hexdigest() + suffix
    if folder is not None and (folder / name).is_file():
        with suppress(Exception):
            return read(folder / name)
    with tempfile.TemporaryDirectory(dir=folder, prefix="making-", ignore_cleanup_errors=True) as work:
        made = Path(work, f"program{suffix}")
        make(made)
        found = read(made)
        if folder is not None:
            with made.open("rb") as file:
                os.fsync(file.fileno())  # before it gets its name, so that a power cut leaves no torn entry
            made.replace(folder / name)
            _prune(folder)
    return found


def _own_folder() -> Path | None:
    """Return the cache's folder, or None if it cannot be made or another user owns it or may write into it."""
    folder = cache_folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
        if not os.access(folder, os.W_OK):
            return None
    except OSError:
        return None
    if found.st_uid == os.getuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return folder
    warnings.warn(
        f"{folder}: others may write into this cache of compiled code, so it is not used; remove it "
        f"(rm -r {folder}), or name another folder in TWODOF_CACHE",
        RuntimeWarning,
        stacklevel=4,
    )
    return None


def _prune(folder: Path) -> None:
    """Remove folders of killed builds, and the oldest half of a cache that has grown too large."""
    entries: list[tuple[float, int, Path]] = []
    with suppress(OSError):
        for item in folder.iterdir():
            found = item.stat()
            if item.is_file():
                entries.append((found.st_mtime, found.st_size, item))
            elif item.name.startswith("making-") and found.st_mtime < time.time() - FORSAKEN_S:
                shutil.rmtree(item, ignore_errors=True)
        if len(entries) > MOST_ENTRIES or sum(size for _, size, _ in entries) > MOST_BYTES:
            for _, _, old in sorted(entries)[: max(1, len(entries) // 2)]:
                old.unlink(missing_ok=True)
