"""MAVLink 2 signing: what leaves is signed by pymavlink, what comes is accepted only signed, fresh and unrepeated.

Why not pymavlink's own check: it stores a stream's time stamp before it has looked at the signature. One forged packet
with a stamp of the year 2100 shuts the true sender out (tried with pymavlink 2.4.50: the next good packet is refused).
This check looks at the signature first. Otherwise its rules are those of
https://mavlink.io/en/guide/message_signing.html:

- a signature is the first 6 bytes of SHA-256 over the key and the packet up to there;
- a stamp must exceed the last of its stream; a new stream may be one minute behind our time;
- our time follows the highest stamp that was taken.

So who was ahead once has set the time for all. Who is behind since then catches up by hearing anybody: `Connection`
sees to it that it hears us.
"""

import fcntl
import hashlib
import hmac
import json
import os
import re
import secrets
import stat
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from twodof.errors import LinkError, LogError
from twodof.flightlog.atomic import atomic_write, sync_folder
from twodof.link.mavlink.framing import SIGNATURE, Frame

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


PER_SECOND = 100_000
EPOCH_S = 1_420_070_400
HIGHEST = 2**48 - 1
# After a crash a peer is refused for as long at most, and ours run ahead of the clock by as much.
MARGIN = 10 * PER_SECOND
# A stamp further ahead of our clock than this is no clock's, and would spend the range, which ends in 2104. Less would
# refuse a peer whose clock is wrong, and let what was refused of it be said again by others once its time has come.
MOST_AHEAD = 365 * 24 * 3600 * PER_SECOND
MOST_STREAMS = 1024
MOST_FILE_BYTES = 100_000
WRITE_SECONDS = 5.0
OWN = "own"


def wall_stamp() -> int:
    """Now, by the system's clock."""
    return max(0, int((time.time() - EPOCH_S) * PER_SECOND))


class Stamps:
    """Highest stamp used by each stream, on the disk ahead of its use.

    A stream is a name: `OWN`, or link, system and component of a sender. `path` None keeps nothing: for tests, and for
    a key that lives no longer than the process. One process at a time may have a file. Raises LinkError if another
    has it, or if it cannot be read: guessing would let old packets in. A disk that fails later stops no flight, as a
    kill must always get through: `failure` says so, and it is tried again each second.
    """

    def __init__(self, path: str | Path | None, clock: Callable[[], int] = wall_stamp) -> None:
        self._path = Path(path) if path is not None else None
        self.clock = clock
        self._used: dict[str, int] = {}
        self._stored: dict[str, int] = {}
        self._writing: Future[None] | None = None
        self._ahead: dict[str, int] = {}
        self._lock_file = -1
        self.failure = ""
        self._retry_at = 0.0
        if self._path is not None:
            self._take_lock(self._path)
            try:
                self._stored = _read(self._path)
            except LinkError:
                self._drop_lock()
                raise
            self._used = dict(self._stored)
        self._pool = ThreadPoolExecutor(1, "stamps") if self._path is not None else None

    def next_own(self) -> int:
        """A stamp of ours that was never used: the clock, or one more than the last."""
        stamp = max(self.clock(), self._used.get(OWN, 0) + 1)
        if stamp > HIGHEST:
            raise LinkError("the time stamps of this key are used up", "signing", "set the clock and change the key")
        self.use(OWN, stamp)
        return stamp

    @property
    def own(self) -> int:
        """Our time: the clock, or the highest stamp of ours."""
        return max(self.clock(), self._used.get(OWN, 0))

    @property
    def room(self) -> bool:
        """Whether one more stream may begin."""
        return len(self._used) < MOST_STREAMS

    def last(self, stream: str) -> int | None:
        """The highest stamp that `stream` used, None if it is new."""
        return self._used.get(stream)

    def use(self, stream: str, stamp: int) -> None:
        """Say that `stream` used everything up to `stamp`; it is on the disk, or `failure` says why not."""
        self._used[stream] = stamp
        if self._path is None:
            return
        if stamp > self._stored.get(stream, -1):
            self._settle()
            if stamp > self._stored.get(stream, -1) and time.monotonic() >= self._retry_at:
                self._try(lambda: self._write(self._reserved()))
        elif stamp > self._stored[stream] - MARGIN // 2 and self._writing is None and self._pool is not None:
            self._ahead = self._reserved()
            self._writing = self._pool.submit(_write, self._path, self._ahead)
        elif self._writing is not None and self._writing.done():
            self._settle()

    def close(self) -> None:
        """Write what was really used, so that nobody waits for the margin, and let others have the file.

        Raises LinkError if that fails.
        """
        if self._path is None or self._pool is None:
            return
        try:
            self._settle()
            self._write(dict(self._used))
        finally:
            self._pool.shutdown()
            self._pool = None
            self._drop_lock()

    def _reserved(self) -> dict[str, int]:
        return {stream: min(HIGHEST, used + MARGIN) for stream, used in self._used.items()}

    def _write(self, stamps: dict[str, int]) -> None:
        if self._path is not None:
            _write(self._path, stamps)
            self._stored = stamps

    def _settle(self) -> None:
        """Wait for the write in the background, if there is one."""
        if self._writing is not None:
            writing, self._writing = self._writing, None
            if self._try(lambda: writing.result(timeout=WRITE_SECONDS)):
                self._stored = self._ahead

    def _try(self, write: Callable[[], None]) -> bool:
        """Whether a write went well; if not, it is kept in mind and not tried again for a second."""
        try:
            write()
        except (LinkError, TimeoutError) as error:
            self.failure = str(error) or "the disk does not answer"
            self._retry_at = time.monotonic() + 1.0
            return False
        self.failure = ""
        return True

    def _take_lock(self, path: Path) -> None:
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
            self._lock_file = os.open(f"{path}.lock", flags, 0o600)
            fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._drop_lock()
            taken = isinstance(error, BlockingIOError)
            what = "another process signs with these time stamps" if taken else f"cannot be locked: {error.strerror}"
            raise LinkError(what, str(path), "give each process a file of its own") from error

    def _drop_lock(self) -> None:
        if self._lock_file >= 0:
            os.close(self._lock_file)
            self._lock_file = -1


