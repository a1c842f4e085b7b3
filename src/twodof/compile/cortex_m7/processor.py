"""Processor: an image that runs on an emulated Cortex-M7 (QEMU, board mps2-an500), called from here."""

from __future__ import annotations

import struct
import threading
from collections.abc import Sequence
from typing import Any

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

    def call(self, program: int, operation: int, p: NDArray[np.void], s: NDArray[np.void]) -> None:
        """DEFAULTS, PREPARE or INIT of the program with this index on its structs; see `run` for the errors."""
        sent = [] if operation == DEFAULTS else [p]
        self._exchange(program, operation, sent, [s if operation == INIT else p])

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
        sent, filled = ([p, s, u], [y, s]) if steps else ([p, s], [s])
        depth, _ = self._exchange(program, RUN, sent, filled, steps, len(u) > 1, len(y) > 1, watch)
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
        ticks = np.zeros(steps, "<u4")
        sent = [p, s, u] if steps else [p, s]
        depth, idle = self._exchange(program, COUNT, sent, [ticks, s], steps, len(u) > 1, True, True)
        return _instructions(ticks) - _instructions(np.array([idle])), depth

    def _exchange(
        self,
        program: int,
        operation: int,
        sent: Sequence[NDArray[Any]],
        filled: Sequence[NDArray[Any]],
        steps: int = 0,
        u_rows: bool = False,
        y_rows: bool = False,
        watch: bool = False,
    ) -> tuple[int, int]:
        """One request with `sent` behind it; `filled` from its answer. Depth of the stack, ticks of an empty call."""
        name, sizes = self.image.names[program], self.image.sizes[program]
        need = sum(sizes[1:]) + ROWS + 64
        if need > POOL:
            raise CompileError(
                f"its structs need {need} bytes; the board has {POOL}", name, "make its delays and tables shorter"
            )
        if not 0 <= steps <= MOST_STEPS:
            raise CompileError(f"{steps} steps at once", name, f"at most {MOST_STEPS}")
        request = struct.pack("<11I", operation, program, steps, u_rows, y_rows, watch, *sizes)
        parts: list[bytes | memoryview] = [request, *(np.ascontiguousarray(part).view(np.uint8).data for part in sent)]
        with self._lock:
            if self._board is None:
                self._board = Board(self.emulator, self.image.elf, self.counting)
            try:
                answer, last = self._board.transact(name, parts, sum(part.nbytes for part in filled))
            except BaseException:  # whatever happened, what is in the pipes belongs to nobody now
                self._off()
                raise
        at = 0
        for part in filled:
            part.view(np.uint8)[:] = np.frombuffer(answer, np.uint8, part.nbytes, at)
            at += part.nbytes
        return last


def _instructions(ticks: NDArray[Any]) -> NDArray[np.int64]:
    """Ticks are known to +-1, an instruction is 25.6 of them: the number of instructions is exact."""
    return np.rint(ticks * (NANOSECONDS_PER_TICK / NANOSECONDS_PER_INSTRUCTION)).astype(np.int64)
