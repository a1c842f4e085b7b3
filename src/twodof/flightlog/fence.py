"""Fence around strangers' files: a warm process reads each in a child with limits of memory, processor and time.

The libraries that read logs trust them: a file of a few kilobytes can take gigabytes, run for minutes or end the
process. So they run in a process of their own. The warm process imports the library once and forks a child with limits
for each file. The answer is JSON and arrays of numbers, never objects that could run code.

The limits grow with the file: a long flight is read, and a small file cannot ask for much. A child may take
`CPU_S` and a second for each `BYTES_PER_S`, ten times that by the clock, and `MEMORY` with `MEMORY_PER_BYTE`. Its
answer holds at most `ANSWER` and `ANSWER_PER_BYTE` of samples and `MOST_TEXT` of JSON.
"""

import atexit
import fcntl
import gc
import importlib
import json
import math
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.provenance import open_file

CPU_S = 3
BYTES_PER_S = 10_000_000
WALL_FACTOR = 10
"""Wall-clock time over processor time: other programs run as well, and a disk may be slow."""
MEMORY = 1 << 30
MEMORY_PER_BYTE = 8
ANSWER = 64 << 20
ANSWER_PER_BYTE = 5
MOST_ANSWER = 1 << 30
MOST_TEXT = 8 << 20
_ANSWER_TIME_S = 5.0
_PIPE_BYTES = 1 << 20
_KINDS = ("<f8", "<u8", "|u1")
_REMEDY = "this is not a flight log, or it is damaged: export or record it again"

Answer: TypeAlias = tuple[Any, Sequence[NDArray[Any]]]
"""Result of a reader: JSON values, and arrays of float64, uint64 or uint8."""
Reader: TypeAlias = Callable[..., Answer]


