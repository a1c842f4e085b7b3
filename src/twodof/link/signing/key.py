"""Signing keys: 32 bytes in a file that only its owner can read, never in a log, a repr or a command line."""

import hashlib
import os
import re
import secrets
import stat
from dataclasses import dataclass
from pathlib import Path

from twodof.errors import LinkError, LogError
from twodof.flightlog.atomic import sync_folder

KEY_BYTES = 32
SHORTEST_PASSPHRASE = 12
_HEX = re.compile(rb"[0-9a-fA-F]{64}\s*")


@dataclass(frozen=True, eq=False)
class Key:
    """A MAVLink 2 signing key; its text shows a fingerprint, which tells two keys apart and gives neither away."""

    secret: bytes

    def __post_init__(self) -> None:
        if not isinstance(self.secret, bytes) or len(self.secret) != KEY_BYTES:
            raise LinkError(f"a signing key has {KEY_BYTES} bytes", "key", "use Key.fresh, Key.of or read_key")

    def __repr__(self) -> str:
        return f"Key({self.fingerprint})"

    def __reduce__(self) -> str:
        raise TypeError("a signing key is not pickled: let the other process read the key's file")

    @property
    def fingerprint(self) -> str:
        """The first 8 hexadecimal digits of a hash of the key."""
        return hashlib.sha256(b"twodof fingerprint" + self.secret).hexdigest()[:8]

    @classmethod
    def fresh(cls) -> "Key":
        """A key drawn at random."""
        return cls(secrets.token_bytes(KEY_BYTES))

    @classmethod
    def of(cls, passphrase: str) -> "Key":
        """The key of a passphrase: its SHA-256, as QGroundControl and MAVProxy make it.

        Whoever records one packet can try passphrases at leisure, so that a short one is refused: raises LinkError
        under SHORTEST_PASSPHRASE characters.
        """
        if len(passphrase) < SHORTEST_PASSPHRASE:
            what = f"a passphrase of {len(passphrase)} characters is guessed"
            raise LinkError(what, "key", f"take {SHORTEST_PASSPHRASE} or more, such as five random words")
        return cls(hashlib.sha256(passphrase.encode()).digest())


def read_key(path: str | Path) -> Key:
    """The key in a file of 64 hexadecimal digits.

    Raises LinkError if the file cannot be read, holds no key, or could be read or written by anybody but its owner.
    """
    data = read_guarded(Path(path), 200, 0o077, "the key", "and change the key", f"make one: twodof key {path}")
    if not _HEX.fullmatch(data):
        raise LinkError("holds no key of 64 hexadecimal digits", str(path), f"make one: twodof key {path}")
    return Key(bytes.fromhex(data.decode("ascii").strip()))


def read_guarded(path: Path, most: int, forbidden: int, what: str, beside: str, remedy: str) -> bytes:
    """At most `most` bytes of a file of ours, `what`, of which nobody else has the `forbidden` rights.

    Raises LinkError for any other, with `beside` as what to do besides mending owner or rights. With `remedy`, and the
    OSError as its cause, if it cannot be read.
    """
    try:
        # A pipe would wait for who writes to it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise LinkError(f"{what} cannot be read: {error.strerror}", str(path), remedy) from error
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise LinkError(f"{what}: is not a file", str(path), "name a file")
        if found.st_uid != os.geteuid():
            said = f"{what}: the file belongs to another user"
            raise LinkError(said, str(path), f"copy it to a file of your own, {beside}")
        if found.st_mode & forbidden:
            rights = "read or write" if forbidden & 0o044 else "write"
            said = f"others may {rights} {what} (mode {stat.S_IMODE(found.st_mode):04o})"
            raise LinkError(said, str(path), f"chmod 600 {path}, {beside}")
        return file.read(most)


def write_key(path: str | Path, key: Key) -> None:
    """Write a key to a new file that only its owner can read.

    Raises LinkError where there is a file already, and where the system refuses.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except FileExistsError as error:
        raise LinkError("is there already", str(path), "choose another name, or remove it first") from error
    except OSError as error:
        raise LinkError(f"cannot be written: {error.strerror}", str(path), "choose another folder") from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(key.secret.hex().encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        sync_folder(Path(path).resolve().parent)
    except (OSError, LogError) as error:
        Path(path).unlink(missing_ok=True)  # half a key is none
        why = error.strerror if isinstance(error, OSError) else error.what
        raise LinkError(f"cannot be written: {why}", str(path), "make room on the disk") from error
