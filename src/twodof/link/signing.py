"""MAVLink 2 signing: keys in files, time stamps that are never used twice, and the check of a frame's signature.

pymavlink signs what leaves, and does not check what arrives. Its own check stores the time stamp of a frame before it
has checked the signature. One forged frame with a stamp of the year 2100 then shuts the true sender out (tried with
pymavlink 2.4.50). The check here looks at the signature first. Its other rules are those of
https://mavlink.io/en/guide/message_signing.html:

- a signature is the first 6 bytes of SHA-256 over the key and the frame up to the signature;
- a stamp must exceed the last stamp of its stream; a new stream may be one minute behind our time;
- our time is the later one of the clock and the highest accepted stamp.

A peer whose clock is ahead therefore sets the time for all. A peer that is behind catches up as soon as it hears a
signed frame; `Connection` sends it one.
"""

import codecs
import fcntl
import hashlib
import hmac
import json
import os
import re
import secrets
import stat
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from twodof.errors import LinkError, LogError
from twodof.flightlog.atomic import atomic_write, sync_folder
from twodof.link.mavlink.framing import SIGNATURE, Frame

KEY_BYTES = 32
SHORTEST_PASSPHRASE = 12
_HEX = re.compile(rb"[0-9a-fA-F]{64}\s*")

PER_SECOND = 100_000
"""Stamps in a second: a stamp counts 10 us since 2015-01-01."""
EPOCH_S = 1_420_070_400
HIGHEST = 2**48 - 1
MARGIN = 10 * PER_SECOND
"""How far the stamp on the disk runs ahead of the stamps that were used, so that frames need no write each."""
MOST_AHEAD = 365 * 24 * 3600 * PER_SECOND
"""A stamp further ahead of the clock is refused, since it would spend the range of stamps, which ends in 2104.

A lower bound would refuse a peer whose clock is wrong, and its refused frames could be replayed once their time comes.
"""
MOST_STREAMS = 1024
MOST_FILE_BYTES = 100_000
WRITE_S = 5.0
RETRY_S = 1.0
OWN = "own"
TELL_S = 0.1
"""Shortest interval [s] at which peers with a right signature and an old stamp are sent our time.

A replayed packet looks the same, so few are answered. Over UDP the peer may get no other message from us.
"""

SIGNATURE_HASH = 6
NEW_STREAM_BEHIND = 60 * PER_SECOND
# A clock in the first year of the count was never set, so it judges nobody.
UNSET = 365 * 24 * 3600 * PER_SECOND


@dataclass(frozen=True, eq=False)
class Key:
    """A MAVLink 2 signing key. Its text is a fingerprint, which tells two keys apart and reveals neither."""

    secret: bytes

    def __post_init__(self) -> None:
        if not isinstance(self.secret, bytes) or len(self.secret) != KEY_BYTES:
            raise LinkError(f"a signing key has {KEY_BYTES} bytes", "key", "use Key.fresh, Key.of or read_key")

    def __repr__(self) -> str:
        return f"Key({self.fingerprint})"

    def __reduce__(self) -> str:
        raise TypeError("a signing key cannot be pickled: let the other process read the key's file")

    @property
    def fingerprint(self) -> str:
        """The first 8 hexadecimal digits of a hash of the key."""
        return hashlib.sha256(b"twodof fingerprint" + self.secret).hexdigest()[:8]

    @classmethod
    def fresh(cls) -> "Key":
        """Draw a key at random."""
        return cls(secrets.token_bytes(KEY_BYTES))

    @classmethod
    def of(cls, passphrase: str) -> "Key":
        """Make the key of a passphrase: its SHA-256, as in QGroundControl and MAVProxy.

        One recorded frame is enough to try passphrases offline, so short ones are refused. Raises LinkError under
        SHORTEST_PASSPHRASE characters.
        """
        if len(passphrase) < SHORTEST_PASSPHRASE:
            what = f"a passphrase of {len(passphrase)} characters is easily guessed"
            raise LinkError(what, "key", f"choose {SHORTEST_PASSPHRASE} or more, such as five random words")
        return cls(hashlib.sha256(passphrase.encode()).digest())


def read_key(path: str | Path) -> Key:
    """Read a key from a file of 64 hexadecimal digits.

    Raises LinkError if the file cannot be read, holds no key, or gives rights to users other than its owner.
    """
    data = _read_guarded(Path(path), 200, 0o077, "the key", "and change the key", f"make one: twodof key {path}")
    data = data.removeprefix(codecs.BOM_UTF8)
    if not _HEX.fullmatch(data):
        raise LinkError("holds no key of 64 hexadecimal digits", str(path), f"make one: twodof key {path}")
    return Key(bytes.fromhex(data.decode("ascii").strip()))