def _read(path: Path) -> dict[str, int]:
    """The stamps in a file that nobody but its owner, us, can have set back."""
    beside = "and change the key: old packets could come back"
    try:
        data = read_guarded(path, MOST_FILE_BYTES + 1, 0o022, "the time stamps", beside, "make it readable")
    except LinkError as error:
        if isinstance(error.__cause__, FileNotFoundError):  # any other refusal may hide stamps that were kept
            return {}
        raise
    try:
        found: Any = json.loads(data) if len(data) <= MOST_FILE_BYTES else None
    except (ValueError, RecursionError):
        found = None
    sound = isinstance(found, dict) and len(found) <= MOST_STREAMS
    if not sound or not all(type(value) is int and 0 <= value <= HIGHEST for value in found.values()):
        raise LinkError("holds no time stamps", str(path), f"remove it {beside}")
    return {str(stream): value for stream, value in found.items()}


def _write(path: Path, stamps: dict[str, int]) -> None:
    try:
        with atomic_write(path, "w") as file:
            json.dump(stamps, file)
    except LogError as error:
        raise LinkError(f"the time stamps are not kept: {error.what}", str(path), "make room on the disk") from error


SIGNATURE_HASH = 6
NEW_STREAM_BEHIND = 60 * PER_SECOND
# A clock in the first year of the stamps' count was never set; whoever is ahead of it is right.
UNSET = 365 * 24 * 3600 * PER_SECOND


class SigningVerdict(Enum):
    """What became of a frame; its value is the reason in words."""

    ACCEPTED = "accepted"
    UNSIGNED = "not signed"
    FORGED = "its signature is wrong"
    REPEATED = "its time stamp was used before"
    STALE = "its time stamp is more than a minute old"
    AHEAD = "its time stamp is more than a year ahead"


@dataclass(slots=True)
class SigningCounts:
    """Frames by verdict."""

    accepted: int = 0
    unsigned: int = 0
    forged: int = 0
    repeated: int = 0
    stale: int = 0
    ahead: int = 0

    @property
    def refused(self) -> int:
        """Frames that were not let in."""
        return self.unsigned + self.forged + self.repeated + self.stale + self.ahead


@dataclass(slots=True)
class _Outgoing:
    """What pymavlink's packing asks for."""

    secret_key: bytes
    link_id: int
    timestamp: int = 0
    sign_outgoing: bool = True

    def __repr__(self) -> str:
        return f"signing on link {self.link_id}"


class Signing:
    """A key, its time stamps, and what was accepted and refused. `link_id` (0 to 255) tells one's own links apart."""

    def __init__(self, key: Key, stamps: Stamps, link_id: int = 0) -> None:
        self.key = key
        self.stamps = stamps
        self.counts = SigningCounts()
        self._outgoing = _Outgoing(key.secret, link_id & 0xFF)

    def __repr__(self) -> str:
        return f"Signing({self.key!r}, link {self._outgoing.link_id})"

    def outgoing(self) -> object:
        """What `framing.encode` signs the next packet with."""
        self._outgoing.timestamp = self.stamps.next_own()
        return self._outgoing

    def check(self, frame: Frame) -> SigningVerdict:
        """Whether to take a frame; counted."""
        verdict = self._judge(frame)
        name = verdict.name.lower()
        setattr(self.counts, name, getattr(self.counts, name) + 1)
        return verdict

    def _judge(self, frame: Frame) -> SigningVerdict:
        if not frame.signed:
            return SigningVerdict.UNSIGNED  # a radio's own RADIO_STATUS too: whom it names it would keep alive
        raw = frame.raw
        signed = hashlib.sha256(self.key.secret + raw[:-SIGNATURE_HASH]).digest()[:SIGNATURE_HASH]
        if not hmac.compare_digest(signed, raw[-SIGNATURE_HASH:]):
            return SigningVerdict.FORGED
        link, stamp = raw[-SIGNATURE], int.from_bytes(raw[-SIGNATURE + 1 : -SIGNATURE_HASH], "little")
        stream = f"{link}:{frame.system}:{frame.component}"
        last, own = self.stamps.last(stream), self.stamps.own
        if last is not None and stamp <= last:
            return SigningVerdict.REPEATED
        if last is None and (stamp + NEW_STREAM_BEHIND < own or not self.stamps.room):
            return SigningVerdict.STALE
        now = self.stamps.clock()
        if now > UNSET and stamp > max(now + MOST_AHEAD, own + NEW_STREAM_BEHIND):
            return SigningVerdict.AHEAD
        self.stamps.use(stream, stamp)
        if stamp > own:  # their clock is ahead: ours follows, or they would refuse what we send
            self.stamps.use(OWN, stamp)
        return SigningVerdict.ACCEPTED

    def close(self) -> None:
        """Keep the time stamps. Raises LinkError if they cannot be."""
        self.stamps.close()
