"""Log download: LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END and LOG_ERASE, for each client by itself.

A client's list is numbered from 0 as in PX4. It is valid until the client requests another, so that no number moves
when a log is written or deleted. A log that is being written keeps its size in the list. The client requests lost parts
again. Another thread reads the file, which is sent in portions.
"""

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from functools import partial
from itertools import chain
from typing import Any

from twodof.errors import TwodofError
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, Steps, read_block
from twodof.fcu.mavlink.service import Service, Vehicle, source
from twodof.fcu.onboard_log.log_writer import StoredLog
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.link.connection import Received
from twodof.link.mavlink.messages import Packer, message

PART = 90
"""Bytes in a LOG_DATA."""
BLOCK = 512 * PART
"""Bytes that are read from the disk at once."""
MOST_READERS = 16
A_TICK, A_TICK_ARMED = 32, 4
"""LOG_DATA and LOG_ENTRY sent in a control period, to all clients together: .7 MB/s, and few while armed."""


class LogDownload(Service):
    """Service that lists, sends and erases the logs of `log`; erasing needs the lease."""

    def __init__(self, vehicle: Vehicle, log: OnboardLogger) -> None:
        takes = {
            "LOG_REQUEST_LIST": lambda received: self._do(received, self._list(received)),
            "LOG_REQUEST_DATA": lambda received: self._do(received, self._read(received)),
            "LOG_REQUEST_END": lambda received: self._end(received.peer),
            "LOG_ERASE": lambda received: self._do(received, self._erase(received)),
        }
        super().__init__(vehicle, takes, everybody=True)
        self._log = log
        self._background = BackgroundWorker(inline=vehicle.lockstep)
        self._sender = PacedSender(lambda peer, sent: vehicle.send(sent, peer), vehicle.lockstep, A_TICK)
        self._lists: OrderedDict[Hashable, list[StoredLog]] = OrderedDict()
        self._entries: dict[Hashable, Iterator[Any]] = {}
        self._data: dict[Hashable, Iterator[Any]] = {}
        self._pack = Packer("LOG_DATA")

    def after(self, step: ControlStep) -> None:
        self._sender.most = A_TICK_ARMED if step.armed else A_TICK
        self._background.poll()
        self._sender.tick()

    def gone(self, peer: Hashable) -> None:
        self._lists.pop(peer, None)
        self._end(peer)

    def _end(self, peer: Hashable) -> None:
        self._sender.stop(peer)
        self._entries.pop(peer, None)
        self._data.pop(peer, None)

    def _start(self, peer: Hashable) -> None:
        """Send a client the list entries and data that it still waits for, the list first."""
        self._sender.start(peer, chain(self._entries.get(peer, ()), self._data.get(peer, ())))

    def _do(self, received: Received, steps: Steps) -> None:
        """Carry out a request, and tell the client why that fails."""

        def explained() -> Steps:
            try:
                yield from steps
            except (OSError, TwodofError) as refusal:
                self._vehicle.explain(received.peer, str(refusal))

        self._background.carry_out(explained())

    def _list(self, received: Received) -> Steps:
        peer, got = received.peer, received.message
        found = yield self._log.logs
        self._keep(peer, found)
        rows = [*enumerate(found)][got.start : got.end + 1]
        self._entries[peer] = (self._entry(len(found), *row) for row in rows) if found else iter([message("LOG_ENTRY")])
        self._start(peer)

    def _keep(self, peer: Hashable, logs: list[StoredLog]) -> None:
        self._lists[peer] = logs
        if len(self._lists) > MOST_READERS:
            self._end(self._lists.popitem(last=False)[0])

    def _entry(self, count: int, number: int, log: StoredLog) -> Any:
        size, time_utc = min(log.size, 0xFFFFFFFF), log.time_utc & 0xFFFFFFFF
        last = {"num_logs": count, "last_log_num": count - 1}
        return message("LOG_ENTRY", id=number, size=size, time_utc=time_utc, **last)

    def _read(self, received: Received) -> Steps:
        peer, got = received.peer, received.message
        logs = self._lists.get(peer) or (yield self._log.logs)  # it may know the list from before
        if got.id >= len(logs):
            self._vehicle.explain(peer, f"log {got.id} does not exist")
            return
        self._keep(peer, logs)
        self._data[peer] = self._parts(peer, logs[got.id], got.id, got.ofs, got.count)
        self._start(peer)

    def _parts(self, peer: Hashable, log: StoredLog, number: int, at: int, count: int) -> Iterator[Any]:
        """Yield LOG_DATA, None while the disk is read."""
        end = min(at + count, log.size)
        # A client that asks for more than there is is told where it ends, by a part that is not full.
        tail = at >= log.size or (at + count > log.size and (log.size - at) % PART == 0)
        while at < end:
            found: list[object] = []
            while not self._background.submit(partial(read_block, log.path, at, BLOCK), found.append):
                yield None
            while not found:
                yield None
            block = found[0]
            if not isinstance(block, bytes) or not block:
                self._vehicle.explain(peer, f"log {number} cannot be read: {block or 'it is shorter now'}")
                return
            if len(block) < BLOCK:  # shorter than it was: that is its end now
                end = min(end, at + len(block))
            for part in (block[begins : begins + PART] for begins in range(0, min(len(block), end - at), PART)):
                part = part[: end - at]
                yield self._pack(at, number, len(part), *part.ljust(PART, b"\0"))
                at += len(part)
        if tail:
            yield self._pack(at, number, 0, *bytes(PART))

    def _erase(self, received: Received) -> Steps:
        taken = self._vehicle.take(source(received), "logs")
        if not taken.accepted:
            self._vehicle.explain(received.peer, taken.text)
            return
        try:
            yield self._log.erase
        finally:
            for reader in [*self._lists]:
                self.gone(reader)
