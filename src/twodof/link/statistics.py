"""Statistics of a link: loss per sender, round trip and clock offset."""

from dataclasses import dataclass, field

from twodof.link.mavlink.framing import Frame

# A sequence number is one byte: what is behind by more than half of its range is ahead.
_RANGE, _HALF = 256, 128
WINDOW = 64
MOST_SENDERS = 256
MOST_ASKED = 16


@dataclass(slots=True)
class SenderCounts:
    """Frames of one system and component: `lost` is gaps in their sequence that were not filled later."""

    received: int = 0
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0
    restarts: int = 0
    _last: int = -1
    _seen: int = 0  # bit n: the frame n before the last has come

    @property
    def loss(self) -> float:
        """Fraction of the frames sent that were lost, 0 to 1."""
        sent = self.received - self.duplicated + self.lost
        return self.lost / sent if sent > 0 else 0.0

    def count(self, sequence: int) -> None:
        """Count a frame by its sequence number.

        A frame up to WINDOW behind the newest was late, or is a second copy. A frame further behind, but not far ahead,
        comes from a sender that restarted.
        """
        self.received += 1
        ahead = (sequence - self._last) % _RANGE
        if self._last < 0:
            self._last, self._seen = sequence, 1
        elif 0 < ahead < _HALF:
            self.lost += ahead - 1
            self._last, self._seen = sequence, (self._seen << ahead | 1) & (1 << WINDOW) - 1
        elif (behind := (_RANGE - ahead) % _RANGE) >= WINDOW:
            self.restarts += 1
            self._last, self._seen = sequence, (1 << WINDOW) - 1
        elif self._seen >> behind & 1:
            self.duplicated += 1
        else:
            # Before the first frame that came nothing was counted as lost.
            self.reordered += 1
            self.lost = max(0, self.lost - 1)
            self._seen |= 1 << behind


@dataclass(slots=True)
class RoundTrips:
    """Round trips [s] of TIMESYNC and PING: their number, the last, the least and an exponentially weighted mean."""

    count: int = 0
    last: float = 0.0
    least: float = float("inf")
    mean: float = 0.0
    offset: float = 0.0  # the other clock minus ours [s], from the quickest round trip
    _asked: dict[int, float] = field(default_factory=dict)

    def asked(self, token: int, now: float) -> None:
        """Note that the request `token` was sent at `now` [s]; if there are too many, forget the oldest."""
        self._asked[token] = now
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]

    def answered(self, token: int, now: float, theirs: float | None = None) -> float | None:
        """Return the round trip [s] of the answer to request `token` at `now` [s]; None for an unknown request.

        `theirs` is the other clock in the answer [s].
        """
        sent = self._asked.pop(token, None)
        if sent is None or now < sent:
            return None
        self.last = now - sent
        self.mean = self.last if self.count == 0 else self.mean + 0.1 * (self.last - self.mean)
        self.count += 1
        if self.last < self.least:
            self.least = self.last
            if theirs is not None:
                self.offset = theirs - (sent + now) / 2.0
        return self.last


class LinkStatistics:
    """All counts of received frames of one link."""

    def __init__(self) -> None:
        self.senders: dict[tuple[int, int], SenderCounts] = {}
        self.round_trips = RoundTrips()

    def __repr__(self) -> str:
        received = sum(one.received for one in self.senders.values())
        trip = f", round trip {1e3 * self.round_trips.last:.3g} ms" if self.round_trips.count else ""
        return f"<{received} frames of {len(self.senders)} senders, {100.0 * self.loss:.2g} % lost{trip}>"

    def count(self, frame: Frame) -> None:
        """Count an accepted frame, of the first MOST_SENDERS senders."""
        sender = self.senders.get((frame.system, frame.component))
        if sender is None and len(self.senders) < MOST_SENDERS:
            sender = self.senders[frame.system, frame.component] = SenderCounts()
        if sender is not None:
            sender.count(frame.sequence)

    @property
    def loss(self) -> float:
        """Fraction of all senders' frames that were lost, 0 to 1."""
        lost = sum(one.lost for one in self.senders.values())
        sent = lost + sum(one.received - one.duplicated for one in self.senders.values())
        return lost / sent if sent > 0 else 0.0
