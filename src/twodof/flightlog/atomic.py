"""Files that are either there whole or not there: written beside their place, then renamed into it.

One rule holds for every command and function that writes a file named by the user: an existing file is kept, unless
`--force` or `overwrite=True` is given. `numbered` gives new names to a session that repeats. Files of twodof's own
(caches, a drone's state) are replaced without a question.
"""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path
from typing import IO, Any, Literal

from twodof.errors import LogError

REPLACE = "name another file, or replace it with --force (in Python overwrite=True)"


@contextmanager
def refused_places(path: str | Path) -> Iterator[None]:
    """Raise LogError where the file system refuses the place `path`: its name, or a folder above it."""
    try:
        yield
    except (OSError, ValueError) as refusal:
        why = refusal.strerror if isinstance(refusal, OSError) else refusal  # a name with a null character
        what = f"cannot be written: {why}"
        raise LogError(what, str(path), "choose a folder that exists and is writable") from refusal


def check_free(path: str | Path, overwrite: bool = False) -> None:
    """Raise LogError if there is a file at `path`, unless it may be overwritten."""
    with refused_places(path):
        if not overwrite and Path(path).exists():
            raise LogError("is there already", str(path), REPLACE)


def numbered(path: str | Path) -> Path:
    """Return the first of `name.ext`, `name-2.ext`, `name-3.ext`, ... that does not exist yet."""
    first = Path(path)
    names = chain((first,), (first.with_name(f"{first.stem}-{number}{first.suffix}") for number in count(2)))
    return next(name for name in names if not name.exists())


def partial_of(path: str | Path) -> Path:
    """Return a temporary name beside `path` for a file that will replace it. Raises LogError if `path` is a folder."""
    with refused_places(path):
        # A link is followed: its target is replaced, not the link.
        target = Path(path).resolve()
        if target.is_dir():
            raise LogError("is a directory", str(path), "name a file")
    return target.with_name(f".{target.name}.{secrets.token_hex(6)}.tmp")


def create(begun: Path, path: str | Path) -> int:
    """Create the file `begun`, to be renamed to `path`; return its descriptor. Raises LogError, also if it exists."""
    with refused_places(path):
        try:
            # os.open, and not tempfile, so that the user's umask decides who may read the result.
            return os.open(begun, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError as there:
            raise LogError("is there already", str(path), REPLACE) from there


@contextmanager
def atomic_write(path: str | Path, mode: Literal["wb", "w"] = "wb") -> Iterator[IO[Any]]:
    """Open a file for writing that replaces `path` only when the block ends without an exception.

    After an exception, Ctrl-C included, `path` is unchanged and no other file is left. Text is UTF-8 with the line ends
    of Unix. On return the file and its name are on the disk (fsync of the file, then of its folder). Raises LogError
    where the file system refuses.
    """
    partial = partial_of(path)
    target = Path(path).resolve()
    descriptor = create(partial, path)
    encoding, newline = ("utf-8", "\n") if mode == "w" else (None, None)
    try:
        with os.fdopen(descriptor, str(mode), encoding=encoding, newline=newline) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(target)
    except OSError as refusal:
        partial.unlink(missing_ok=True)
        what = f"cannot be written: {refusal.strerror or refusal}"
        raise LogError(what, str(path), "make room or choose another folder; nothing was changed") from refusal
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    sync_folder(target.parent)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file as `atomic_write` does. Raises LogError."""
    with atomic_write(path, "w") as file:
        file.write(text)


def make_folder(folder: Path) -> None:
    """Make `folder` and its missing parents, and sync them to the disk. Raises OSError, LogError."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for one in missing:
        sync_folder(one.parent)


def sync_folder(folder: Path) -> None:
    """Sync the entries of `folder` to the disk. Raises LogError where the file system refuses."""
    try:
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except PermissionError:  # a folder that may be written and not read: all disks, then
            os.sync()
            return
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as refusal:
        if refusal.errno in (errno.EINVAL, errno.ENOTSUP):  # a file system that cannot sync folders
            return
        what = f"was changed, but may not outlast a power cut: {refusal.strerror}"
        raise LogError(what, str(folder), "write to another disk") from refusal
