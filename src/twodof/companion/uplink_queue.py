"""The queue to the flight controller: kills first, a turn for every client, and no more than the line carries.

A frame that fits goes out at once. Beyond that each client has a queue of its own. The client of which the fewest bytes
were sent is served next, so that a client that floods loses its own frames only. A new client starts with the byte
count of the client that was served last.
"""

from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field

from twodof.errors import LinkLost
from twodof.link.transport.base import Transport

MOST_QUEUED_BYTES = 128 << 10
STALE_S = 1.0
"""An older set-point does harm, and would keep the lease of a dead client alive."""
# How far a serial line may be ahead [s]: a kill cannot overtake what its driver holds.
AHEAD_S = 0.01
# The same for the buffer of a network connection.
MOST_BACKLOG_BYTES = 2 << 10
POLL_S = 0.002
BITS_A_BYTE = 10  # start, eight, stop
# A network carries more frames than the flight controller can read beside flying. Each frame counts as in TCP over IP,
# so that a flood of small frames is bounded too. Lockstep at a hundred times real time stays below it.
NETWORK_RATE = 1e6
NETWORK_FRAME = 40


@dataclass(slots=True)
class _Queue:
    """Waiting frames of a client with their deadlines, their bytes, and the bytes that were sent of it."""

    served: int
    frames: deque[tuple[float, bytes]] = field(default_factory=deque)
    size: int = 0


class UplinkQueue:
    """Frames to the flight controller. `rate` is what the line carries [byte/s], None for as much as the system takes.

    `overhead` is added to the bytes of each frame.
    """

    def __init__(self, rate: float | None = None, overhead: int = 0) -> None:
        self.sent_bytes = 0
        self.transport: Transport | None = None
        self.rate = rate
        self.overhead = overhead
        self._free_at = 0.0  # when the line will have sent what it was given
        self._urgent: dict[tuple[Hashable, Hashable], bytes] = {}
        self._queues: dict[Hashable, _Queue] = {}  # none is empty
        self._level = 0  # bytes that were sent of the client which was served last

    def connect(self, transport: Transport) -> None:
        """Send over `transport`, which is open, from now on."""
        self.transport = transport
        self._free_at = 0.0

    def cut(self) -> None:
        """Drop everything that waits: a command of before the cut must not act after it."""
        self.transport = None
        self._urgent.clear()
        self._queues.clear()

    @property
    def waiting(self) -> bool:
        """True if frames wait for their turn."""
        return bool(self._urgent or self._queues)

    def offer(
        self, source: Hashable, raw: bytes, now: float, urgent: Hashable | None = None, stale_s: float = STALE_S
    ) -> bool:
        """Send a frame of `source` now, or in its turn within `stale_s` [s]; return False if it was dropped.

        A frame with a key `urgent` goes before all others and is never dropped for want of room. While it waits, a
        second frame of the same source with the same key is ignored.
        """
        if self.transport is None:
            return False
        if urgent is not None:
            self._urgent.setdefault((source, urgent), raw)
            self.pump(now)
            return True
        if not self.waiting and self._room(now):
            return self._send(raw, now)
        queue = self._queues.setdefault(source, _Queue(self._level))
        if queue.size + len(raw) > MOST_QUEUED_BYTES:
            return False
        queue.frames.append((now + stale_s, raw))
        queue.size += len(raw)
        self.pump(now)
        return True

    def pump(self, now: float) -> float | None:
        """Send what may go now; return in how many seconds to call again, None if nothing waits."""
        while self._urgent and self._room(now):
            self._send(self._urgent.pop(next(iter(self._urgent))), now)
        while self._queues and not self._urgent and self._room(now):
            source = min(self._queues, key=lambda one: self._queues[one].served)
            queue = self._queues[source]
            deadline, raw = queue.frames.popleft()
            queue.size -= len(raw)
            if not queue.frames:
                del self._queues[source]
            if now <= deadline:
                self._level = queue.served = queue.served + len(raw)
                self._send(raw, now)
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
        try:
            self.transport.send(raw)
        except LinkLost:  # the reader of the link notices it too
            return False
        if self.rate is not None:
            self._free_at = max(self._free_at, now) + (len(raw) + self.overhead) / self.rate
        self.sent_bytes += len(raw)
        return True
