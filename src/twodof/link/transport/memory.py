"""Links within one process: nothing is lost, nothing is late, everything in order; for lockstep and for tests."""

import threading
from collections.abc import Hashable
from weakref import WeakValueDictionary

from twodof.errors import LinkError
from twodof.link.transport.base import Packet, Transport
from twodof.link.transport.url import Address


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
