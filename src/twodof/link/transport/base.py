"""Base of all transports: packets of bytes out and in, bounded queues whose drops are counted, a clear end.

Sending never waits: bytes that the system does not take are queued up to a bound, and then dropped and counted.
Receiving waits up to a deadline. A transport that is lost or closed returns the packets that have arrived, then raises
LinkLost. It does not reconnect by itself; `open_transport` opens a new one. UDP is never lost: a silent peer may come
back, and the layer above judges silence. Links within one process (`mem://`) lose and delay nothing.
"""

import asyncio
import threading
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar
from weakref import WeakValueDictionary

from twodof.errors import LinkError, LinkLost
from twodof.link.transport.url import Address

# A second of eight drones at full rate; beyond that the reader is stuck, and the oldest packets are worth least.
MOST_PACKETS = 8192
MOST_BYTES = 4 << 20
MOST_OUT_BYTES = 256 << 10
READ_BYTES = 65_536
# A turn is for as many bytes as the longest frame has, of which a packet takes so many at least.
TURN_BYTES, LEAST_BYTES = 280, 32
# Frames of one peer that go before all turns at once.
MOST_AHEAD = 4
_Given = TypeVar("_Given")


class Packet(NamedTuple):
    """Bytes that arrived, and their sender, which `Transport.send` takes as `to`.

    `ahead`: a kill or disarm, taken before its turn; it comes once more, in its turn.
    """

    data: bytes
    peer: Hashable
    ahead: bool = False


@dataclass(slots=True)
class TransportCounts:
    """Packets and bytes that passed, and packets that were dropped because a queue was full or a peer one too many."""

    packets_in: int = 0
    bytes_in: int = 0
    packets_out: int = 0
    bytes_out: int = 0
    dropped_in: int = 0
    dropped_out: int = 0
    errors: int = 0


@dataclass(slots=True)
class _Queue:
    """Waiting packets of one peer, their bytes, and the bytes left of its turn; below 0 it has had too much."""

    packets: deque[bytes] = field(default_factory=deque)
    size: int = 0
    credit: int = 0


