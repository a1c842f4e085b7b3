"""Logs over the wire: download of stored logs, and the on-board log as it is written.

Download (LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END, LOG_ERASE) serves each client by itself. A client's list
is numbered from 0 as in PX4. It is valid until the client requests another, so that no number moves when a log is
written or deleted. A log that is being written keeps its size in the list. The client requests lost parts again.
Another thread reads the file, which is sent in portions.

A stream lasts from MAV_CMD_LOGGING_START (2510) until MAV_CMD_LOGGING_STOP (2511). The head of the log comes in
LOGGING_DATA_ACKED, one at a time, repeated until LOGGING_ACK comes; the records come in LOGGING_DATA, once. Each says
where its first log message begins, so that a client that lost one can go on reading. One client at a time gets a log
that begins with its request, for as long as the client is heard.

Sources: the dialect of these messages; PX4, mavlink_ulog.cpp.
"""

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from functools import partial
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

from twodof.errors import TwodofError
from twodof.fcu.command.command_lease import DONE, CommandResult, Source, denied, rejected
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, Steps, read_block
from twodof.fcu.mavlink.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.service import Service, Vehicle, source, target, whole
from twodof.fcu.onboard_log.log_writer import StoredLog
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.flightlog.ulog_writer import MOST, ULogFragments
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import MavCmd
from twodof.link.mavlink.messages import Packer, message

PART = 90
"""Bytes in a LOG_DATA."""
READ_BYTES = 512 * PART
"""Bytes that are read from the disk at once."""
MOST_READERS = 16
ENTRIES_A_TICK, ENTRIES_A_TICK_ARMED = 32, 4
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
        self._log, self._armed = log, False
        self._background = BackgroundWorker(inline=vehicle.lockstep)
        self._sender = PacedSender(lambda peer, sent: vehicle.send(sent, peer), vehicle.lockstep, ENTRIES_A_TICK)
        self._lists: OrderedDict[Hashable, list[StoredLog]] = OrderedDict()
        self._entries: dict[Hashable, Iterator[Any]] = {}
        self._data: dict[Hashable, Iterator[Any]] = {}
        self._pack = Packer("LOG_DATA")

    def after(self, step: ControlStep) -> None:
        self._armed = step.armed
        self._sender.most = ENTRIES_A_TICK_ARMED if step.armed else ENTRIES_A_TICK
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
            while not self._background.submit(partial(read_block, log.path, at, READ_BYTES), found.append):
                yield None
            while not found:
                yield None
            block = found[0]
            if not isinstance(block, bytes) or not block:
                self._vehicle.explain(peer, f"log {number} cannot be read: {block or 'it is shorter now'}")
                return
            if len(block) < READ_BYTES:  # shorter than it was: that is its end now
                end = min(end, at + len(block))
            for part in (block[begins : begins + PART] for begins in range(0, min(len(block), end - at), PART)):
                part = part[: end - at]
                yield self._pack(at, number, len(part), *part.ljust(PART, b"\0"))
                at += len(part)
        if tail:
            yield self._pack(at, number, 0, *bytes(PART))

    def _erase(self, received: Received) -> Steps:
        if self._armed:
            self._vehicle.explain(received.peer, "no log is erased while armed: disarm first")
            return
        taken = self._vehicle.take(source(received), "logs")
        if not taken.accepted:
            self._vehicle.explain(received.peer, taken.text)
            return
        try:
            yield self._log.erase
        finally:
            for reader in [*self._lists]:
                self.gone(reader)


ULOG = 0
A_TICK = 8
"""Most LOGGING_DATA in a control period: .5 MB/s, while the log grows by .2 MB/s."""
AGAIN_PORTIONS, MOST_AGAIN = 25, 50
"""Portions (100 ms) to wait for an answer before a repetition, and most repetitions."""
BLOCK = 1 << 16
SILENT_PORTIONS = 2500
"""Portions without a frame of the client after which it counts as gone: 10 s, in lockstep 5 s."""
LOOK_PORTIONS = 12
"""Portions between looks for more of the file, 50 ms."""


class LogStreamClient:
    """A client that gets the log after the log `before`."""

    def __init__(self, peer: Hashable, client: Source, before: Path | None) -> None:
        self.peer, self.client, self.before = peer, client, before
        self.sequence = 0
        self.answered = False
        self.silent = 0  # portions since it was heard


