"""MAVLink FTP: clients read descriptions of parameters, and send diagrams; each has sessions of its own.

What is not in `file_tree` does not exist. Uploads need the lease, wait in memory and are written whole when their
session ends; those that nobody goes on with make room for others. A request that comes again gets the answer that it
got. Source: MAVLink guide, "File Transfer Protocol".
"""

import struct
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from itertools import islice

from twodof.fcu.command.command_lease import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, shares
from twodof.fcu.mavlink.file_tree import MAX_UPLOAD, FileFault, FileTree, OpenFile
from twodof.fcu.mavlink.service import Explain, Link, Service, Take, VehicleAddress, source
from twodof.link.connection import Received
from twodof.link.mavlink.ftp import MOST_DATA, FtpError, FtpOperation, FtpPacket, packed, read_packet

MOST_SESSIONS = 4
"""Sessions of one client; a fifth closes the one that was opened first, but no upload."""
MOST_WAITING = 16
"""Requests of one client that wait; what comes beyond is for it to ask again."""
BURST_BYTES = 35_000
"""Most that answers one burst request, as in PX4."""


@dataclass(slots=True)
class FtpSession:
    """A file being read, or an upload to `path` that waits in memory; `used`, by the clock, when it last was.

    `failed`: a write was refused, so that the upload is incomplete.
    """

    file: OpenFile | None
    path: str = ""
    used: float = 0.0
    upload: bytearray = field(default_factory=bytearray)
    failed: bool = False


def burst_packets(request: FtpPacket, data: bytes, most: int, ends: bool) -> Iterator[FtpPacket]:
    """Yield the answer to a burst: `data` in packets of `most` bytes, then, if the file `ends` there, its end.

    Each is made when it is sent: a client may ask for 35,000 packets of one byte, which takes many control periods.
    """
    places = range(0, len(data), most)
    for number, at in enumerate(places):
        last = not ends and at + most >= len(data)
        yield request.part(number, request.offset + at, data[at : at + most], last)
    if ends or not data:
        sequence = (request.sequence + 1 + len(places)) & 0xFFFF
        yield request.nak(FtpError.END)._replace(sequence=sequence, offset=request.offset + len(data))


@dataclass(slots=True)
class FtpClient:
    """A client of the server, at `peer`. What it asks while it is `busy` waits: requests are carried out in order.

    `burst` is what is still to be sent of a burst from the session `burst_session`, None: there is none.
    """

    peer: Hashable
    source: Source
    sessions: dict[int, FtpSession] = field(default_factory=dict)
    burst: Iterator[FtpPacket] | None = None
    burst_session: int = 0
    request: FtpPacket | None = None
    answer: FtpPacket | None = None
    busy: bool = False
    waiting: deque[FtpPacket] = field(default_factory=deque)

    def open(self, session: FtpSession, wanted: int) -> int | None:
        """Open a session, with the number `wanted` if that is free; None if only uploads are open already."""
        if len(self.sessions) >= MOST_SESSIONS:
            for number, oldest in self.sessions.items():
                if oldest.file is not None:
                    del self.sessions[number]
                    break
            else:
                return None
        number = wanted if wanted not in self.sessions else min({*range(256)} - self.sessions.keys())
        self.sessions[number] = session
        return number


MOST_CLIENTS = 32
A_TICK, A_TICK_ARMED = 16, 2
"""Packets of bursts that are sent in a control period, to all clients: .9 MB/s, and little while it flies."""

_ONCE = (
    FtpOperation.OPEN_RO,
    FtpOperation.CREATE,
    FtpOperation.WRITE,
    FtpOperation.TERMINATE,
    FtpOperation.RESET,
    FtpOperation.REMOVE,
)
"""Not carried out again when they come again; what only reads is."""

_REFUSED = (
    FtpOperation.CREATE_FOLDER,
    FtpOperation.REMOVE_FOLDER,
    FtpOperation.OPEN_WO,
    FtpOperation.TRUNCATE,
    FtpOperation.RENAME,
)

MOST_UPLOADING = 2
"""Uploads that wait in memory at once, of all clients."""

UPLOAD_S = 30.0
"""An upload of which nothing came for so long makes room for another: who sent it may be gone without a word."""