class Inbox:
    """Bounded queue of packets that arrived, filled from any thread; the oldest are dropped and counted.

    Peers take turns by bytes (deficit round robin), so that a flooding peer does not delay the others. Packets of one
    peer keep their order. Kills and disarms go before all turns.
    """

    def __init__(self, counts: TransportCounts) -> None:
        self._loop = asyncio.get_running_loop()
        self._counts = counts
        self._queues: dict[Hashable, _Queue] = {}  # by peer, in the order of their turns; none is empty
        self._packets = self._bytes = 0
        self._ahead: deque[Packet] = deque()
        self._ahead_of: Counter[Hashable] = Counter()
        self._fullest: Hashable = None  # the peer of which most packets wait, as far as it is known
        self._waiter: asyncio.Future[None] | None = None
        self._end: LinkLost | None = None
        self.stops_first = False
        self.on_taken: Callable[[Hashable], None] | None = None

    @property
    def full(self) -> bool:
        """True if the queue is more than half full: a stream that fills it should be paused."""
        return self._bytes > MOST_BYTES // 2 or self._packets > MOST_PACKETS // 2

    def put(self, packet: Packet) -> None:
        """Add a packet. If the box is full, the peer with most packets loses its oldest."""
        data, peer, _ = packet
        self._counts.packets_in += 1
        self._counts.bytes_in += len(data)
        queue = self._queues.setdefault(peer, _Queue())
        queue.packets.append(data)
        queue.size += len(data)
        if self._waiting(peer) > self._waiting(self._fullest):
            self._fullest = peer
        self._packets += 1
        self._bytes += len(data)
        while self._packets > 1 and (self._bytes > MOST_BYTES or self._packets > MOST_PACKETS):
            first = next(iter(self._queues))
            self._oldest(self._fullest if self._waiting(self._fullest) > self._waiting(first) else first)
            self._counts.dropped_in += 1
        self._wake()

    def put_ahead(self, raw: bytes, peer: Hashable) -> None:
        """Add a kill or disarm that is also `put`; at most MOST_AHEAD of a peer wait here."""
        if self._ahead_of[peer] < MOST_AHEAD:
            self._ahead_of[peer] += 1
            self._ahead.append(Packet(raw, peer, ahead=True))
            self._wake()

    def take_ahead(self) -> Packet | None:
        """Return the oldest kill or disarm of `put_ahead`, None if there is none."""
        if not self._ahead:
            return None
        packet = self._ahead.popleft()
        self._ahead_of[packet.peer] -= 1
        if not self._ahead_of[packet.peer]:
            del self._ahead_of[packet.peer]
        return packet

    def waits_of(self, peer: Hashable) -> int:
        """Return the number of waiting bytes of `peer`."""
        return self._queues[peer].size if peer in self._queues else 0

    def _waiting(self, peer: Hashable) -> int:
        """Return the number of waiting packets of `peer`."""
        return len(self._queues[peer].packets) if peer in self._queues else 0

    def _next(self) -> Hashable:
        """Return the peer whose turn it is; a peer that took too many bytes waits for as many turns."""
        while True:
            peer, queue = next(iter(self._queues.items()))
            if queue.credit > 0:
                return peer
            queue.credit += TURN_BYTES
            if queue.credit <= 0:
                self._queues[peer] = self._queues.pop(peer)

    def _oldest(self, peer: Hashable) -> Packet:
        """Take the oldest packet of `peer`; its turn is over once it has used up its bytes."""
        queue = self._queues[peer]
        data = queue.packets.popleft()
        self._packets -= 1
        self._bytes -= len(data)
        queue.size -= len(data)
        queue.credit -= max(len(data), LEAST_BYTES)
        if not queue.packets:
            del self._queues[peer]
        elif queue.credit <= 0:
            self._queues[peer] = self._queues.pop(peer)
        return Packet(data, peer)

    def end(self, reason: LinkLost) -> None:
        """End the queue: once it is empty, `take` raises `reason`. A second call has no effect."""
        self._end = self._end or reason
        self._wake()

    def from_anywhere(self, call: Callable[[_Given], None], given: _Given) -> None:
        """Call `put` or `end` with `given`, from any thread or loop; do nothing once the queue's loop is closed."""
        if _running_loop() is self._loop:
            call(given)
        elif not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, given)

    def take(self) -> Packet | None:
        """Return the next packet, None if there is none now. Raises LinkLost if the queue has ended and is empty."""
        packet = self.take_ahead()
        if packet is None and self._queues:
            packet = self._oldest(self._next())
            if self.on_taken is not None:
                self.on_taken(packet.peer)
        if packet is None and self._end is not None:
            raise LinkLost(self._end.what, self._end.where, self._end.remedy)
        return packet

    async def wait(self, timeout: float) -> Packet | None:
        """Wait up to `timeout` [s] for the next packet; return None if none comes. Raises LinkLost as `take`."""
        packet = self.take()
        if packet is not None or timeout <= 0:
            return packet
        if self._waiter is not None:
            raise RuntimeError("two tasks receive from one transport: let one receive and hand on")
        waiter = self._waiter = self._loop.create_future()
        handle = self._loop.call_later(timeout, _finish, waiter)
        try:
            await waiter
        finally:
            handle.cancel()
            self._waiter = None
        return self.take()

    def _wake(self) -> None:
        if self._waiter is not None:
            _finish(self._waiter)


def _finish(waiter: asyncio.Future[None]) -> None:
    if not waiter.done():
        waiter.set_result(None)


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


