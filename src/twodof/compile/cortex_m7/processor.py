"""Emulated Cortex-M7 (QEMU, board mps2-an500) that runs an image, and machines whose steps run on it."""

from __future__ import annotations

import os
import select
import shutil
import struct
import subprocess
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile.cortex_m7.image import OPTIMISE, Image, build_image, find_cross_compiler
from twodof.compile.target import EmittedProgram, layout_checks
from twodof.errors import CompileError, ControllerFault

EMULATOR = "qemu-system-arm"
DATA, END, REFUSED, FAULT = 1, 2, 3, 4
SILENCE = 60.0
"""Longest wait for a byte from the processor [s]; it sends something every 256 steps."""
MOST_FRAME = 2**24
_COUNTING = ("-icount", "shift=10,align=off,sleep=off")  # an instruction takes 2^10 ns
_PIPE = 65_536

# The words that `report_fault` of boot.c sends: what the exception stored (0 where the stack was lost), then the rest.
_REGISTERS = ["r0", "r1", "r2", "r3", "r12", "lr", "pc", "xpsr", "sp", "exc_return", "cfsr", "hfsr", "mmfar", "bfar"]
# Armv7-M Architecture Reference Manual (DDI 0403E), B3.2.15: Configurable Fault Status Register.
_CAUSES = {
    0: "instruction fetched from memory without code",
    1: "access to an address without memory, or write into code",
    4: "stack outside of memory on entry to the exception",
    8: "instruction fetched from an address without memory",
    9: "access to an address without memory",
    10: "access to an address without memory",
    12: "stack outside of memory on entry to the exception",
    16: "undefined instruction",
    17: "invalid processor state (a jump to an even address)",
    18: "invalid return from an exception",
    19: "floating-point instruction while the unit is off",
    24: "unaligned access",
    25: "division of integers by zero",
}


def find_emulator() -> str:
    """Return the path of QEMU. Raises CompileError, with the name of its package, if it is missing."""
    path = shutil.which(EMULATOR)
    if path is None:
        what = f"{EMULATOR}, which emulates the Cortex-M7, was not found"
        raise CompileError(what, "", "install QEMU for Arm systems (Debian: apt-get install qemu-system-arm)")
    return path