def write_key(path: str | Path, key: Key) -> None:
    """Write a key to a new file that only its owner can read.

    Raises LinkError if the file exists or the system refuses.
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
        Path(path).unlink(missing_ok=True)  # half a key is useless
        why = error.strerror if isinstance(error, OSError) else error.what
        raise LinkError(f"cannot be written: {why}", str(path), "make room on the disk") from error


def _read_guarded(path: Path, most: int, forbidden: int, what: str, beside: str, remedy: str) -> bytes:
    """Read at most `most` bytes of `what` from our own file, on which other users have no `forbidden` rights.

    Raises LinkError otherwise. `beside` completes the remedy for a wrong owner or mode. If the file cannot be read,
    the remedy is `remedy` and the OSError is the cause.
    """
    try:
        # Without O_NONBLOCK a named pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise LinkError(f"{what} cannot be read: {error.strerror}", str(path), remedy) from error
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise LinkError(f"{what}: is not a file", str(path), "name a file")
        if found.st_uid != os.geteuid():
            owner = f"{what}: the file belongs to another user"
            raise LinkError(owner, str(path), f"copy it to a file of your own, {beside}")
        if found.st_mode & forbidden:
            rights = "read or write" if forbidden & 0o044 else "write"
            mode = f"others may {rights} {what} (mode {stat.S_IMODE(found.st_mode):04o})"
            raise LinkError(mode, str(path), f"chmod 600 {path}, {beside}")
        return file.read(most)


def wall_stamp() -> int:
    """Return the stamp of the system's clock."""
    return max(0, int((time.time() - EPOCH_S) * PER_SECOND))


class Stamps:
    """Time stamps over restarts: none of ours is used twice, none of a peer's is accepted twice.

    The file at `path` holds one stamp. All stamps up to it count as used in the next run. It runs
    ahead of use by up to MARGIN, so that it is written every few seconds, in the background, and holds after a crash.
    `path` None keeps nothing. Only one process may have a file at a time. Raises LinkError if another process has it,
    or if it cannot be read, because a guess would let old frames in. A disk that fails later stops no flight, since a
    kill must get through: `failure` says why, and the write is tried again each second.
    """

    def __init__(self, path: str | Path | None, clock: Callable[[], int] = wall_stamp) -> None:
        self.clock = clock
        self.failure = ""
        self._path = None if path is None else Path(path)
        self.streams: dict[str, int] = {}
        """Highest stamp accepted of each stream in this run."""
        self._lock = -1 if self._path is None else _lock(self._path)
        try:
            self.floor = 0 if self._path is None else _read(self._path)
        except LinkError:
            os.close(self._lock)
            raise
        self._used = self._stored = self.floor
        self._pool = None if self._path is None else ThreadPoolExecutor(1, "stamps")
        self._writing: tuple[int, Future[None]] | None = None
        self._retry_at = 0.0

    @property
    def own(self) -> int:
        """Our time: the clock, or the highest stamp that was used."""
        return max(self.clock(), self._used)

    def next_own(self) -> int:
        """Return a stamp that was never used: the clock, or the highest used stamp plus one."""
        stamp = max(self.clock(), self._used + 1)
        if stamp > HIGHEST:
            raise LinkError("the time stamps of this key are used up", "signing", "set the clock and change the key")
        self._use(stamp)
        return stamp

    def accept(self, stream: str, stamp: int) -> None:
        """Record that a stream used all stamps up to `stamp`; our time follows it."""
        self.streams[stream] = stamp
        self._use(max(stamp, self._used))

    def close(self) -> None:
        """Write the exact stamp and release the file. Raises LinkError if the write fails."""
        if self._path is None or self._pool is None:
            return
        try:
            self._finish_write()
            _write(self._path, self._used)
        finally:
            self._pool.shutdown()
            self._pool = None
            os.close(self._lock)

    def _use(self, stamp: int) -> None:
        """Note a used stamp. Wait for the disk only if the stored stamp is already behind."""
        self._used = stamp
        if self._path is None or self._pool is None:
            return
        while self._stored < min(stamp + MARGIN // 2, HIGHEST) and time.monotonic() >= self._retry_at:
            if self._writing is None:
                ahead = min(HIGHEST, stamp + MARGIN)
                self._writing = ahead, self._pool.submit(_write, self._path, ahead)
            if stamp <= self._stored and not self._writing[1].done():
                return
            self._finish_write()

    def _finish_write(self) -> None:
        if self._writing is None:
            return
        (ahead, writing), self._writing = self._writing, None
        try:
            writing.result(timeout=WRITE_S)
        except (LinkError, TimeoutError) as error:
            self.failure = str(error) or "the disk does not answer"
            self._retry_at = time.monotonic() + RETRY_S
        else:
            self.failure, self._stored = "", ahead


def _lock(path: Path) -> int:
    """Lock the file beside `path` for this process and return its descriptor."""
    try:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        descriptor = os.open(f"{path}.lock", flags, 0o600)
    except OSError as error:
        remedy = "choose a folder that exists and that this user may write"
        raise LinkError(f"cannot be locked: {error.strerror}", str(path), remedy) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        taken = isinstance(error, BlockingIOError)
        what = "another process signs with these time stamps" if taken else f"cannot be locked: {error.strerror}"
        remedy = "give each process a file of its own" if taken else "choose a folder whose file system can lock files"
        raise LinkError(what, str(path), remedy) from error
    return descriptor


def _read(path: Path) -> int:
    """Read the highest stamp of a file that other users cannot have set back; 0 if the file is missing.

    Files of earlier versions hold a stamp for each stream.
    """
    beside = "and change the key: old packets could come back"
    try:
        data = _read_guarded(path, MOST_FILE_BYTES + 1, 0o022, "the time stamps", beside, "make it readable")
    except LinkError as error:
        if isinstance(error.__cause__, FileNotFoundError):  # any other reason may hide stamps
            return 0
        raise
    try:
        found: Any = json.loads(data) if len(data) <= MOST_FILE_BYTES else None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict) or not all(type(one) is int and 0 <= one <= HIGHEST for one in found.values()):
        raise LinkError("holds no time stamps", str(path), f"remove it {beside}")
    return max(found.values(), default=0)