class Transport(ABC):
    """Packets to and from one peer or several; use it in the event loop that opened it.

    `whole` says that a packet is a datagram: no frame goes across two of them.
    """

    whole: bool = False

    def __init__(self, url: str) -> None:
        self.url = url
        self.counts = TransportCounts()
        self._inbox = Inbox(self.counts)
        self.keeps: Callable[[Hashable], bool] = lambda peer: False
        """Function that returns True for a peer that must keep its place: the pilot's."""
        self.closed = False
        """Whether it was closed or lost."""

    async def __aenter__(self) -> "Transport":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    @abstractmethod
    def peers(self) -> tuple[Hashable, ...]:
        """Peers that `send` without `to` reaches."""

    @property
    def backlog(self) -> int:
        """Bytes that were sent and still wait for the system; 0 for a transport without a queue."""
        return 0

    def confirm(self, peer: Hashable) -> None:
        """Note that `peer` sent a valid frame; from now on it is among `peers`.

        Listening UDP sends to such peers only, so that rubbish from a forged address draws no telemetry there.
        Listening TCP gives the places of all other peers to newcomers first.
        """
        return

    def is_unplaced(self, peer: Hashable) -> bool:
        """Return True if a peer sent a packet but has no place among `peers`, because there are too many."""
        return False

    def send(self, data: bytes, to: Hashable | None = None) -> None:
        """Send a packet to one peer, or to all of `peers`; a peer that is gone gets nothing, without an error.

        Raises LinkLost once the transport is closed or lost.
        """
        if self.closed:
            raise LinkLost("the link is closed", self.url, "open it again")
        for peer in self.peers if to is None else (to,):
            if self._send(data, peer):
                self.counts.packets_out += 1
                self.counts.bytes_out += len(data)
            else:
                self.counts.dropped_out += 1

    async def receive(self, timeout: float) -> Packet | None:
        """Return the next packet, or None if none comes within `timeout` [s]; with 0 it does not wait.

        Raises LinkLost when the link is closed or lost, after the packets that had arrived. One task may wait at once.
        """
        return await self._inbox.wait(timeout)

    def receive_now(self) -> Packet | None:
        """Return the next packet if one is there. Raises LinkLost as `receive`."""
        return self._inbox.take()

    def let_stops_go_first(self) -> None:
        """Receive kills and disarms before everything else that has arrived, from now on (`Packet.ahead`)."""
        self._inbox.stops_first = True

    def receive_ahead(self) -> Packet | None:
        """Return the next kill or disarm that arrived, None if there is none."""
        return self._inbox.take_ahead()

    async def close(self) -> None:
        """Close the link now; a second call does nothing. A task that waits in `receive` gets LinkLost."""
        self._lose("the link was closed")
        # Sockets are closed by the loop in its next round; a caller may end the loop right after this.
        await asyncio.sleep(0)

    def _lose(self, what: str, remedy: str = "open it again") -> None:
        """End the link, after a call of `close` or by the other side."""
        if not self.closed:
            self.closed = True
            self._release()
        self._inbox.from_anywhere(self._inbox.end, LinkLost(what, self.url, remedy))

    @abstractmethod
    def _send(self, data: bytes, peer: Hashable) -> bool:
        """Hand the packet to the system; False if it was dropped."""

    @abstractmethod
    def _release(self) -> None:
        """Release the resources of the system; called once."""


class MemoryTransport(Transport):
    """One end of links in memory; made by `open_memory` and `memory_pair`.

    Ends may live in different threads, each in its own event loop; a packet sent is in the other's inbox when `send`
    returns if both share a loop.
    """

    whole = True

    def __init__(self, url: str, listens: bool) -> None:
        super().__init__(url)
        self._listens = listens
        self._ends: dict[MemoryTransport, None] = {}

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The other ends that are open."""
        return tuple(self._ends)

    def _join(self, other: "MemoryTransport") -> None:
        self._ends[other] = None
        other._ends[self] = None

    def _send(self, data: bytes, peer: Hashable) -> bool:
        if not isinstance(peer, MemoryTransport) or peer not in self._ends:
            return False
        peer._inbox.from_anywhere(peer._inbox.put, Packet(bytes(data), self))
        return True

    def _release(self) -> None:
        with _lock:
            if _listening.get(self.url) is self:
                del _listening[self.url]
        for other in [*self._ends]:
            other._ends.pop(self, None)
            if not other._listens:
                other._lose("the other end was closed")
        self._ends.clear()


# What listens in this process: the one place that both ends of a mem:// link know.
_listening: WeakValueDictionary[str, MemoryTransport] = WeakValueDictionary()
_lock = threading.Lock()


def open_memory(address: Address) -> MemoryTransport:
    """Open the end that listens at `memin://NAME`, or one that is joined to it (`mem://NAME`).

    Raises LinkError for a name that is taken, ConnectionRefusedError if no end listens yet.
    """
    place = str(Address("memin", address.name))
    with _lock:
        there = _listening.get(place)
        if address.listens:
            if there is not None:
                raise LinkError("is taken", place, "choose another name, or close the link that has it")
            _listening[place] = transport = MemoryTransport(place, listens=True)
            return transport
        if there is None:
            raise ConnectionRefusedError
        transport = MemoryTransport(str(address), listens=False)
        transport._join(there)
        return transport


def memory_pair() -> tuple[MemoryTransport, MemoryTransport]:
    """Make two ends that are joined to each other."""
    one, other = MemoryTransport("mem://pair", listens=False), MemoryTransport("mem://pair", listens=False)
    one._join(other)
    return one, other