class LogStreamService(Service):
    """Service that streams the log of `log` to the client that requested it.

    The request needs the lease: it ends the log that is being written, and a new log may push out the oldest.
    """

    def __init__(self, vehicle: Vehicle, commands: CommandService, log: OnboardLogger) -> None:
        super().__init__(vehicle, {"LOGGING_ACK": self._answered})
        self._log = log
        self._background = BackgroundWorker(inline=vehicle.lockstep)
        self._sender = PacedSender(lambda peer, sent: vehicle.send(sent, peer), vehicle.lockstep, A_TICK + 1)
        self._stream: LogStreamClient | None = None
        commands.on(MavCmd.LOGGING_START, self._start)
        commands.on(MavCmd.LOGGING_STOP, self._stop)

    def handle(self, received: Received) -> bool:
        """Note that the client is alive; consume its answer."""
        if self._stream is not None and source(received) == self._stream.client:
            self._stream.silent = 0
        return super().handle(received)

    def _answered(self, received: Received) -> None:
        stream = self._stream
        if stream is not None and source(received) == stream.client and received.message.sequence == stream.sequence:
            stream.answered = True

    def after(self, step: ControlStep) -> None:
        self._background.poll()
        self._sender.tick()

    def gone(self, peer: Hashable) -> None:
        if self._stream is not None and self._stream.peer == peer:
            self._end()

    def _start(self, command: ReceivedCommand) -> CommandResult:
        if whole(command.params[0], -1) != ULOG:
            return denied("logs are streamed as ULog: format 0")
        stream = self._stream
        if stream is not None and stream.client != command.source:
            return rejected(f"the log is streamed to {stream.client[0]}/{stream.client[1]} already")
        taken = self._vehicle.take(command.source, "log stream")
        if not taken.accepted:
            return taken
        if stream is not None:
            self._sender.stop(stream.peer)
        self._stream = stream = LogStreamClient(command.peer, command.source, self._log.path)
        self._log.start_new_log()
        self._log.start()
        self._sender.start(stream.peer, self._messages(stream))
        return DONE

    def _stop(self, command: ReceivedCommand) -> CommandResult:
        if self._stream is not None and self._stream.client == command.source:
            self._end()
        return DONE

    def _end(self, why: str = "") -> None:
        stream, self._stream = self._stream, None
        self._log.stop()
        if stream is not None:
            self._sender.stop(stream.peer)
            if why:
                self._vehicle.explain(stream.peer, why)

    def _messages(self, stream: LogStreamClient) -> Iterator[Any]:
        """Yield the messages of a stream, None at the end of each portion, until it is given up."""
        pieces = ULogFragments()
        ready, reading = self._ready(stream, pieces), self._read(stream, pieces)
        for portion in count(1):
            stream.silent += 1
            if stream.silent > SILENT_PORTIONS:
                self._end("the log is not streamed any more: who asked for it is silent")
                return
            if portion % LOOK_PORTIONS == 0:
                next(reading)
            for sent in islice(ready, A_TICK):
                if sent is None:
                    break
                yield sent
            yield None

    def _ready(self, stream: LogStreamClient, pieces: ULogFragments) -> Iterator[Any]:
        """Yield the messages of `pieces`, None while there is none or an answer is waited for."""
        while True:
            piece = pieces.next()
            if piece is None:
                yield None
                continue
            stream.answered = False
            name = "LOGGING_DATA_ACKED" if piece.described else "LOGGING_DATA"
            part = {"first_message_offset": piece.first, "length": len(piece.data), "data": piece.data}
            sent = message(name, sequence=stream.sequence, **part, **target(stream.client))
            yield sent
            for waited in range(AGAIN_PORTIONS * (MOST_AGAIN + 1) if piece.described else 0):
                if stream.answered:
                    break
                yield sent if waited and waited % AGAIN_PORTIONS == 0 else None
            if piece.described and not stream.answered:
                self._end("the log is not streamed any more: no LOGGING_ACK came")
                return
            stream.sequence = (stream.sequence + 1) & 0xFFFF

    def _read(self, stream: LogStreamClient, pieces: ULogFragments) -> Iterator[None]:
        """Read more of the file at each look; the stream ends where the log goes on in another file."""
        while (path := self._log.path) is None or path == stream.before:
            yield
        read = 0
        while True:
            over, found = self._log.path != path, list[object]()
            full = pieces.waiting > BLOCK
            if not full and self._background.submit(partial(read_block, path, read, BLOCK), found.append):
                while not found:
                    yield
                if isinstance(found[0], bytes):
                    read += len(found[0])
                    pieces.feed(found[0])
                if over and not found[0] and pieces.waiting < MOST:
                    self._end("the log that was streamed has ended")
            yield
