"""Log streaming: the on-board log as it is written, for MAV_CMD_LOGGING_START (2510) until MAV_CMD_LOGGING_STOP (2511).

What describes the log comes in LOGGING_DATA_ACKED, one at a time and again until LOGGING_ACK came; the records come in
LOGGING_DATA, once. Each says where the first message begins in it, so that a client that lost one finds its way again.
One client at a time, for as long as it is heard of, from a log that begins with it. Sources: the dialect of these
messages; PX4, mavlink_ulog.cpp.
"""

from collections.abc import Hashable
from pathlib import Path

from twodof.fcu.command.command_lease import DONE, CommandResult, Source, denied, rejected
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.background import BackgroundWorker, PacedSender, read_block
from twodof.fcu.mavlink.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.service import Link, Service, Take, VehicleAddress, source, target, whole
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.flightlog.ulog_writer import MOST, ULogFragment, ULogFragments
from twodof.link.connection import Received
from twodof.link.mavlink.dialect import MavCmd
from twodof.link.mavlink.messages import message

ULOG = 0
A_TICK = 8
"""LOGGING_DATA in a control period: .5 MB/s, where the log is .2 MB/s."""
AGAIN_PORTIONS, MOST_AGAIN = 25, 50
"""An answer is waited for 100 ms, 50 times."""
BLOCK = 1 << 15
SILENT_PORTIONS = 2500
"""10 s (5 s in lockstep) without any frame of the client: over UDP a client that is gone says nothing."""
LOOK_PORTIONS = 12
"""Portions between looks for more of the file, 50 ms."""


class LogStreamClient:
    """A client that is sent the log that begins after `before`."""

    def __init__(self, peer: Hashable, client: Source, before: Path | None) -> None:
        self.peer, self.client, self.before = peer, client, before
        self.path: Path | None = None
        self.pieces = ULogFragments()
        self.read = 0  # bytes of the file handed to `pieces`
        self.reading = False
        self.sequence = 0
        self.unanswered: ULogFragment | None = None
        self.waited = self.again = 0
        self.silent = 0  # portions since it was heard


class LogStreamService(Service):
    """Streams the log of `log` to the client that asked for it; `take` says whether a source may command.

    To begin needs the lease: it ends the log that is being written, and a new one may push out the oldest.
    """

    def __init__(
        self,
        link: Link,
        us: VehicleAddress,
        commands: CommandService,
        log: OnboardLogger,
        take: Take,
        lockstep: bool = False,
    ) -> None:
        self._link, self._us, self._commands, self._log, self._take = link, us, commands, log, take
        self._background = BackgroundWorker(inline=lockstep)
        self._pump = PacedSender(self._send, lockstep)
        self._stream: LogStreamClient | None = None
        self._portions = 0
        commands.on(MavCmd.LOGGING_START, self._start)
        commands.on(MavCmd.LOGGING_STOP, self._stop)

    def handle(self, received: Received) -> bool:
        """Take an answer, and note that the client is there."""
        stream, got = self._stream, received.message
        answer = got.get_type() == "LOGGING_ACK"
        if stream is not None and source(received) == stream.client:
            stream.silent = 0
            if answer and self._us.addressed(got) and stream.unanswered and got.sequence == stream.sequence:
                self._sent(stream)
                self._pump.start()
        return bool(answer)

    def after(self, step: ControlStep) -> None:
        self._background.poll()
        self._pump.tick()

    def gone(self, peer: Hashable) -> None:
        if self._stream is not None and self._stream.peer == peer:
            self._end()

    def _start(self, command: ReceivedCommand) -> CommandResult:
        if whole(command.params[0], -1) != ULOG:
            return denied("logs are streamed as ULog: format 0")
        stream = self._stream
        if stream is not None and stream.client != command.source:
            return rejected(f"the log is streamed to {stream.client[0]}/{stream.client[1]} already")
        taken = self._take(command.source, "log stream")
        if not taken.accepted:
            return taken
        self._stream = LogStreamClient(command.peer, command.source, self._log.path)
        self._log.begin_anew()
        self._log.start()
        self._pump.start()
        return DONE

    def _stop(self, command: ReceivedCommand) -> CommandResult:
        if self._stream is not None and self._stream.client == command.source:
            self._end()
        return DONE

    def _end(self, why: str = "") -> None:
        stream, self._stream = self._stream, None
        self._log.stop()
        if why and stream is not None:
            self._commands.explain(stream.peer, why)

    def _send(self) -> bool:
        stream = self._stream
        if stream is None:
            return False
        self._portions += 1
        stream.silent += 1
        if stream.silent > SILENT_PORTIONS:
            self._end("the log is not streamed any more: who asked for it is silent")
            return False
        if stream.path is None:
            found = self._log.path
            if found is not None and found != stream.before:
                stream.path = found
        if stream.path is not None and self._portions % LOOK_PORTIONS == 0:
            self._read(stream, stream.path)
        if stream.unanswered is not None:
            self._wait(stream)
        else:
            for _ in range(A_TICK):
                piece = stream.pieces.next()
                if piece is None:
                    break
                self._tell(stream, piece)
                if piece.described:
                    stream.unanswered = piece
                    break
                self._sent(stream)
        return self._stream is not None

    def _wait(self, stream: LogStreamClient) -> None:
        stream.waited += 1
        if stream.waited >= AGAIN_PORTIONS and stream.unanswered is not None:
            stream.waited, stream.again = 0, stream.again + 1
            if stream.again > MOST_AGAIN:
                self._end("the log is not streamed any more: no LOGGING_ACK came")
            else:
                self._tell(stream, stream.unanswered)

    def _sent(self, stream: LogStreamClient) -> None:
        stream.sequence = (stream.sequence + 1) & 0xFFFF
        stream.unanswered, stream.waited, stream.again = None, 0, 0

    def _tell(self, stream: LogStreamClient, piece: ULogFragment) -> None:
        sent = message(
            "LOGGING_DATA_ACKED" if piece.described else "LOGGING_DATA",
            **target(stream.client),
            sequence=stream.sequence,
            length=len(piece.data),
            first_message_offset=piece.first,
            data=piece.data,
        )
        self._link.send(sent, stream.peer)

    def _read(self, stream: LogStreamClient, path: Path) -> None:
        """Read more of the file; the stream ends where the log goes on in another file."""
        if stream.reading or stream.pieces.waiting > BLOCK:
            return
        over = self._log.path != path
        stream.reading = True

        def ready(found: object) -> None:
            stream.reading = False
            if isinstance(found, bytes):
                stream.read += len(found)
                stream.pieces.feed(found)
            if over and not found and stream is self._stream and stream.pieces.waiting < MOST:
                self._end("the log that was streamed has ended")

        if not self._background.submit(lambda: read_block(path, stream.read, BLOCK), ready):
            stream.reading = False
