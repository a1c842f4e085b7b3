"""The cache of what was compiled: sealed files by content, run as they lie there, so nobody else may have put them."""

import fcntl
import hashlib
import os
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

VERSION = "twodof-cache-3"
MOST_ENTRIES = 2000
MOST_BYTES = 2 * 1024**3
_SEAL = hashlib.sha256().digest_size
_FORSAKEN_S = 1200.0
"""Twice what a build may take: a folder of one that cannot be locked is given up after that."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_tidied: set[Path] = set()


def cache_folder() -> Path:
    """The user's folder of what was compiled: TWODOF_CACHE, or XDG_CACHE_HOME/twodof, or ~/.cache/twodof."""
    named = os.environ.get("TWODOF_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "twodof"
    except RuntimeError:  # no home
        return Path(tempfile.gettempdir()) / f"twodof-{os.getuid()}"


@contextmanager
def cached(key: Sequence[str], suffix: str, make: Callable[[Path], None], afresh: bool = False) -> Iterator[Path]:
    """The sealed file that `make(path)` writes for what `key` says, from the cache if it is there.

    It appears in the cache at once or not at all, so that several processes may make the same. `make` may leave other
    files in the folder of its path. Where the cache cannot be written, or others could have put something into it, it
    is done without.
    """
    digest = hashlib.sha256("\0".join((VERSION, *key)).encode()).hexdigest()
    folder = _own(cache_folder())
    if folder is not None and folder not in _tidied:
        _tidied.add(folder)
        _tidy(folder)
    if folder is not None and not afresh and contents(folder / f"{digest}{suffix}") is not None:
        yield folder / f"{digest}{suffix}"
        return
    with _place(folder) as work:
        made = work / f"program{suffix}"
        make(made)
        seal(made, digest)
        if folder is not None and work.parent == folder:
            entry = folder / f"{digest}{suffix}"
            made.replace(entry)  # atomic: another process sees the old file, none, or the whole new one
            _tidy(folder)
            _prune(folder)
            made = entry
        yield made


def cached_bytes(key: Sequence[str], suffix: str, make: Callable[[Path], None], afresh: bool = False) -> bytes:
    """The bytes of the file that `cached` gives, without its seal.

    They come also where another process makes room in the cache between our look at the file and our reading it.
    """
    with suppress(FileNotFoundError), cached(key, suffix, make, afresh) as file:
        return file.read_bytes()[:-_SEAL]
    with cached(key, suffix, make, afresh=True) as file:
        return file.read_bytes()[:-_SEAL]


def contents(file: Path) -> bytes | None:
    """What is in the entry `file`; None where it is not there, not whole, not of this name, or not ours alone.

    Owner and mode are those of the file that is read. A seal is not a signature: who could write it could seal it. That
    the same file is loaded afterwards is sure since nobody else can change the folder (`_own`).
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or not _ours(found) or found.st_mode & _OTHERS_WRITE:
            return None
        data = stream.read()
    whole = len(data) > _SEAL and _digest(file.stem, data[:-_SEAL]) == data[-_SEAL:]
    return data[:-_SEAL] if whole else None


def seal(file: Path, name: str) -> None:
    """Append the digest of the entry's `name` and bytes to `file`, and let nobody else write it."""
    data = file.read_bytes()
    with file.open("ab") as stream:
        os.fchmod(stream.fileno(), stat.S_IMODE(os.fstat(stream.fileno()).st_mode) & ~_OTHERS_WRITE)
        stream.write(_digest(name, data))
        stream.flush()
        os.fsync(stream.fileno())


def _digest(name: str, data: bytes) -> bytes:
    return hashlib.sha256(name.encode() + data).digest()


def _ours(found: os.stat_result) -> bool:
    """Whether it belongs to this user, or to root."""
    return found.st_uid in (0, os.getuid())


def _own(folder: Path) -> Path | None:
    """`folder`, made if it is not there, if nobody else can put a file into it or another folder into its place.

    That is so where it and all above it belong to this user or to root, and others can write in none of them. Above it
    others may write where a sticky bit keeps them from renaming what is not theirs (/tmp). Links are followed before.
    Warns of a folder that exists and that others can change.
    """
    try:
        folder = folder.resolve()
        for missing in reversed([one for one in (folder, *folder.parents) if not one.exists()]):
            missing.mkdir(mode=0o700, exist_ok=True)
        for place in (folder, *folder.parents):
            found = place.lstat()
            kept = stat.S_ISVTX if place != folder else 0
            if not _ours(found) or (found.st_mode & _OTHERS_WRITE and not found.st_mode & kept):
                _warn(folder, place, _ours(found))
                return None
    except (OSError, RuntimeError):  # a cache that cannot be is no reason not to run
        return None
    return folder


def _warn(folder: Path, place: Path, ours: bool) -> None:
    """Says why the cache is not used, and how it will be: what others may have written into it must go."""
    if place != folder:
        why = f"others may exchange this cache of compiled code, since they may write into {place}"
    else:
        why = "others may write into this cache of compiled code"
    mend = f"remove it (rm -r {folder}), it is then made anew and yours alone; or " if ours and place == folder else ""
    warnings.warn(
        f"{folder}: {why}, so it is not used; {mend}name another folder in TWODOF_CACHE", RuntimeWarning, stacklevel=5
    )


@contextmanager
def _place(folder: Path | None) -> Iterator[Path]:
    """A folder for one build: in `folder` if it can be there, and locked as long as its process lives."""
    try:
        work = Path(tempfile.mkdtemp(dir=folder, prefix="new-" if folder is not None else "twodof-"))
    except OSError:  # a cache that cannot be written is no reason not to run
        work = Path(tempfile.mkdtemp(prefix="twodof-"))
    lock = os.open(work, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        if work.parent == folder:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            work = work.rename(folder / work.name.replace("new-", "build-", 1))  # from now on it is looked at
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)
        os.close(lock)


def _tidy(folder: Path) -> None:
    """Removes what builds have left whose process was ended: their folders are not locked any more."""
    with suppress(OSError):
        for item in folder.iterdir():
            if item.name.startswith(("build-", "new-")):
                _tidy_away(item)


def _tidy_away(item: Path) -> None:
    try:
        descriptor = os.open(item, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if item.name.startswith("build-"):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        elif time.time() - os.fstat(descriptor).st_mtime < _FORSAKEN_S:
            return
        shutil.rmtree(item, ignore_errors=True)
    except OSError:  # it is being built in
        return
    finally:
        os.close(descriptor)


def _prune(folder: Path) -> None:
    """Forget the oldest entries of a cache that has grown too large."""
    ages: list[tuple[int, int, Path]] = []
    with suppress(OSError):
        for item in folder.iterdir():
            found = item.lstat()
            if stat.S_ISREG(found.st_mode):
                ages.append((found.st_mtime_ns, found.st_size, item))
        if len(ages) <= MOST_ENTRIES and sum(size for _, size, _ in ages) <= MOST_BYTES:
            return
        for _, _, old in sorted(ages)[: max(1, len(ages) // 2)]:
            old.unlink(missing_ok=True)
