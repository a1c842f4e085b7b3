"""MAVLink FTP: clients read descriptions of parameters, and send diagrams; each has sessions of its own.

Only the files of `file_tree` exist. Uploads need the lease, wait in memory and are written whole when their session
ends; abandoned ones make room for others. A repeated request gets the same answer. Source: MAVLink guide, "File
Transfer Protocol".
"""

import struct
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Generator, Hashable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from twodof.errors import LinkError, TwodofError
from twodof.fcu.command.command_lease import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, Steps, Work
from twodof.fcu.mavlink.file_tree import MAX_UPLOAD, FileFault, FileTree, OpenFile
from twodof.fcu.mavlink.service import Service, Vehicle, source
from twodof.link.connection import Received
from twodof.link.mavlink.ftp import MOST_DATA, FtpError, FtpOperation, FtpPacket, packed, read_packet

MOST_SESSIONS = 4
"""Most sessions of one client; one more closes the one that was opened first and is no upload."""
MOST_WAITING = 16
"""Most requests of one client that wait; further ones are dropped, and the client repeats them."""
BURST_BYTES = 35_000
"""Most bytes that answer one burst request, as in PX4."""


@dataclass(slots=True)
class FtpSession:
    """A file being read, or an upload to `path` that waits in memory; `used` is the time of its last request [s].

    `failed`: a write was refused, so that the upload is incomplete.
    """

    file: OpenFile | None
    path: str = ""
    used: float = 0.0
    upload: bytearray = field(default_factory=bytearray)
    failed: bool = False


