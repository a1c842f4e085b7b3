"""MAVLink FTP: clients read descriptions and on-board logs, and send diagrams; each has sessions of its own.

What is not in `file_tree` does not exist. Uploads need the lease, wait in memory and are written whole when their
session ends; those that nobody goes on with make room for others. A request that comes again gets the answer that it
got. Source: MAVLink guide, "File Transfer Protocol".
"""

from __future__ import annotations

import struct
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import suppress

from twodof.errors import TwodofError
from twodof.fcu.command.result import CommandResult, Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.background import BackgroundWorker
from twodof.fcu.mavlink.files.file_tree import EXISTS, MAX_UPLOAD, FileFault, FileTree, OpenFile
from twodof.fcu.mavlink.files.ftp_client import BURST_BYTES, MOST_WAITING, Burst, FtpClient, FtpSession
from twodof.fcu.mavlink.paced_sender import PacedSender, shares
from twodof.fcu.mavlink.service import Link, Service
from twodof.link.connection import Received
from twodof.link.mavlink.ftp import MOST_DATA, FtpError, FtpOperation, FtpPacket, packed, read_packet

FTP_CAPABILITY = 32
"""MAV_PROTOCOL_CAPABILITY_FTP."""
MOST_GUESTS = 32
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

MOST_UPLOADING = 2
"""Uploads that wait in memory at once, of all clients."""

UPLOAD_S = 30.0
"""An upload of which nothing came for so long makes room for another: who sent it may be gone without a word."""