class Board:
    """The process of the emulator and the two named pipes that the image opens by semihosting."""

    def __init__(self, emulator: str, elf: bytes, counting: bool) -> None:
        folder = tempfile.mkdtemp(prefix="twodof-m7-")
        self._said = Path(folder, "said")
        self._pending, self._received = memoryview(b""), bytearray()
        self._close = weakref.finalize(self, _clean, folder, descriptors := [], processes := [])
        try:
            Path(folder, "image.elf").write_bytes(elf)
            for name in ("to_target", "from_target"):
                os.mkfifo(Path(folder, name), 0o600)
            # Both ends at once for the one, so that nobody waits for the other side to open.
            self._out = os.open(Path(folder, "to_target"), os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            descriptors.append(self._out)
            self._in = os.open(Path(folder, "from_target"), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            descriptors.append(self._in)
            command = [emulator, "-M", "mps2-an500", "-nodefaults", "-display", "none", "-monitor", "none"]
            command += ["-serial", "none", "-nic", "none", "-accel", "tcg,thread=single,tb-size=64"]
            command += ["-semihosting-config", "enable=on,target=native", *(_COUNTING if counting else ())]
            with self._said.open("wb") as said:
                self._process = subprocess.Popen(
                    [*command, "-kernel", "image.elf"], cwd=folder, stdin=subprocess.DEVNULL, stdout=said, stderr=said
                )
            processes.append(self._process)
        except OSError as error:
            self.stop()
            raise CompileError(
                f"the emulator does not start: {error}", emulator, "install qemu-system-arm again"
            ) from error

    def stop(self) -> None:
        """End the process and remove its files."""
        self._close()

    def transact(self, name: str, parts: Sequence[bytes], expected: int) -> tuple[bytes, tuple[int, int]]:
        """Send `parts`; return the `expected` bytes of data and the content of the last frame.

        See `Processor.run` for the errors.
        """
        self._pending = memoryview(b"".join(parts))
        data = bytearray()
        while True:
            kind, size = struct.unpack("<2I", self._take(8, name))
            if kind not in (DATA, END, REFUSED, FAULT) or (size > MOST_FRAME and size > expected):
                what = f"the emulated processor sent an unknown answer of kind {kind} and {size} bytes"
                raise ControllerFault(what, name, "report this as a fault")
            content = self._take(size, name)
            if kind == FAULT:
                raise ControllerFault(fault_text(content), name, "find the function at pc in the image")
            if kind == REFUSED:
                raise CompileError("its structs have other sizes in the image", name, "report this as a fault")
            if kind == END:
                break
            data += content
        if len(data) != expected or len(self._pending):
            raise ControllerFault(
                f"the answer has {len(data)} bytes, expected {expected}", name, "report this as a fault"
            )
        return bytes(data), struct.unpack("<2I", content)

    def _take(self, count: int, name: str) -> bytes:
        """Return the next `count` bytes from the processor; send pending bytes while waiting."""
        heard = time.monotonic()
        while len(self._received) < count:
            ended = self._process.poll() is not None  # asked first: what it said before its end is then there to read
            left = SILENCE - (time.monotonic() - heard)
            if left <= 0 and not ended:
                what = f"the emulated processor sent nothing for {SILENCE:g} s"
                raise ControllerFault(what, name, "reduce the load of this computer, then try again")
            waiting = [self._out] if len(self._pending) and not ended else []
            readable, writable, _ = select.select([self._in], waiting, [], 0.0 if ended else min(left, 1.0))
            if writable:
                self._pending = self._pending[os.write(self._out, self._pending[:_PIPE]) :]
            chunk = os.read(self._in, _PIPE) if readable else b""
            if not chunk and (ended or readable):
                raise self._ended(name)
            if chunk:
                heard = time.monotonic()
                self._received += chunk
        taken = bytes(self._received[:count])
        del self._received[:count]
        return taken

    def _ended(self, name: str) -> ControllerFault:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        said = self._said.read_bytes()[:500].decode("utf-8", "replace").strip()
        return ControllerFault(
            f"the emulator ended with status {self._process.returncode}: {said or 'no message'}",
            name,
            f"check that {EMULATOR} works",
        )


def fault_text(data: bytes) -> str:
    """Return a text with the cause of a fault, the accessed address if known, and all registers."""
    words = dict(zip(_REGISTERS, struct.unpack("<14I", data), strict=True))
    status = words["cfsr"]
    causes = dict.fromkeys(text for bit, text in _CAUSES.items() if status >> bit & 1)
    valid = [words[name] for bit, name in ((7, "mmfar"), (15, "bfar")) if status >> bit & 1]
    at = f" at 0x{valid[0]:08x}" if valid else ""
    registers = " ".join(f"{name}={value:08x}" for name, value in words.items())
    return f"{' and '.join(causes) or 'fault of unknown cause'}{at}; {registers}"


def _clean(folder: str, descriptors: list[int], processes: list[subprocess.Popen[bytes]]) -> None:
    """Kill the emulator and forget its folder, also when the last reference goes or Python ends."""
    for process in processes:
        process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10.0)
    for descriptor in descriptors:
        os.close(descriptor)
    shutil.rmtree(folder, ignore_errors=True)


DEFAULTS, PREPARE, INIT, RUN, COUNT = range(5)
POOL = 16 * 2**20
ROWS = 65_536  # two row buffers of 32 kB, see server.c
MOST_STEPS = 2**32 - 1
NANOSECONDS_PER_INSTRUCTION = 1024  # QEMU's icount shift of 10, its largest
NANOSECONDS_PER_TICK = 40  # of the timer: 25 MHz


class Processor:
    """One emulated processor with `image` in its memory, from the first call until `close`.

    The programs' structs are kept in Python: each call carries them to the processor and back. With `counting` the
    clock counts instructions (about half as fast). Calls of several threads wait for each other. Raises CompileError if
    the emulator is missing.
    """

    def __init__(self, image: Image, counting: bool = False) -> None:
        self.image = image
        self.counting = counting
        self.emulator = find_emulator()
        self._lock = threading.Lock()
        self._board: Board | None = None

    def close(self) -> None:
        """Switch the processor off; the next call starts it again."""
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
        """Call DEFAULTS, PREPARE or INIT of the program with this index on its structs; see `run` for the errors."""
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
        """Run `steps` steps of the program with this index; `u` and `y` have `steps` rows or one.

        With `watch` return the stack that was used [bytes], else 0. Raises ControllerFault if the program faults, with
        the registers; if the emulator ends; and after `SILENCE` seconds without an answer.
        """
        sent, filled = ([p, s, u], [y, s]) if steps else ([p, s], [s])
        depth, _ = self._exchange(program, RUN, sent, filled, steps, len(u) > 1, len(y) > 1, watch)
        return depth

    def count(
        self, program: int, p: NDArray[np.void], s: NDArray[np.void], u: NDArray[np.void], steps: int
    ) -> tuple[NDArray[np.int64], int]:
        """Run `steps` steps; return the number of instructions of each, (steps,), and the stack that was used [bytes].

        Call and return are not counted. Raises CompileError for a processor without `counting`, and the errors of
        `run`.
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
        """Send one request with `sent`, fill `filled` from the answer. Returns stack and ticks of an empty call."""
        name, sizes = self.image.names[program], self.image.sizes[program]
        need = sum(sizes[1:]) + ROWS + 64
        if need > POOL:
            what = f"its structs need {need} bytes; the board has {POOL}"
            raise CompileError(what, name, "make its delays and tables shorter")
        if not 0 <= steps <= MOST_STEPS:
            raise CompileError(f"{steps} steps at once are out of bounds", name, f"run 0 to {MOST_STEPS}")
        request = struct.pack("<11I", operation, program, steps, u_rows, y_rows, watch, *sizes)
        parts = [request, *(part.tobytes() for part in sent)]
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
    """Return exact numbers of instructions: ticks are known to +-1, and an instruction takes 25.6 ticks."""
    return np.rint(ticks * (NANOSECONDS_PER_TICK / NANOSECONDS_PER_INSTRUCTION)).astype(np.int64)


@dataclass(frozen=True)
class CortexM7:
    """Cortex-M7 machine code (FPv5 with doubles) on QEMU's board mps2-an500.

    `compiler` is "gcc" (arm-none-eabi-gcc) or "zig", by default the first that is installed. All programs of one source
    share an image and an emulator, which starts at the first call (some .2 s); a call then takes about 1 ms.
    """

    compiler: str | None = None
    optimise: str = OPTIMISE
    flags: tuple[str, ...] = field(default=())
    name = "cortex-m7"

    def compile(self, programs: Sequence[EmittedProgram]) -> list[CortexM7Backend]:
        """Compile the programs of one source into one image.

        Raises CompileError, which names the package to install, without a cross compiler or QEMU; and if the compiler
        refuses the C or the code does not fit.
        """
        found = find_cross_compiler(self.compiler)
        named = [(program.name, program.sizes) for program in programs]
        source = programs[0].source + layout_checks(programs)
        image = build_image(source, named, found, self.optimise, self.flags)
        processor = Processor(image)
        return [CortexM7Backend(program, processor, index) for index, program in enumerate(programs)]


@dataclass(frozen=True, eq=False)
class CortexM7Backend:
    """Program number `index` of the image on `processor`."""

    program: EmittedProgram
    processor: Processor
    index: int

    def instance(self) -> CortexM7Instance:
        """Return a fresh instance, its structs zero."""
        return CortexM7Instance(self)


class CortexM7Instance:
    """Running program with structs in Python's memory, which each call carries to the processor and back.

    After a ControllerFault every further call raises it again, and the structs are as before the faulty call.
    """

    def __init__(self, backend: CortexM7Backend) -> None:
        kinds = backend.program.dtypes
        self.structs: dict[str, NDArray[Any]] = {k: np.zeros(1, kinds[k]) for k in "PSUY"}
        self._processor, self._index = backend.processor, backend.index
        self._fault: ControllerFault | None = None
        self.instructions: NDArray[np.int64] = np.zeros(0, np.int64)
        self.stack = 0

    def defaults(self) -> None:
        """Write the given parameters' defaults into P. The errors of this and the next methods are those of `run`."""
        self._call(DEFAULTS)

    def prepare(self) -> None:
        """Write the derived parameters into P."""
        self._call(PREPARE)

    def init(self) -> None:
        """Write the initial states into S."""
        self._call(INIT)

    def step(self) -> None:
        """Run one tick with U into Y."""
        self.run(1, self.structs["U"], self.structs["Y"])

    def run(self, steps: int, u: NDArray[Any], y: NDArray[Any]) -> None:
        """Run `steps` ticks on the rows of `u` (or on its one row) into those of `y`.

        If the processor counts, `y` is not written; `instructions` of each step and the used `stack` are set instead.
        """
        p, s = self.structs["P"], self.structs["S"]
        with self._watched():
            if self._processor.counting:
                self.instructions, self.stack = self._processor.count(self._index, p, s, u, steps)
            else:
                self._processor.run(self._index, p, s, u, y, steps)

    def _call(self, operation: int) -> None:
        with self._watched():
            self._processor.call(self._index, operation, self.structs["P"], self.structs["S"])

    @contextmanager
    def _watched(self) -> Iterator[None]:
        if self._fault is not None:
            raise ControllerFault(self._fault.what, self._fault.where, "make a new machine") from self._fault
        try:
            yield
        except ControllerFault as fault:
            self._fault = fault
            raise