class _WarmProcess:
    """The process that forks a child for each file."""

    def __init__(self) -> None:
        self.control, theirs = socket.socketpair()
        # The search path of this process, and nothing of the folder in which it was started.
        start = f"import sys; sys.path[:] = {sys.path!r}; from twodof.flightlog import fence; fence.serve(0)"
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-I", "-c", start],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in the terminal is for the program that asked
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"},
            )

    def end(self, at_once: bool) -> None:
        """End the process and its child; it ends by itself when its control socket closes."""
        self.control.close()
        if at_once:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class Fence:
    """Reads files one at a time in the child of a warm process, which is started when it is first needed."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._warm: _WarmProcess | None = None

    def read(
        self, reader: Reader, path: str | Path, *arguments: object, needs: str = ""
    ) -> tuple[Any, list[NDArray[Any]]]:
        """Return what `reader(data, path, *arguments)` returns for the bytes of a file; `arguments` are JSON values.

        `reader` is a function of a module; the module `needs` is imported before the child is forked. Raises the
        LogError that it raises, and LogError for a file that cannot be opened, takes more than the limits allow, or
        ends its reader.
        """
        with open_file(path) as file:
            size = os.fstat(file).st_size
            request = {
                "module": reader.__module__,
                "name": reader.__name__,
                "needs": needs or reader.__module__,
                "where": str(path),
                "arguments": arguments,
                "size": size,
            }
            with self._turn:
                return self._ask(request, file, size)

    def close(self) -> None:
        """End the warm process."""
        warm, self._warm = self._warm, None
        if warm is not None:
            warm.end(at_once=True)

    def forget(self) -> None:
        """Leave the warm process to the process that started it. Called in a fork."""
        warm, self._warm, self._turn = self._warm, None, threading.Lock()
        if warm is not None:
            warm.control.close()
            warm.process.returncode = 0  # it is not a child of this process

    def _ask(self, request: dict[str, Any], file: int, size: int) -> tuple[Any, list[NDArray[Any]]]:
        where = request["where"]
        seconds = WALL_FACTOR * _processor_time(size)
        end = time.monotonic() + seconds
        whole = False
        if self._warm is None:
            self._warm = _WarmProcess()
        control = self._warm.control
        ours, theirs = os.pipe()
        with suppress(AttributeError, OSError):  # of Linux; an answer comes in fewer parts
            fcntl.fcntl(ours, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        try:
            try:
                socket.send_fds(control, [json.dumps(request).encode() + b"\n"], [file, theirs])
            finally:
                os.close(theirs)
            found = None
            with suppress(EOFError):
                found = _receive(ours, size, end)
            status = _status(control, end)
            whole = True
        except TimeoutError:
            raise LogError(f"is not read within {seconds:g} s", where, _REMEDY) from None
        except (OSError, EOFError) as reason:
            raise LogError(f"the process that reads files has ended: {reason}", where, "try again") from reason
        finally:
            os.close(ours)
            if not whole:
                self.close()
        if found is None:
            raise LogError(*_how_it_ended(status, size, where))
        plain, arrays = found
        if "error" in plain:
            what, where, remedy = plain["error"]
            raise LogError(what, where, remedy)
        return plain["answer"], arrays


_FENCE = Fence()
read = _FENCE.read
close = _FENCE.close
atexit.register(_FENCE.close)
os.register_at_fork(after_in_child=_FENCE.forget)


def serve(descriptor: int) -> None:
    """Read one file after another, as they are asked for, until the other end closes. The warm process runs this."""
    control = socket.socket(fileno=descriptor)
    while True:
        message, descriptors, _, _ = socket.recv_fds(control, 1 << 16, 2)
        while message and not message.endswith(b"\n"):
            message += control.recv(1 << 16)
        if not message:
            os._exit(0)
        request = json.loads(message)
        importlib.import_module(request["needs"])
        reader = getattr(importlib.import_module(request["module"]), request["name"])
        gc.freeze()  # a collection in the child would copy every page of what is imported here
        child = os.fork()
        if not child:
            try:
                control.close()
                _answer(reader, request, *descriptors)
            finally:
                os._exit(1)
        for one in descriptors:
            os.close(one)
        _, status = os.waitpid(child, 0)
        control.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))


def _answer(reader: Reader, request: dict[str, Any], file: int, pipe: int) -> None:
    """Run a reader within the limits and write its answer into the pipe."""
    size, where = request["size"], request["where"]
    _limit(size)
    try:
        with os.fdopen(file, "rb") as stream:
            data = stream.read(size)
        plain, arrays = reader(data, where, *request["arguments"])
        parts = _packed({"answer": plain}, arrays)
        if len(parts[0]) > MOST_TEXT or sum(map(len, parts[1:])) > _most_answer(size):
            raise MemoryError
    except LogError as reason:
        parts = _packed({"error": [reason.what, reason.where, reason.remedy]}, ())
    except MemoryError:
        parts = _packed({"error": [_too_large(size), where, _REMEDY]}, ())
    except RecursionError:
        parts = _packed({"error": ["is nested too deep", where, _REMEDY]}, ())
    except Exception as reason:  # noqa: BLE001  a library may raise anything on what it does not expect
        what = f"cannot be read: {type(reason).__name__}: {reason!s:.200}"
        parts = _packed({"error": [what, where, _REMEDY]}, ())
    with os.fdopen(pipe, "wb") as stream:
        stream.write(len(parts[0]).to_bytes(8, "little"))
        for part in parts:
            stream.write(part)
    os._exit(0)


def _limit(size: int) -> None:
    """Set the limits of this process for a file of `size` bytes."""
    used = 0
    with suppress(OSError):
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    memory = used + MEMORY + MEMORY_PER_BYTE * size
    seconds = _processor_time(size)
    # At the soft limit of processor time comes SIGXCPU, which says so; at the hard one SIGKILL, which does not.
    for kind, soft, hard in (
        (resource.RLIMIT_AS, memory, memory),
        (resource.RLIMIT_CPU, seconds, seconds + 1),
        (resource.RLIMIT_FSIZE, 0, 0),
        (resource.RLIMIT_CORE, 0, 0),
    ):
        with suppress(ValueError, OSError):  # macOS has no limit of address space
            resource.setrlimit(kind, (soft, hard))


def _processor_time(size: int) -> int:
    return CPU_S + math.ceil(size / BYTES_PER_S)


def _most_answer(size: int) -> int:
    return min(ANSWER + ANSWER_PER_BYTE * size, MOST_ANSWER)


def _too_large(size: int) -> str:
    return f"asks for more memory than a file of {size} bytes may"


def _packed(plain: dict[str, Any], arrays: Sequence[NDArray[Any]]) -> list[bytes | memoryview]:
    """Return the parts of an answer: its JSON, then the bytes of each array."""
    shapes = [[one.dtype.str, one.shape] for one in arrays]
    text = json.dumps({**plain, "arrays": shapes}, allow_nan=False).encode()
    return [text, *(np.ascontiguousarray(one).data.cast("B") for one in arrays if one.size)]


def _receive(pipe: int, size: int, end: float) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Return an answer. Raises EOFError where it is not whole, TimeoutError at the time `end`."""
    length = bytearray(8)
    _fill(pipe, memoryview(length), end)
    text = bytearray(min(int.from_bytes(length, "little"), MOST_TEXT))
    _fill(pipe, memoryview(text), end)
    plain = json.loads(text)
    left = _most_answer(size)
    arrays = []
    for kind, shape in plain["arrays"]:
        left -= math.prod(shape) * np.dtype(kind).itemsize
        if left < 0 or kind not in _KINDS:
            raise EOFError
        array = np.empty(shape, kind)
        if array.size:
            _fill(pipe, array.data.cast("B"), end)
        arrays.append(array)
    return plain, arrays


def _fill(pipe: int, buffer: memoryview, end: float) -> None:
    waiting = select.poll()
    waiting.register(pipe, select.POLLIN)
    while buffer:
        if not waiting.poll(max(0.0, 1e3 * (end - time.monotonic()))):
            raise TimeoutError
        count = os.readv(pipe, [buffer])
        if not count:
            raise EOFError
        buffer = buffer[count:]


def _status(control: socket.socket, end: float) -> int:
    """Return the exit code of the child, negative for a signal."""
    control.settimeout(max(_ANSWER_TIME_S, end - time.monotonic()))
    line = control.recv(100)
    if not line:
        raise EOFError
    return int(line)


def _how_it_ended(status: int, size: int, where: str) -> tuple[str, str, str]:
    """Return what, where and remedy for a child that ended with `status` before it had answered."""
    if status == -signal.SIGKILL:
        what = "the process that read it was killed, perhaps because the computer has run out of memory"
        return what, where, "close other programs and read it again"
    if status == -signal.SIGXCPU:
        what = f"takes more than {_processor_time(size)} s of processor time to read"
    elif status < 0:
        what = f"ends its reader by the signal {signal.Signals(-status).name}"
    else:
        what = _too_large(size)
    return what, where, _REMEDY
