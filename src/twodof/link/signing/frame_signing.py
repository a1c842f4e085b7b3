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

import hashlib
import hmac
from dataclasses import dataclass
from enum import Enum

from twodof.link.mavlink.framing import SIGNATURE, Frame
from twodof.link.signing.key import Key
from twodof.link.signing.time_stamps import MOST_AHEAD, OWN, PER_SECOND, Stamps

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
