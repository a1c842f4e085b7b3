"""Log download: LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END and LOG_ERASE, for each client by itself.

A client's list is numbered from 0 as in PX4. It stays as it was sent until the client asks for another, so that no
number moves when a log is written or deleted. A log that is being written has the size that it had in the list. The
client asks again for what got lost. Another thread reads the file, which is sent in portions.
"""

from collections import OrderedDict, deque
from collections.abc import Hashable

from twodof.errors import LogError
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, read_block, shares
from twodof.fcu.mavlink.service import Explain, Link, Service, Take, VehicleAddress, source
from twodof.fcu.onboard_log.log_writer import StoredLog
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.link.connection import Received
from twodof.link.mavlink.messages import Packer, message

PART = 90
"""Bytes in a LOG_DATA."""
BLOCK = 512 * PART
"""Bytes that are read at once."""
MOST_READERS = 16
A_TICK, A_TICK_ARMED = 32, 4
"""LOG_DATA and LOG_ENTRY that are sent in a control period, to all clients: .7 MB/s, and little while it flies."""


class DownloadClient:
    """A client that reads: its list, and how far the piece of a log has come that it asked for."""

    __slots__ = ("at", "block", "block_at", "end", "entries", "list", "log", "number", "peer", "tail", "wanted")

    def __init__(self, peer: Hashable) -> None:
        self.peer = peer
        self.list: list[StoredLog] = []
        self.entries: deque[tuple[int, StoredLog | None]] = deque()  # of the list, still to be sent
        self.log: StoredLog | None = None
        self.number = self.at = self.end = 0
        self.tail = False  # whether an empty part is to say that the log ends
        self.block, self.block_at = b"", 0
        self.wanted = -1  # where the block begins that is being read

    @property
    def busy(self) -> bool:
        """Return whether there is something to send."""
        return bool(self.entries) or self.log is not None