Take = Callable[[Source, str], CommandResult]
Explain = Callable[[Hashable, str], None]


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
        self._pump = PacedSender(self._send_bursts, lockstep)
        self._guests: OrderedDict[Hashable, FtpClient] = OrderedDict()
        self._armed = False
        self._turn = 0
        self._does: dict[int, Callable[[FtpClient, FtpPacket], None]] = {
            FtpOperation.NONE: lambda guest, asked: self._answer(guest, asked, asked.ack()),
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
        """Takes a request."""
        if received.message.get_type() != "FILE_TRANSFER_PROTOCOL":
            return False
        if self._us.addressed(received.message, everybody=True):
            asked = read_packet(bytes(received.message.payload))
            if asked.op not in (FtpOperation.ACK, FtpOperation.NAK):
                self._take_in(self._guest(received), asked)
        return True

    def after(self, step: ControlStep) -> None:
        """Hands over what was read and goes on with bursts."""
        self._armed = step.armed
        self._background.poll()
        self._pump.tick()

    def gone(self, peer: Hashable) -> None:
        """Forgets the sessions of a peer whose link has closed."""
        for key in [key for key, guest in self._guests.items() if guest.peer == peer]:
            self._dismiss(self._guests.pop(key))

    @property
    def sessions(self) -> int:
        """Sessions that are open, of all clients."""
        return sum(len(guest.sessions) for guest in self._guests.values())

    @property
    def _uploads(self) -> int:
        return sum(one.file is None for guest in self._guests.values() for one in guest.sessions.values())

    def _guest(self, received: Received) -> FtpClient:
        key = (received.peer, source(received))
        guest = self._guests.get(key)
        if guest is None:
            guest = self._guests[key] = FtpClient(received.peer, source(received))
            if len(self._guests) > MOST_GUESTS:
                self._dismiss(self._guests.popitem(last=False)[1])
        else:
            self._guests.move_to_end(key)
        return guest

    def _take_in(self, guest: FtpClient, asked: FtpPacket) -> None:
        if guest.busy:
            if len(guest.waiting) < MOST_WAITING and asked != guest.asked and asked not in guest.waiting:
                guest.waiting.append(asked)
            return
        if asked == guest.asked and asked.op in _ONCE:  # its answer got lost
            if guest.answer is not None:
                self._send(guest, guest.answer)
            return
        guest.asked, guest.answer = asked, None
        does = self._does.get(asked.op)
        if asked.size > MOST_DATA:
            self._answer(guest, asked, asked.nak(FtpError.DATA_SIZE))
        elif does is not None:
            does(guest, asked)
        else:
            known = asked.op in (
                FtpOperation.CREATE_FOLDER,
                FtpOperation.REMOVE_FOLDER,
                FtpOperation.OPEN_WO,
                FtpOperation.TRUNCATE,
                FtpOperation.RENAME,
            )
            self._answer(guest, asked, asked.nak(FtpError.PROTECTED if known else FtpError.UNKNOWN))

    def _list(self, guest: FtpClient, asked: FtpPacket) -> None:
        def listed(entries: list[tuple[str, int | None]]) -> FtpPacket:
            data = b""
            for name, size in entries[asked.offset :]:
                line = (f"D{name}" if size is None else f"F{name}\t{size}").encode() + b"\0"
                if len(data) + len(line) > MOST_DATA:
                    break
                data += line
            return asked.ack(data) if data else asked.nak(FtpError.END)

        self._later(guest, asked, lambda: listed([*self.tree.entries(asked.text)]))

    def _open(self, guest: FtpClient, asked: FtpPacket) -> None:
        def opened(found: object) -> FtpPacket:
            if not isinstance(found, OpenFile):
                return self._refused(asked, found)
            number = guest.open(FtpSession(found), asked.session, self._close)
            if number is None:
                self._close(found)
                return asked.nak(FtpError.NO_SESSIONS)
            return asked.ack(struct.pack("<I", found.size), session=number)

        self._work(guest, asked, lambda: self.tree.open(asked.text), opened)

    def _read(self, guest: FtpClient, asked: FtpPacket) -> None:
        session = guest.sessions.get(asked.session)
        if session is None or session.file is None:
            self._answer(guest, asked, asked.nak(FtpError.SESSION))
            return
        file, most = session.file, asked.size or MOST_DATA

        def read() -> FtpPacket:
            data = file.read(asked.offset, most)
            return asked.ack(data) if data else asked.nak(FtpError.END)

        self._later(guest, asked, read)

    def _burst(self, guest: FtpClient, asked: FtpPacket) -> None:
        session = guest.sessions.get(asked.session)
        if session is None or session.file is None:
            self._answer(guest, asked, asked.nak(FtpError.SESSION))
            return
        file, most = session.file, asked.size or MOST_DATA
        count = BURST_BYTES // most * most

        def ready(data: object) -> FtpPacket | None:
            if not isinstance(data, bytes):
                return self._refused(asked, data)
            guest.burst = Burst(asked, data, most, ends=asked.offset + len(data) >= file.size)
            self._pump.start()
            return None

        self._work(guest, asked, lambda: file.read(asked.offset, count), ready)

    def _create(self, guest: FtpClient, asked: FtpPacket) -> None:
        if not self._may_write(guest, asked):
            return

        def created(found: object) -> FtpPacket:
            if isinstance(found, Exception):
                return self._refused(asked, found)
            self._forget_abandoned()
            if self._uploads >= MOST_UPLOADING:
                return asked.nak(FtpError.NO_SESSIONS)
            number = guest.open(FtpSession(None, asked.text, self._clock()), asked.session, self._close)
            return asked.nak(FtpError.NO_SESSIONS) if number is None else asked.ack(session=number)

        self._work(guest, asked, lambda: self.tree.check_upload(asked.text), created)

    def _write(self, guest: FtpClient, asked: FtpPacket) -> None:
        session = guest.sessions.get(asked.session)
        if session is None or session.file is not None:
            answer = asked.nak(FtpError.SESSION)
        elif asked.offset > len(session.upload) or asked.offset + asked.size > MAX_UPLOAD:
            answer = asked.nak(FtpError.FAIL)
            session.failed = True
        else:
            session.used = self._clock()
            session.upload[asked.offset : asked.offset + asked.size] = asked.data[: asked.size]
            answer = asked.ack()
        self._answer(guest, asked, answer)

    def _terminate(self, guest: FtpClient, asked: FtpPacket) -> None:
        session = guest.sessions.pop(asked.session, None)
        if guest.burst is not None and guest.burst.asked.session == asked.session:
            guest.burst = None
        if session is None:
            self._answer(guest, asked, asked.nak(FtpError.SESSION))
        elif session.file is not None:
            self._close(session.file)
            self._answer(guest, asked, asked.ack())
        elif session.failed:
            self._answer(guest, asked, asked.nak(FtpError.FAIL))
        elif self._may_write(guest, asked):
            path, content = session.path, bytes(session.upload)

            def written() -> FtpPacket:
                self.tree.upload(path, content)
                return asked.ack()

            self._later(guest, asked, written)

    def _reset(self, guest: FtpClient, asked: FtpPacket) -> None:
        self._dismiss(guest)
        self._answer(guest, asked, asked.ack())

    def _remove(self, guest: FtpClient, asked: FtpPacket) -> None:
        if not self._may_write(guest, asked):
            return

        def removed() -> FtpPacket:
            self.tree.remove(asked.text)
            return asked.ack()

        self._later(guest, asked, removed)

    def _checksum(self, guest: FtpClient, asked: FtpPacket) -> None:
        self._later(guest, asked, lambda: asked.ack(struct.pack("<I", self.tree.checksum(asked.text))))

    def _may_write(self, guest: FtpClient, asked: FtpPacket) -> bool:
        """Whether the client has the lease, or gets it; else it is told."""
        verdict = self._take(guest.source, "upload")
        if not verdict.accepted:
            self._answer(guest, asked, asked.nak(FtpError.PROTECTED))
            self._explain(guest.peer, verdict.text)
        return verdict.accepted

    def _later(self, guest: FtpClient, asked: FtpPacket, work: Callable[[], FtpPacket]) -> None:
        """Answers with what `work` gives, done in the background."""
        self._work(guest, asked, work, lambda made: made if isinstance(made, FtpPacket) else self._refused(asked, made))

    def _work(
        self,
        guest: FtpClient,
        asked: FtpPacket,
        work: Callable[[], object],
        answer: Callable[[object], FtpPacket | None],
    ) -> None:
        def done(result: object) -> None:
            guest.busy = False
            made = answer(result)
            if made is not None:
                self._answer(guest, asked, made)
            while guest.waiting and not guest.busy:
                self._take_in(guest, guest.waiting.popleft())

        guest.busy = True
        if not self._background.submit(work, done):
            guest.busy, guest.asked = False, None  # too much waits: it may ask again
            guest.waiting.clear()

    def _refused(self, asked: FtpPacket, fault: object) -> FtpPacket:
        if isinstance(fault, FileFault):
            return asked.nak(fault.code if fault.code != EXISTS else FtpError.EXISTS)
        if isinstance(fault, OSError):
            return asked.nak(FtpError.ERRNO, fault.errno or 0)
        return asked.nak(FtpError.FAIL)

    def _answer(self, guest: FtpClient, asked: FtpPacket, answer: FtpPacket) -> None:
        if guest.asked == asked:
            guest.answer = answer
        self._send(guest, answer)

    def _send(self, guest: FtpClient, packet: FtpPacket) -> None:
        self._link.send(packed(packet, *guest.source), guest.peer)

    def _send_bursts(self) -> bool:
        most = A_TICK_ARMED if self._armed else A_TICK
        bursting = [guest for guest in self._guests.values() if guest.burst is not None]
        self._turn += most
        for guest, share in shares(most, bursting, self._turn):
            burst = guest.burst
            if burst is not None:
                for packet in burst.next(share):
                    self._send(guest, packet)
                if burst.done and guest.burst is burst:
                    guest.burst = None
        return any(guest.burst is not None for guest in bursting)

    def _forget_abandoned(self) -> None:
        """Ends the uploads that are not gone on with; only who uploads waits for room, so this is looked at then."""
        since = self._clock() - UPLOAD_S
        for guest in self._guests.values():
            for number in [n for n, one in guest.sessions.items() if one.file is None and one.used < since]:
                del guest.sessions[number]

    def _dismiss(self, guest: FtpClient) -> None:
        guest.burst = None
        for session in guest.sessions.values():
            if session.file is not None:
                self._close(session.file)
        guest.sessions.clear()

    def _close(self, file: OpenFile) -> None:
        # In order with what is still being read of it.
        if not self._background.submit(file.close, _ignore):
            with suppress(OSError, TwodofError):
                file.close()


def _ignore(_result: object) -> None:
    """Nobody waits for it."""
