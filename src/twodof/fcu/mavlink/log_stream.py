"""Log streaming: the on-board log as it is written, for MAV_CMD_LOGGING_START (2510) until MAV_CMD_LOGGING_STOP (2511).

The head of the log comes in LOGGING_DATA_ACKED, one at a time, repeated until LOGGING_ACK comes; the records come in
LOGGING_DATA, once. Each says where its first log message begins, so that a client that lost one can go on reading. One
client at a time gets a log that begins with its request, for as long as the client is heard. Sources: the dialect of
these messages; PX4, mavlink_ulog.cpp.
"""

from collections.abc import Hashable, Iterator
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any

from twodof.fcu.command.command_lease import DONE, CommandResult, Source, denied, rejected
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, read_block
from twodof.fcu.mavlink.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.service import Service, Vehicle, source, target, whole
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.flightlog.ulog_writer import MOST, ULogFragments
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import MavCmd
from twodof.link.mavlink.messages import message

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
        self._log.begin_anew()
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
