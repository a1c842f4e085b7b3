"""Fence around strangers' files: each is read in a process of its own with limits of memory, processor and time.

The libraries that read logs trust them: a file of a few kilobytes can take gigabytes, run for minutes or end the
process. So they run in a process of their own. The warm process imports the library once and forks a child with limits
for each file. The answer is JSON and arrays of numbers, never objects that could run code.

The limits grow with the file: a long flight is read, and a small file cannot ask for much. A child may take
`CPU_S` and a second for each `BYTES_PER_S`, ten times that by the clock, and `MEMORY` with `MEMORY_PER_BYTE`. Its
answer holds at most `ANSWER` and `ANSWER_PER_BYTE` of samples and `MOST_TEXT` of JSON.
"""

import atexit
import gc
import importlib
import json
import math
import mmap
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, TypeAlias

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
_KINDS = ("<f8", "<u8", "|u1")
_REMEDY = "this is not a flight log, or it is damaged: export or record it again"

Answer: TypeAlias = tuple[Any, Sequence[NDArray[Any]]]
"""Result of a reader: JSON values, and arrays of float64, uint64 or uint8."""
Reader: TypeAlias = Callable[..., Answer]


def _start() -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start the process that forks a child for each file, and return it and its control socket.

    It ends by itself when that closes.
    """
    control, theirs = socket.socketpair()
    # The search path of this process, and nothing of the folder in which it was started.
    start = f"import sys; sys.path[:] = {sys.path!r}; from twodof.flightlog import fence; fence.serve(0)"
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-I", "-c", start],
            stdin=theirs.fileno(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C in the terminal is for the program that asked
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"},
        )
    return process, control


class Fence:
    """Reader of files, one at a time, each in a child of a warm process, which is started when it is first needed."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._warm: tuple[subprocess.Popen[bytes], socket.socket] | None = None

    def read(
        self, reader: Reader, path: str | Path, *arguments: object, needs: str = ""
    ) -> tuple[Any, list[NDArray[Any]]]:
        """Return what `reader(data, path, *arguments)` returns for the bytes of a file; `arguments` are JSON values.

        `reader` is a function of a module; the module `needs` is imported before the child is forked. Raises the
        LogError of the reader, and LogError for a file that cannot be opened, takes more than the limits allow, or
        makes its reader crash.
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
        """End the warm process and its child."""
        warm, self._warm = self._warm, None
        if warm is not None:
            process, control = warm
            control.close()
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def forget(self) -> None:
        """Leave the warm process to the process that started it. Called in a fork."""
        warm, self._warm, self._turn = self._warm, None, threading.Lock()
        if warm is not None:
            process, control = warm
            control.close()
            process.returncode = 0  # it is not a child of this process

    def _ask(self, request: dict[str, Any], file: int, size: int) -> tuple[Any, list[NDArray[Any]]]:
        where = request["where"]
        seconds = WALL_FACTOR * _processor_time(size)
        try:
            answer = _empty_file(MOST_TEXT + min(ANSWER + ANSWER_PER_BYTE * size, MOST_ANSWER))
        except OSError as reason:
            remedy = "raise the limit of a file's size (ulimit -f)"
            raise LogError(f"its content does not fit: {reason.strerror}", where, remedy) from reason
        if self._warm is None:
            self._warm = _start()
        (_, control), status = self._warm, b""
        control.settimeout(seconds)
        try:
            with answer:
                socket.send_fds(control, [json.dumps(request).encode() + b"\n"], [file, answer.fileno()])
                status = control.recv(100)
                if not status:
                    raise EOFError
                found = None if int(status) else _unpacked(answer)
        except TimeoutError:
            raise LogError(f"was not read within {seconds:g} s", where, _REMEDY) from None
        except (OSError, EOFError, ValueError, RecursionError) as reason:
            raise LogError(f"the process that reads files has ended: {reason}", where, "try again") from reason
        finally:
            if not status:
                self.close()
        if found is None:
            raise LogError(*_how_it_ended(int(status), size, where))
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
    """Fork a child for each requested file until the other end of the socket `descriptor` closes: the warm process."""
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


def _answer(reader: Reader, request: dict[str, Any], file: int, answer: int) -> None:
    """Run a reader within the limits and write its answer."""
    size, where = request["size"], request["where"]
    _limit(size)
    try:
        with os.fdopen(file, "rb") as stream:
            data = stream.read(size)
        plain, arrays = reader(data, where, *request["arguments"])
        parts = _packed({"answer": plain}, arrays)
        if len(parts[0]) > MOST_TEXT or sum(map(len, parts)) > os.fstat(answer).st_size:
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
    with mmap.mmap(answer, sum(map(len, parts))) as memory:
        for part in parts:
            memory.write(part)
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


def _too_large(size: int) -> str:
    return f"asks for more memory than a file of {size} bytes may"


def _packed(plain: dict[str, Any], arrays: Sequence[NDArray[Any]]) -> list[bytes | memoryview]:
    """Return the parts of an answer: its JSON, then the bytes of each array."""
    shapes = [[one.dtype.str, one.shape] for one in arrays]
    text = json.dumps({**plain, "arrays": shapes}, allow_nan=False).encode()
    return [
        len(text).to_bytes(8, "little") + text,
        *(np.ascontiguousarray(one).data.cast("B") for one in arrays if one.size),
    ]


def _empty_file(size: int) -> IO[bytes]:
    """Return a file of zeros without a name, in memory where the system has such files."""
    own = hasattr(os, "memfd_create")
    file = os.fdopen(os.memfd_create("answer"), "w+b") if own else tempfile.TemporaryFile()  # noqa: SIM115
    file.truncate(size)
    return file


def _unpacked(answer: IO[bytes]) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Return an answer. Raises EOFError where it is not whole."""
    left = answer.seek(0, os.SEEK_END)
    answer.seek(0)
    plain = json.loads(answer.read(min(int.from_bytes(answer.read(8), "little"), MOST_TEXT)))
    arrays = []
    given = plain.get("arrays") if isinstance(plain, dict) else None
    if not isinstance(given, list) or not ("answer" in plain or _is_texts(plain.get("error"), 3)):
        raise EOFError
    for one in given:
        kind, shape = one if isinstance(one, list) and len(one) == 2 else ("", [])
        if kind not in _KINDS or not isinstance(shape, list) or any(type(n) is not int or n < 0 for n in shape):
            raise EOFError
        left -= math.prod(shape) * np.dtype(kind).itemsize
        if left < 0:
            raise EOFError
        arrays.append(np.fromfile(answer, kind, math.prod(shape)).reshape(shape))
    return plain, arrays


def _is_texts(given: object, count: int) -> bool:
    return isinstance(given, list) and len(given) == count and all(isinstance(one, str) for one in given)


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
