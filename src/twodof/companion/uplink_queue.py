"""The line to the flight controller: every client has its turn, a kill goes first, and it is never asked for too much.

What fits goes out at once. Beyond that each client has a queue of its own, served in turn by bytes (deficit round
robin: Shreedhar and Varghese, 1995), so that one that floods loses its own frames and nobody else's.
"""

from collections import deque
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from twodof.errors import LinkLost
from twodof.link.transport.base import Transport

# A client's queue: more than that it will not get through before it is stale.
MOST_QUEUED_BYTES = 128 << 10
# An older set-point does harm, and would let a dead client's lease live on.
STALE_S = 1.0
QUANTUM = 300  # not less than the longest frame
# A serial line may be ahead by so much: what its driver holds cannot be overtaken by a kill.
AHEAD_S = 0.01
# A network's own buffer, for the same reason.
MOST_BACKLOG_BYTES = 2 << 10
POLL_S = 0.002
BITS_A_BYTE = 10  # start, eight, stop
# A network carries more than the flight controller can read beside flying, so that a flood of small frames is bounded
# too: each counts as in TCP over IP. Lockstep at a hundred times real time stays below it.
NETWORK_RATE = 1e6
NETWORK_FRAME = 40


@dataclass(slots=True)
class UplinkCounts:
    """Frames and bytes that went out, and frames that did not: queue full, too old, or no link."""

    sent: int = 0
    bytes: int = 0
    crowded_out: int = 0
    stale: int = 0
    cut: int = 0


@dataclass(slots=True)
class _Queue:
    frames: deque[tuple[float, bytes]] = field(default_factory=deque)
    size: int = 0
    credit: int = 0


class UplinkQueue:
    """Toward the flight controller. `rate` is what it carries [byte/s], None for as much as the system takes.

    `overhead` is how many bytes a frame takes on it beyond its own.
    """

    def __init__(self, rate: float | None = None, overhead: int = 0) -> None:
        self.counts = UplinkCounts()
        self.transport: Transport | None = None
        self.rate = rate
        self.overhead = overhead
        self._free_at = 0.0  # when the line will have sent what it was given
        self._gathers = False
        self._gathered: list[bytes] = []  # what went out and is handed to the system with what follows
        self._urgent: dict[tuple[Hashable, Hashable], bytes] = {}
        self._queues: dict[Hashable, _Queue] = {}  # those that have something, in the order of their turns

    def connect(self, transport: Transport) -> None:
        """The link stands, with nothing left of before."""
        self.transport = transport
        self._gathered.clear()
        self._free_at = 0.0

    def cut(self) -> None:
        """The link is gone, and with it what waited: a command of before the cut must not act after it."""
        self.transport = None
        self.counts.cut += len(self._urgent) + sum(len(queue.frames) for queue in self._queues.values())
        self._urgent.clear()
        self._gathered.clear()
        self._queues.clear()

    @property
    def waiting(self) -> bool:
        """Whether something waits for its turn."""
        return bool(self._urgent or self._queues)

    @contextmanager
    def together(self) -> Iterator[None]:
        """On a stream, hand what goes out during the block to the system in one piece at its end.

        A client that floods sends frames by the hundred, and one call to the system costs ten times the routing.
        """
        self._gathers = self.transport is not None and not self.transport.whole
        try:
            yield
        finally:
            self._gathers = False
            self._hand_over()

    def offer(self, source: Hashable, raw: bytes, now: float, urgent: Hashable | None = None) -> bool:
        """Send a frame of `source` now or in its turn; False if it was dropped.

        An `urgent` frame goes before all turns and is never dropped for want of room. While one waits, another of the
        same source and the same `urgent` says nothing new.
        """
        if self.transport is None:
            self.counts.cut += 1
            return False
        if urgent is not None:
            self._urgent.setdefault((source, urgent), raw)
            self.pump(now)
            return True
        if not self.waiting and self._room(now):
            return self._send(raw, now)
        queue = self._queues.setdefault(source, _Queue())
        if queue.size + len(raw) > MOST_QUEUED_BYTES:
            self.counts.crowded_out += 1
            return False
        queue.frames.append((now, raw))
        queue.size += len(raw)
        self.pump(now)
        return True

    def pump(self, now: float) -> float | None:
        """Send what may go now; in how many seconds to call again, None if nothing waits."""
        while self._urgent and self._room(now):
            self._send(self._urgent.pop(next(iter(self._urgent))), now)
        while self._queues and not self._urgent and self._room(now):
            source, queue = next(iter(self._queues.items()))
            while queue.frames and now - queue.frames[0][0] > STALE_S:
                queue.size -= len(queue.frames.popleft()[1])
                self.counts.stale += 1
            if queue.frames and len(queue.frames[0][1]) <= queue.credit:
                raw = queue.frames.popleft()[1]
                queue.size -= len(raw)
                queue.credit -= len(raw)
                self._send(raw, now)
            elif queue.frames:
                queue.credit += QUANTUM
                self._queues[source] = self._queues.pop(source)  # its turn comes again after the others'
            if not queue.frames:
                del self._queues[source]
        if not self.waiting:
            return None
        return max(self._free_at - AHEAD_S - now, POLL_S / 4) if self.rate is not None else POLL_S

    def _room(self, now: float) -> bool:
        if self.rate is not None and self._free_at - now > AHEAD_S:
            return False
        return self.transport is not None and self.transport.backlog < MOST_BACKLOG_BYTES

    def _send(self, raw: bytes, now: float) -> bool:
        if self.transport is None:
            return False
        if self._gathers:
            self._gathered.append(raw)
        elif not self._hand_over(raw):
            return False
        if self.rate is not None:
            self._free_at = max(self._free_at, now) + (len(raw) + self.overhead) / self.rate
        self.counts.sent += 1
        self.counts.bytes += len(raw)
        return True

    def _hand_over(self, *raw: bytes) -> bool:
        """Give the system what was gathered, and this; False if the link is gone."""
        frames, self._gathered = [*self._gathered, *raw], []
        if not frames or self.transport is None:
            return False
        try:
            self.transport.send(b"".join(frames))
        except LinkLost:  # its reader finds out and says so
            self.counts.cut += len(frames)
            return False
        return True