class FileTransfer(Service):
    """The server of MAVLink FTP over `tree`; `take` says whether a source may command, `explain` tells why not."""

    def __init__(
        self,
        link: Link,
        us: VehicleAddress,
        tree: FileTree,
        take: Take,
        explain: Explain,
        lockstep: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.tree = tree
        self._clock = clock
        self._link, self._us, self._take, self._explain = link, us, take, explain
        self._background = BackgroundWorker(inline=lockstep)
        self._pump = PacedSender(self.send_bursts, lockstep)
        self._clients: OrderedDict[Hashable, FtpClient] = OrderedDict()
        self._armed = False
        self._turn = 0
        self._does: dict[int, Callable[[FtpClient, FtpPacket], None]] = {
            FtpOperation.NONE: lambda client, request: self._answer(client, request, request.ack()),
            FtpOperation.TERMINATE: self._terminate,
            FtpOperation.RESET: self._reset,
            FtpOperation.LIST: self._list,
            FtpOperation.OPEN_RO: self._open,
            FtpOperation.READ: self._read,
            FtpOperation.CREATE: self._create,
            FtpOperation.WRITE: self._write,
            FtpOperation.REMOVE: self._remove,
            FtpOperation.CRC32: self._checksum,
            FtpOperation.BURST: self._burst,
        }

    def handle(self, received: Received) -> bool:
        """Take a request."""
        if received.message.get_type() != "FILE_TRANSFER_PROTOCOL":
            return False
        if self._us.addressed(received.message, everybody=True):
            request = read_packet(bytes(received.message.payload))
            if request.op not in (FtpOperation.ACK, FtpOperation.NAK):
                self._take_in(self._client(received), request)
        return True

    def after(self, step: ControlStep) -> None:
        self._armed = step.armed
        self._background.poll()
        self._pump.tick()

    def gone(self, peer: Hashable) -> None:
        for key in [key for key, client in self._clients.items() if client.peer == peer]:
            self._dismiss(self._clients.pop(key))

    @property
    def sessions(self) -> int:
        """Return the number of open sessions of all clients."""
        return sum(len(client.sessions) for client in self._clients.values())

    def _client(self, received: Received) -> FtpClient:
        key = (received.peer, source(received))
        if key not in self._clients:
            self._clients[key] = FtpClient(*key)
            if len(self._clients) > MOST_CLIENTS:
                self._dismiss(self._clients.popitem(last=False)[1])
        self._clients.move_to_end(key)
        return self._clients[key]

    def _take_in(self, client: FtpClient, request: FtpPacket) -> None:
        if client.busy:
            if len(client.waiting) < MOST_WAITING and request != client.request and request not in client.waiting:
                client.waiting.append(request)
            return
        if request == client.request and request.op in _ONCE:  # its answer got lost
            if client.answer is not None:
                self._send(client, client.answer)
            return
        client.request, client.answer = request, None
        does = self._does.get(request.op)
        if request.size > MOST_DATA:
            self._answer(client, request, request.nak(FtpError.DATA_SIZE))
        elif does is not None:
            does(client, request)
        else:
            self._answer(
                client, request, request.nak(FtpError.PROTECTED if request.op in _REFUSED else FtpError.UNKNOWN)
            )

    def _list(self, client: FtpClient, request: FtpPacket) -> None:
        def listed() -> FtpPacket:
            data = b""
            for name, size in self.tree.entries(request.text)[request.offset :]:
                line = (f"D{name}" if size is None else f"F{name}\t{size}").encode() + b"\0"
                if len(data) + len(line) > MOST_DATA:
                    break
                data += line
            return request.ack(data) if data else request.nak(FtpError.END)

        self._later(client, request, listed)

    def _open(self, client: FtpClient, request: FtpPacket) -> None:
        def opened(found: object) -> FtpPacket:
            if not isinstance(found, OpenFile):
                return _refused(request, found)
            number = client.open(FtpSession(found), request.session)
            if number is None:
                return request.nak(FtpError.NO_SESSIONS)
            return request.ack(struct.pack("<I", found.size), session=number)

        self._work(client, request, lambda: self.tree.open(request.text), opened)

    def _file(self, client: FtpClient, request: FtpPacket) -> OpenFile | None:
        """Return the file that the request's session reads; without one the client is told."""
        session = client.sessions.get(request.session)
        if session is None or session.file is None:
            self._answer(client, request, request.nak(FtpError.SESSION))
            return None
        return session.file

    def _read(self, client: FtpClient, request: FtpPacket) -> None:
        file = self._file(client, request)
        if file is None:
            return

        def read() -> FtpPacket:
            data = file.read(request.offset, request.size or MOST_DATA)
            return request.ack(data) if data else request.nak(FtpError.END)

        self._later(client, request, read)

    def _burst(self, client: FtpClient, request: FtpPacket) -> None:
        file = self._file(client, request)
        if file is None:
            return
        most = request.size or MOST_DATA

        def ready(data: object) -> FtpPacket | None:
            if not isinstance(data, bytes):
                return _refused(request, data)
            client.burst = burst_packets(request, data, most, ends=request.offset + len(data) >= file.size)
            client.burst_session = request.session
            self._pump.start()
            return None

        self._work(client, request, lambda: file.read(request.offset, BURST_BYTES // most * most), ready)

    def _create(self, client: FtpClient, request: FtpPacket) -> None:
        if not self._may_write(client, request):
            return

        def created(found: object) -> FtpPacket:
            if isinstance(found, Exception):
                return _refused(request, found)
            if not self._room_for_upload():
                return request.nak(FtpError.NO_SESSIONS)
            number = client.open(FtpSession(None, request.text, self._clock()), request.session)
            return request.nak(FtpError.NO_SESSIONS) if number is None else request.ack(session=number)

        self._work(client, request, lambda: self.tree.check_upload(request.text), created)

    def _write(self, client: FtpClient, request: FtpPacket) -> None:
        session = client.sessions.get(request.session)
        if session is None or session.file is not None:
            answer = request.nak(FtpError.SESSION)
        elif request.offset > len(session.upload) or request.offset + request.size > MAX_UPLOAD:
            answer = request.nak(FtpError.FAIL)
            session.failed = True
        else:
            session.used = self._clock()
            session.upload[request.offset : request.offset + request.size] = request.data[: request.size]
            answer = request.ack()
        self._answer(client, request, answer)

    def _terminate(self, client: FtpClient, request: FtpPacket) -> None:
        session = client.sessions.pop(request.session, None)
        if client.burst_session == request.session:
            client.burst = None
        if session is None:
            self._answer(client, request, request.nak(FtpError.SESSION))
        elif session.file is not None:
            self._answer(client, request, request.ack())
        elif session.failed:
            self._answer(client, request, request.nak(FtpError.FAIL))
        elif self._may_write(client, request):
            path, content = session.path, bytes(session.upload)

            def written() -> FtpPacket:
                self.tree.upload(path, content)
                return request.ack()

            self._later(client, request, written)

    def _reset(self, client: FtpClient, request: FtpPacket) -> None:
        self._dismiss(client)
        self._answer(client, request, request.ack())

    def _remove(self, client: FtpClient, request: FtpPacket) -> None:
        def removed() -> FtpPacket:
            self.tree.remove(request.text)
            return request.ack()

        if self._may_write(client, request):
            self._later(client, request, removed)

    def _checksum(self, client: FtpClient, request: FtpPacket) -> None:
        self._later(client, request, lambda: request.ack(struct.pack("<I", self.tree.checksum(request.text))))

    def _may_write(self, client: FtpClient, request: FtpPacket) -> bool:
        """Return whether the client has the lease, or gets it; else it is told."""
        taken = self._take(client.source, "upload")
        if not taken.accepted:
            self._answer(client, request, request.nak(FtpError.PROTECTED))
            self._explain(client.peer, taken.text)
        return taken.accepted

    def _later(self, client: FtpClient, request: FtpPacket, work: Callable[[], FtpPacket]) -> None:
        """Answer with the result of `work`, done in the background."""

        def answer(made: object) -> FtpPacket:
            return made if isinstance(made, FtpPacket) else _refused(request, made)

        self._work(client, request, work, answer)

    def _work(
        self,
        client: FtpClient,
        request: FtpPacket,
        work: Callable[[], object],
        answer: Callable[[object], FtpPacket | None],
    ) -> None:
        def done(result: object) -> None:
            client.busy = False
            made = answer(result)
            if made is not None:
                self._answer(client, request, made)
            while client.waiting and not client.busy:
                self._take_in(client, client.waiting.popleft())

        client.busy = True
        if not self._background.submit(work, done):
            client.busy, client.request = False, None  # too much waits: it may ask again
            client.waiting.clear()

    def _answer(self, client: FtpClient, request: FtpPacket, answer: FtpPacket) -> None:
        if client.request == request:
            client.answer = answer
        self._send(client, answer)

    def _send(self, client: FtpClient, packet: FtpPacket) -> None:
        self._link.send(packed(packet, *client.source), client.peer)

    def send_bursts(self) -> bool:
        """Send some packets of bursts; return whether there are more. `PacedSender` calls it."""
        most = A_TICK_ARMED if self._armed else A_TICK
        bursting = [client for client in self._clients.values() if client.burst is not None]
        self._turn += most
        for client, share in shares(most, bursting, self._turn):
            packets = [*islice(client.burst or (), share)]
            for packet in packets:
                self._send(client, packet)
            if len(packets) < share:
                client.burst = None
        return any(client.burst is not None for client in bursting)

    def _room_for_upload(self) -> bool:
        """End abandoned uploads; return whether another may wait."""
        since, waiting = self._clock() - UPLOAD_S, 0
        for client in self._clients.values():
            for number in [n for n, one in client.sessions.items() if one.file is None and one.used < since]:
                del client.sessions[number]
            waiting += sum(one.file is None for one in client.sessions.values())
        return waiting < MOST_UPLOADING

    def _dismiss(self, client: FtpClient) -> None:
        client.burst = None
        client.sessions.clear()


def _refused(request: FtpPacket, fault: object) -> FtpPacket:
    if isinstance(fault, FileFault):
        return request.nak(fault.code)
    if isinstance(fault, OSError):
        return request.nak(FtpError.ERRNO, fault.errno or 0)
    return request.nak(FtpError.FAIL)