def burst_packets(request: FtpPacket, data: bytes, most: int, ends: bool) -> Iterator[FtpPacket]:
    """Yield the answer to a burst: `data` in packets of `most` bytes, then, if the file `ends` there, its end.

    Each packet is made when it is sent: 35,000 packets of one byte, which a client may request, take many control
    periods.
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
    """A client of the server, by peer and sender. While a request is carried out (`busy`) its next ones wait.

    `bursts` is the session whose burst is sent, -1: none. `request` and `answer` are the last ones.
    """

    key: tuple[Hashable, Source]
    sessions: dict[int, FtpSession] = field(default_factory=dict)
    bursts: int = -1
    request: FtpPacket | None = None
    answer: FtpPacket | None = None
    busy: bool = False
    waiting: deque[FtpPacket] = field(default_factory=deque)

    def file(self, request: FtpPacket) -> OpenFile:
        """Return the file that the session of a request reads. Raises FileFault."""
        session = self.sessions.get(request.session)
        if session is None or session.file is None:
            raise FileFault(FtpError.SESSION)
        return session.file

    def upload(self, request: FtpPacket) -> FtpSession:
        """Return the session of a request, if it is an upload. Raises FileFault otherwise."""
        session = self.sessions.get(request.session)
        if session is None or session.file is not None:
            raise FileFault(FtpError.SESSION)
        return session

    def open(self, session: FtpSession, wanted: int) -> int:
        """Open a session and return its number: `wanted` if that is free. Raises FileFault if all are uploads."""
        if len(self.sessions) >= MOST_SESSIONS:
            oldest = next((number for number, one in self.sessions.items() if one.file is not None), None)
            if oldest is None:
                raise FileFault(FtpError.NO_SESSIONS)
            del self.sessions[oldest]
        number = wanted if wanted not in self.sessions else min({*range(256)} - self.sessions.keys())
        self.sessions[number] = session
        return number


MOST_CLIENTS = 32
A_TICK, A_TICK_ARMED = 16, 2
"""Packets of bursts sent in a control period, to all clients together: .9 MB/s, and few while armed."""

_READING = (FtpOperation.NONE, FtpOperation.LIST, FtpOperation.READ, FtpOperation.BURST, FtpOperation.CRC32)
"""Operations that are carried out again when they are repeated; others get the same answer again."""

_REFUSED = (
    *(FtpOperation.CREATE_FOLDER, FtpOperation.REMOVE_FOLDER),
    *(FtpOperation.OPEN_WO, FtpOperation.TRUNCATE, FtpOperation.RENAME),
)

MOST_UPLOADING = 2
"""Uploads that wait in memory at once, of all clients."""

UPLOAD_S = 30.0
"""Time without a request after which an upload counts as abandoned and makes room for another [s]."""

Answer = FtpPacket | Iterator[FtpPacket]
"""An answer, or a burst."""
Answering = Generator[Work, Any, Answer]
"""Steps to an answer: disks are accessed in the background."""


class FileTransfer(Service):
    """Server of MAVLink FTP for the files of `tree`; writing needs the lease."""

    def __init__(self, vehicle: Vehicle, tree: FileTree, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(vehicle, {"FILE_TRANSFER_PROTOCOL": self._receive}, everybody=True)
        self.tree = tree
        self._clock = clock
        self._background = BackgroundWorker(inline=vehicle.lockstep)
        self._bursts = PacedSender(self._send, vehicle.lockstep, A_TICK)
        self.send_bursts = self._bursts.portion
        self._clients: OrderedDict[tuple[Hashable, Source], FtpClient] = OrderedDict()
        self._does: dict[int, Callable[[FtpClient, FtpPacket], FtpPacket | Answering]] = {
            FtpOperation.NONE: lambda _, request: request.ack(),
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

    def _receive(self, received: Received) -> None:
        request = read_packet(bytes(received.message.payload))
        if request.op not in (FtpOperation.ACK, FtpOperation.NAK):
            self._take_in(self._client(received), request)

    def after(self, step: ControlStep) -> None:
        self._bursts.most = A_TICK_ARMED if step.armed else A_TICK
        self._background.poll()
        self._bursts.tick()

    def gone(self, peer: Hashable) -> None:
        for key in [key for key in self._clients if key[0] == peer]:
            self._dismiss(self._clients.pop(key))

    @property
    def sessions(self) -> int:
        """Return the number of open sessions of all clients."""
        return sum(len(client.sessions) for client in self._clients.values())

    def _client(self, received: Received) -> FtpClient:
        key = (received.peer, source(received))
        if key not in self._clients:
            self._clients[key] = FtpClient(key)
            if len(self._clients) > MOST_CLIENTS:
                self._dismiss(self._clients.popitem(last=False)[1])
        self._clients.move_to_end(key)
        return self._clients[key]

    def _take_in(self, client: FtpClient, request: FtpPacket) -> None:
        if client.busy:
            if len(client.waiting) < MOST_WAITING and request != client.request and request not in client.waiting:
                client.waiting.append(request)
            return
        if request == client.request and request.op not in _READING and client.answer is not None:  # it got lost
            self._send(client.key, client.answer)
            return
        client.request, client.answer, client.busy = request, None, True
        self._background.carry_out(self._carry_out(client, request))

    def _carry_out(self, client: FtpClient, request: FtpPacket) -> Steps:
        """Answer a request, and begin the next one that waits."""
        try:
            found = self._handler(request)(client, request)
            answer: Answer = found if isinstance(found, FtpPacket) else (yield from found)
        except FileFault as fault:
            answer = request.nak(fault.code)
        except OSError as error:
            answer = request.nak(FtpError.ERRNO, error.errno or 0)
        except LinkError:  # too much waits: it may ask again
            client.busy, client.request = False, None
            client.waiting.clear()
            return
        except TwodofError:
            answer = request.nak(FtpError.FAIL)
        client.busy = False
        self._answer(client, request, answer)
        while client.waiting and not client.busy:
            self._take_in(client, client.waiting.popleft())

    def _handler(self, request: FtpPacket) -> Callable[[FtpClient, FtpPacket], FtpPacket | Answering]:
        if request.size > MOST_DATA:
            raise FileFault(FtpError.DATA_SIZE)
        if request.op not in self._does:
            raise FileFault(FtpError.PROTECTED if request.op in _REFUSED else FtpError.UNKNOWN)
        return self._does[request.op]

    def _answer(self, client: FtpClient, request: FtpPacket, answer: Answer) -> None:
        if isinstance(answer, FtpPacket):
            client.answer = answer
            self._send(client.key, answer)
        elif client.key in self._clients:
            client.bursts = request.session
            self._bursts.start(client.key, answer)

    def _send(self, key: tuple[Hashable, Source], packet: FtpPacket) -> None:
        self._vehicle.send(packed(packet, *key[1]), key[0])

    def _list(self, _: FtpClient, request: FtpPacket) -> Answering:
        data = b""
        for name, size in (yield partial(self.tree.entries, request.text))[request.offset :]:
            line = (f"D{name}" if size is None else f"F{name}\t{size}").encode() + b"\0"
            if len(data) + len(line) > MOST_DATA:
                break
            data += line
        return request.ack(data) if data else request.nak(FtpError.END)

    def _open(self, client: FtpClient, request: FtpPacket) -> Answering:
        file = yield partial(self.tree.open, request.text)
        number = client.open(FtpSession(file), request.session)
        return request.ack(struct.pack("<I", file.size), session=number)

    def _checksum(self, _: FtpClient, request: FtpPacket) -> Answering:
        return request.ack(struct.pack("<I", (yield partial(self.tree.checksum, request.text))))

    def _read(self, client: FtpClient, request: FtpPacket) -> Answering:
        data = yield partial(client.file(request).read, request.offset, request.size or MOST_DATA)
        return request.ack(data) if data else request.nak(FtpError.END)

    def _burst(self, client: FtpClient, request: FtpPacket) -> Answering:
        file, most = client.file(request), request.size or MOST_DATA
        data = yield partial(file.read, request.offset, BURST_BYTES // most * most)
        return burst_packets(request, data, most, ends=request.offset + len(data) >= file.size)

    def _create(self, client: FtpClient, request: FtpPacket) -> Answering:
        self._check_lease(client)
        yield partial(self.tree.target, request.text)
        self._make_room_for_upload()
        return request.ack(session=client.open(FtpSession(None, request.text, self._clock()), request.session))

    def _write(self, client: FtpClient, request: FtpPacket) -> FtpPacket:
        session = client.upload(request)
        if request.offset > len(session.upload) or request.offset + request.size > MAX_UPLOAD:
            session.failed = True
            raise FileFault(FtpError.FAIL)
        session.used = self._clock()
        session.upload[request.offset : request.offset + request.size] = request.data[: request.size]
        return request.ack()

    def _terminate(self, client: FtpClient, request: FtpPacket) -> Answering:
        if client.bursts == request.session:
            self._bursts.stop(client.key)
        session = client.sessions.pop(request.session, None)
        if session is None or session.failed:
            raise FileFault(FtpError.SESSION if session is None else FtpError.FAIL)
        if session.file is None:
            self._check_lease(client)
            yield partial(self.tree.upload, session.path, bytes(session.upload))
        return request.ack()

    def _reset(self, client: FtpClient, request: FtpPacket) -> FtpPacket:
        self._dismiss(client)
        return request.ack()

    def _remove(self, client: FtpClient, request: FtpPacket) -> Answering:
        self._check_lease(client)
        yield partial(self.tree.remove, request.text)
        return request.ack()

    def _check_lease(self, client: FtpClient) -> None:
        """Take the lease for the client. If another client has it, tell the client and raise FileFault."""
        peer, sender = client.key
        taken = self._vehicle.take(sender, "upload")
        if not taken.accepted:
            self._vehicle.explain(peer, taken.text)
            raise FileFault(FtpError.PROTECTED)

    def _make_room_for_upload(self) -> None:
        """End abandoned uploads. Raises FileFault if no other may wait."""
        since, waiting = self._clock() - UPLOAD_S, 0
        for client in self._clients.values():
            for number in [n for n, one in client.sessions.items() if one.file is None and one.used < since]:
                del client.sessions[number]
            waiting += sum(one.file is None for one in client.sessions.values())
        if waiting >= MOST_UPLOADING:
            raise FileFault(FtpError.NO_SESSIONS)

    def _dismiss(self, client: FtpClient) -> None:
        self._bursts.stop(client.key)
        client.sessions.clear()
