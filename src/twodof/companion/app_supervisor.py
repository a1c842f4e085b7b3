"""Supervisor of a user's program on board: a child process with limits, a log and restarts, ended with the companion.

Nothing here speaks to the vehicle. When the app dies its link goes silent, and the flight controller lets the lease
lapse by its own rules (docs/explanation/safety.md).
"""

import asyncio
import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from io import FileIO
from pathlib import Path

CONFINE = Path(__file__).with_name("process_limits.py")
LONGEST_LINE = 2000
READ_BYTES = 65_536
FINE, MISTAKE = 0, 2
PIPE_S = 1.0
# Between looks at whether a kill was released.
LOOK_S = 0.2
MOST_LINES, LINES_PER_SECOND = 200.0, 50.0


@dataclass(frozen=True)
class AppLimits:
    """Limits of an app: memory and the largest file [byte], open files, niceness."""

    memory: int = 4 << 30
    file: int = 1 << 30
    files: int = 256
    niceness: int = 5


@dataclass(frozen=True)
class RestartPolicy:
    """Delays and number of restarts of an app that crashed.

    The first time after `first` [s], then after twice as long each time, up to `longest`; at most `most` times in a
    row. A lease lives 3 s without its holder, so what flew has come to rest by then. A run of `good` [s] counts as a
    new start.
    """

    first: float = 4.0
    longest: float = 30.0
    most: int = 4
    good: float = 60.0


class AppSupervisor:
    """Supervisor of the app `command`. `log` gets the lines of the app's output and of the supervisor.

    After a crash the app is not started again while `killed` returns True: while its drone is killed.
    """

    def __init__(
        self,
        command: Sequence[str],
        log: Callable[[str], None],
        limits: AppLimits = AppLimits(),
        restarts: RestartPolicy = RestartPolicy(),
        stop_s: float = 5.0,
        killed: Callable[[], bool] = lambda: False,
    ) -> None:
        self.command = tuple(command)
        self.starts = 0
        self._log = log
        self._limits = limits
        self._restarts = restarts
        self._stop_s = stop_s
        self._killed = killed
        self._room, self._room_at, self._left_out = MOST_LINES, 0.0, 0

    async def run(self) -> int:
        """Run the app, restart it after crashes, and return its last exit status (128 + n: ended by signal n).

        Status 0 is success, status 2 a usage error: after both the app is not started again.
        """
        loop = asyncio.get_running_loop()
        crashes, wait = 0, self._restarts.first
        while True:
            began = loop.time()
            status = await self._once()
            if loop.time() - began >= self._restarts.good:
                crashes, wait = 0, self._restarts.first
            if status in (FINE, MISTAKE):
                return status
            crashes += 1
            if crashes > self._restarts.most:
                self._log(f"app: {_ended(status)}; it crashed {crashes} times in a row: given up")
                return status
            self._log(f"app: {_ended(status)}; started again in {wait:g} s")
            await asyncio.sleep(wait)
            if self._killed():  # who did it does not want the app to fly on
                self._log("app: the drone was killed; started again once it is released (twodof kill --release)")
            while self._killed():
                await asyncio.sleep(LOOK_S)
            wait = min(2.0 * wait, self._restarts.longest)

    async def _once(self) -> int:
        """Run the app once, until the last of its processes has ended."""
        self.starts += 1
        try:
            child, said = await self._start()
        except OSError as error:
            self._log(f"app: cannot be started: {error.strerror}")  # no memory or no process to be had now
            return 1
        reading = asyncio.ensure_future(self._listen(said))
        try:
            status = await child.wait()
        finally:
            try:
                await self._end(child)
                await asyncio.wait({reading}, timeout=PIPE_S)  # a daemon of its own making may hold the pipe
            finally:
                reading.cancel()
                await asyncio.wait({reading})  # it ends at once, and says before what is left
        if not reading.cancelled():
            reading.result()
        return status if status >= 0 else 128 - status

    async def _start(self) -> tuple[asyncio.subprocess.Process, FileIO]:
        """Start the app; return its process and its output.

        The pipe is our own. With a pipe of asyncio an app would count as running while any process holds the pipe.
        """
        limits = json.dumps(asdict(self._limits))
        reader, writer = os.pipe()
        said = FileIO(reader, "rb")
        try:
            child = await asyncio.create_subprocess_exec(
                *(sys.executable, "-I", "-S", str(CONFINE), limits, str(os.getpid())),
                *self.command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=writer,
                stderr=asyncio.subprocess.STDOUT,
                start_new_session=True,
            )
        except BaseException:
            said.close()
            raise
        finally:
            os.close(writer)
        return child, said

    async def _end(self, child: asyncio.subprocess.Process) -> None:
        """End the app and its children: ask them, and kill them after `stop_s`."""
        try:
            if child.returncode is None:
                _signal(child.pid, signal.SIGTERM)
                with suppress(TimeoutError):
                    async with asyncio.timeout(self._stop_s):
                        await child.wait()
        finally:
            _signal(child.pid, signal.SIGKILL)
        await child.wait()

    async def _listen(self, said: FileIO) -> None:
        """Write its lines to the log as they come, without ever holding it up."""
        loop = asyncio.get_running_loop()
        stream = asyncio.StreamReader()
        transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(stream), said)
        rest = b""
        try:
            while data := await stream.read(READ_BYTES):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    self._say(line)
                if len(rest) > LONGEST_LINE:
                    self._say(rest)
                    rest = b""
        finally:  # also where a daemon of its own making holds the pipe
            transport.close()
            if rest:
                self._say(rest)
            self._tell_left_out()

    def _say(self, line: bytes) -> None:
        """Write one of its lines to the log, unless there were too many."""
        now = asyncio.get_running_loop().time()
        self._room = min(self._room + (now - self._room_at) * LINES_PER_SECOND, MOST_LINES)
        self._room_at = now
        if self._room < 1.0:
            self._left_out += 1
            return
        self._room -= 1.0
        self._tell_left_out()
        text = line[:LONGEST_LINE].decode("utf-8", "replace").rstrip()
        self._log("".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text))

    def _tell_left_out(self) -> None:
        if self._left_out:
            self._log(f"app: {self._left_out} lines left out")
            self._left_out = 0


def _signal(group: int, number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def _ended(status: int) -> str:
    if status - 128 in [*signal.Signals]:
        return f"ended by {signal.Signals(status - 128).name}"
    return f"ended with status {status}"
