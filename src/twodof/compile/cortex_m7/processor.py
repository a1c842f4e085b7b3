"""Processor: an image that runs on an emulated Cortex-M7 (QEMU, board mps2-an500), called from here."""

from __future__ import annotations

import struct
import threading

import numpy as np
from numpy.typing import NDArray

from twodof.compile.cortex_m7.board import Board, find_emulator
from twodof.compile.cortex_m7.image import Image
from twodof.errors import CompileError

DEFAULTS, PREPARE, INIT, RUN, COUNT = range(5)
POOL = 16 * 2**20
ROWS = 65_536  # two row buffers of 32 kB, see server.c
MOST_STEPS = 2**32 - 1
NANOSECONDS_PER_INSTRUCTION = 1024  # QEMU's icount shift of 10, its largest
NANOSECONDS_PER_TICK = 40  # of the timer: 25 MHz


class Processor:
    """One emulated processor with `image` in its memory; it starts at the first call and stays until `close`.

    The programs' structs stay here: each call carries them to the processor and back. With `counting` its clock counts
    instructions (about half as fast). Calls of several threads wait for each other. Raises CompileError if the
    emulator is missing.
    """

    def __init__(self, image: Image, counting: bool = False) -> None:
        self.image = image
        self.counting = counting
        self.emulator = find_emulator()
        self._lock = threading.Lock()
        self._board: Board | None = None

    def close(self) -> None:
        """Switch it off. The next call starts it again."""
        with self._lock:
            self._off()

    def __enter__(self) -> Processor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _off(self) -> None:
        if self._board is not None:
            self._board.stop()
            self._board = None

    def call(self, program: int, operation: int, p: NDArray[np.void], s: NDArray[np.void], watch: bool = False) -> int:
        """DEFAULTS, PREPARE or INIT of the program with this index on its structs; see `run` for result and errors."""
        request = self._request(program, operation, 0, False, False, watch)
        sent = [] if operation == DEFAULTS else [p.tobytes()]
        target = s if operation == INIT else p
        with self._lock:
            answer, (depth, _) = self._transact(program, [request, *sent], target.nbytes)
        target.view(np.uint8)[:] = np.frombuffer(answer, np.uint8)
        return depth

    def run(
        self,
        program: int,
        p: NDArray[np.void],
        s: NDArray[np.void],
        u: NDArray[np.void],
        y: NDArray[np.void],
        steps: int,
        watch: bool = False,
    ) -> int:
        """`steps` steps of the program with this index; `u` and `y` have `steps` rows or one.

        The result is how much of the stack its calls used [bytes], found by painting it, if `watch` asks for it, else
        0. Raises ControllerFault if the program faults, with the registers; if the emulator ends; if nothing is heard
        for `SILENCE` seconds.
        """
        many = len(y) > 1
        rows = [np.ascontiguousarray(u).view(np.uint8).data] if steps else []
        request = self._request(program, RUN, steps, len(u) > 1, many, watch)
        size = y.itemsize
        expected = (steps * size if many else size if steps else 0) + s.nbytes
        with self._lock:
            answer, (depth, _) = self._transact(program, [request, p.tobytes(), s.tobytes(), *rows], expected)
        data = np.frombuffer(answer, np.uint8)
        s.view(np.uint8)[:] = data[-s.nbytes :]
        if steps:
            y.view(np.uint8)[:] = data[: -s.nbytes]
        return depth

    def count(
        self, program: int, p: NDArray[np.void], s: NDArray[np.void], u: NDArray[np.void], steps: int
    ) -> tuple[NDArray[np.int64], int]:
        """Runs `steps` steps. Returns the instructions of each (steps,), without call and return, and the stack that
        they used [bytes].

        It must be a processor that is `counting`. Errors as `run`'s.
        """
        if not self.counting:
            raise CompileError("this processor's clock does not count instructions", "", "make it with counting=True")
        rows = [np.ascontiguousarray(u).view(np.uint8).data] if steps else []
        request = self._request(program, COUNT, steps, len(u) > 1, True, True)
        with self._lock:
            answer, (depth, idle) = self._transact(
                program, [request, p.tobytes(), s.tobytes(), *rows], 4 * steps + s.nbytes
            )
        data = np.frombuffer(answer, np.uint8)
        s.view(np.uint8)[:] = data[-s.nbytes :]
        ticks = data[: -s.nbytes].view("<u4").astype(np.int64)
        return _instructions(ticks) - _instructions(np.array([idle])), depth

    def _request(self, program: int, operation: int, steps: int, u_rows: bool, y_rows: bool, watch: bool) -> bytes:
        name, sizes = self.image.names[program], self.image.sizes[program]
        need = sum(sizes[1:]) + ROWS + 64
        if need > POOL:
            raise CompileError(
                f"its structs need {need} bytes; the board has {POOL}", name, "make its delays and tables shorter"
            )
        if not 0 <= steps <= MOST_STEPS:
            raise CompileError(f"{steps} steps at once", name, f"at most {MOST_STEPS}")
        return struct.pack("<11I", operation, program, steps, u_rows, y_rows, watch, *sizes)

    def _transact(self, program: int, parts: list[bytes | memoryview], expected: int) -> tuple[bytes, tuple[int, int]]:
        """One request and its answer: the data, and depth of the stack and ticks of an empty call."""
        name = self.image.names[program]
        if self._board is None:
            self._board = Board(self.emulator, self.image.elf, self.counting)
        try:
            return self._board.transact(name, parts, expected)
        except BaseException:  # whatever happened, what is in the pipes belongs to nobody now
            self._off()
            raise


def _instructions(ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ticks are known to +-1, an instruction is 25.6 of them: the number of instructions is exact."""
    exact: NDArray[np.float64] = np.rint(ticks * (NANOSECONDS_PER_TICK / NANOSECONDS_PER_INSTRUCTION))
    return exact.astype(np.int64)