def _write(path: Path, stamp: int) -> None:
    try:
        with atomic_write(path, "w") as file:
            json.dump({OWN: stamp}, file)
    except LogError as error:
        raise LinkError(f"the time stamps are not kept: {error.what}", str(path), "make room on the disk") from error


class SigningVerdict(Enum):
    """Result of the check of a frame; the value is the reason in words."""

    ACCEPTED = "accepted"
    UNSIGNED = "not signed"
    FORGED = "its signature is wrong"
    REPEATED = "its time stamp was used before"
    STALE = "its time stamp is more than a minute old"
    AHEAD = "its time stamp is more than a year ahead"


@dataclass(slots=True)
class _Outgoing:
    """Signing state in the form that pymavlink's `pack` takes."""

    secret_key: bytes = field(repr=False)
    link_id: int
    timestamp: int = 0
    sign_outgoing: bool = True


class Signing:
    """A key with its time stamps and counts. `link_id` (0 to 255) tells the links of one sender apart."""

    def __init__(self, key: Key, stamps: Stamps, link_id: int = 0) -> None:
        self.key = key
        self.stamps = stamps
        self.counts = Counter(dict.fromkeys(SigningVerdict, 0))
        self._outgoing = _Outgoing(key.secret, link_id & 0xFF)

    def __repr__(self) -> str:
        return f"Signing({self.key!r}, link {self._outgoing.link_id})"

    @property
    def refused(self) -> int:
        """Frames that were not accepted."""
        return self.counts.total() - self.counts[SigningVerdict.ACCEPTED]

    def outgoing(self) -> object:
        """Return the argument with which `framing.encode` signs the next frame."""
        self._outgoing.timestamp = self.stamps.next_own()
        return self._outgoing

    def check(self, frame: Frame) -> SigningVerdict:
        """Check the signature and the stamp of a received frame; count and return the verdict."""
        verdict = self._judge(frame)
        self.counts[verdict] += 1
        return verdict

    def _judge(self, frame: Frame) -> SigningVerdict:
        if not frame.signed:
            return SigningVerdict.UNSIGNED  # RADIO_STATUS too: it would keep alive any sender that it names
        raw, stamps = frame.raw, self.stamps
        signed = hashlib.sha256(self.key.secret + raw[:-SIGNATURE_HASH]).digest()[:SIGNATURE_HASH]
        if not hmac.compare_digest(signed, raw[-SIGNATURE_HASH:]):
            return SigningVerdict.FORGED
        link, stamp = raw[-SIGNATURE], int.from_bytes(raw[-SIGNATURE + 1 : -SIGNATURE_HASH], "little")
        stream = f"{link}:{frame.system}:{frame.component}"
        last, own, now = stamps.streams.get(stream), stamps.own, stamps.clock()
        if stamp <= (stamps.floor if last is None else last):
            return SigningVerdict.REPEATED
        if last is None and (stamp + NEW_STREAM_BEHIND < own or len(stamps.streams) >= MOST_STREAMS):
            return SigningVerdict.STALE
        if now > UNSET and stamp > max(now + MOST_AHEAD, own + NEW_STREAM_BEHIND):
            return SigningVerdict.AHEAD
        stamps.accept(stream, stamp)
        return SigningVerdict.ACCEPTED

    def close(self) -> None:
        """Store the time stamps. Raises LinkError if that fails."""
        self.stamps.close()


class Admission:
    """Filter of the received frames of one link; without `signing` it accepts all."""

    def __init__(self, signing: Signing | None) -> None:
        self._signing = signing
        self._told = -TELL_S

    def admits(self, frame: Frame, now: float, tell: Callable[[], None]) -> bool:
        """Return whether a frame is accepted at `now` [s].

        If its signature is right and its stamp too old, call `tell`, which sends the peer our time.
        """
        if self._signing is None:
            return True
        verdict = self._signing.check(frame)
        if verdict in (SigningVerdict.REPEATED, SigningVerdict.STALE) and now - self._told >= TELL_S:
            self._told = now
            with suppress(LinkError):  # the peer is gone, or no stamps are left
                tell()
        return verdict is SigningVerdict.ACCEPTED