class LogDownload(Service):
    """Sends the logs of `log`; `take` says whether a source may command (erasing), `explain` tells why not."""

    def __init__(
        self, link: Link, us: VehicleAddress, log: OnboardLogger, take: Take, explain: Explain, lockstep: bool = False
    ) -> None:
        self._link, self._us, self._log = link, us, log
        self._take_lease, self._explain = take, explain
        self._background = BackgroundWorker(inline=lockstep)
        self._pump = PacedSender(self._send_parts, lockstep)
        self._readers: OrderedDict[Hashable, DownloadClient] = OrderedDict()
        self._pack = Packer("LOG_DATA")
        self._armed = False
        self._turn = 0
        self._takes = {
            "LOG_REQUEST_LIST": self._list,
            "LOG_REQUEST_DATA": self._data,
            "LOG_REQUEST_END": self._end,
            "LOG_ERASE": self._erase,
        }

    def handle(self, received: Received) -> bool:
        """Take a request."""
        takes = self._takes.get(received.message.get_type())
        if takes is None:
            return False
        if self._us.addressed(received.message, everybody=True):
            takes(received)
        return True

    def after(self, step: ControlStep) -> None:
        self._armed = step.armed
        self._background.poll()
        self._pump.tick()

    def gone(self, peer: Hashable) -> None:
        self._readers.pop(peer, None)

    def _reader(self, peer: Hashable) -> DownloadClient:
        reader = self._readers.get(peer)
        if reader is None:
            reader = self._readers[peer] = DownloadClient(peer)
            if len(self._readers) > MOST_READERS:
                self._readers.popitem(last=False)
        return reader

    def _list(self, received: Received) -> None:
        reader = self._reader(received.peer)
        first, last = received.message.start, received.message.end

        def listed(found: object) -> None:
            if isinstance(found, list):
                reader.list = found
                self._send_list(reader, first, last)
            else:
                self._explain(reader.peer, str(found))

        self._background.submit(self._log.logs, listed)

    def _send_list(self, reader: DownloadClient, first: int, last: int) -> None:
        entries = [(number, log) for number, log in enumerate(reader.list) if first <= number <= last]
        reader.entries = deque(entries if reader.list else [(0, None)])
        self._pump.start()

    def _entry(self, reader: DownloadClient) -> None:
        number, log = reader.entries.popleft()
        entry = {}
        if log is not None:
            count = len(reader.list)
            entry = {"id": number, "num_logs": count, "last_log_num": count - 1, "size": min(log.size, 0xFFFFFFFF)}
            entry |= {"time_utc": log.time_utc & 0xFFFFFFFF}
        self._link.send(message("LOG_ENTRY", **entry), reader.peer)

    def _data(self, received: Received) -> None:
        got, reader = received.message, self._reader(received.peer)
        if not reader.list:  # it may know the list from before
            self._background.submit(
                self._log.logs, lambda found: self._begin(reader, found, got.id, got.ofs, got.count)
            )
        else:
            self._begin(reader, reader.list, got.id, got.ofs, got.count)

    def _begin(self, reader: DownloadClient, logs: object, number: int, offset: int, count: int) -> None:
        if not isinstance(logs, list) or number >= len(logs):
            self._explain(reader.peer, f"there is no log {number}")
            return
        reader.list = logs
        log: StoredLog = logs[number]
        if log is not reader.log:
            reader.block, reader.wanted = b"", -1
        reader.log, reader.number, reader.at = log, number, offset
        reader.end = min(offset + count, log.size)
        # One who asks for more than there is is told where it ends, by a part that is not full.
        reader.tail = offset >= log.size or (offset + count > log.size and (log.size - offset) % PART == 0)
        self._pump.start()

    def _end(self, received: Received) -> None:
        reader = self._readers.get(received.peer)
        if reader is not None:
            reader.log = None
            reader.block = b""
            reader.entries.clear()

    def _erase(self, received: Received) -> None:
        peer = received.peer
        taken = self._take_lease(source(received), "logs")
        if not taken.accepted:
            self._explain(peer, taken.text)
            return

        def erased(result: object) -> None:
            for reader in self._readers.values():
                reader.list, reader.log = [], None
            if isinstance(result, OSError | LogError):
                self._explain(peer, str(result))

        self._background.submit(self._log.erase, erased)

    def _send_parts(self) -> bool:
        most = A_TICK_ARMED if self._armed else A_TICK
        reading = [reader for reader in self._readers.values() if reader.busy]
        self._turn += most
        for reader, share in shares(most, reading, self._turn):
            for _ in range(min(share, len(reader.entries))):
                self._entry(reader)
            if not reader.entries:
                self._send_some(reader, share)
        return any(reader.busy for reader in reading)

    def _send_some(self, reader: DownloadClient, most: int) -> None:
        for _ in range(most):
            if reader.log is None:
                return
            if reader.at >= reader.end:
                if reader.tail:
                    self._part(reader, b"")
                reader.log = None
                return
            begins = reader.at - reader.block_at
            part = reader.block[begins : begins + min(PART, reader.end - reader.at)] if begins >= 0 else b""
            if len(part) < min(PART, reader.end - reader.at):
                self._read(reader, reader.log)
                if reader.wanted >= 0:
                    return
                continue
            self._part(reader, part)
            reader.at += len(part)

    def _part(self, reader: DownloadClient, part: bytes) -> None:
        filled = part.ljust(PART, b"\0")
        self._link.send(self._pack(reader.at, reader.number, len(part), *filled), reader.peer)

    def _read(self, reader: DownloadClient, log: StoredLog) -> None:
        """Read the block in which the next part is."""
        at = reader.at
        if reader.wanted == at:
            return
        reader.wanted = at

        def ready(found: object) -> None:
            if reader.wanted != at or reader.log is not log:
                return
            reader.wanted = -1
            if isinstance(found, bytes) and found:
                reader.block, reader.block_at = found, at
                if len(found) < BLOCK:  # shorter than it was: that is its end now
                    reader.end = min(reader.end, at + len(found))
            else:
                reader.log = None
                self._explain(reader.peer, f"log {reader.number} cannot be read: {found or 'it is shorter now'}")

        if not self._background.submit(lambda: read_block(log.path, at, BLOCK), ready):
            reader.wanted = -1
