"""Cortex-M7 target: machines whose steps run on an emulated processor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile.cortex_m7.image import OPTIMISE, build_image, find_cross_compiler
from twodof.compile.cortex_m7.processor import DEFAULTS, INIT, PREPARE, Processor
from twodof.compile.target import EmittedProgram, layout_checks
from twodof.errors import ControllerFault


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
