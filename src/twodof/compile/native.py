"""Native code: shared objects from C source, loaded into this process."""

from __future__ import annotations

import ctypes
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile.target import EmittedProgram
from twodof.compile.toolchain import compilers
from twodof.compile.toolchain.compilers import Compiler
from twodof.errors import CompileError

FLAGS = (*compilers.FLAGS, "-fPIC", "-shared")


def load(
    source: str, compiler: Compiler, optimise: str = "-O3", native: bool = True, flags: Sequence[str] = ()
) -> ctypes.CDLL:
    """Compile `source` to a library, or find it in the cache, and load it.

    `native` uses all instructions of this processor. Raises CompileError if the compiler refuses or hangs, or if this
    process rounds subnormal numbers to zero.
    """
    _check_subnormals()
    march = ("-mcpu=native" if platform.machine() in ("arm64", "aarch64") else "-march=native",) if native else ()
    # The few functions on memory are found in this process; else zig first makes itself a C library, for seconds.
    alone = ("-nostdlib",) if compiler.name == "zig" and platform.system() == "Linux" else ()
    options = (*FLAGS, optimise, *march, *alone, *compiler.flags, *flags)
    cpu = compilers.processor() if native else platform.machine()
    try:
        # A library stays mapped when its file goes.
        return compilers.compiled(source, compiler, options, ".so", lambda file: ctypes.CDLL(str(file)), cpu)
    except OSError as error:
        what = f"the compiled library does not load: {error}"
        raise CompileError(what, compiler.name, "set TWODOF_CACHE to a folder whose files may be executed") from error


def _check_subnormals() -> None:
    """Raise CompileError if this process flushes subnormals to zero, as a library built with -ffast-math makes it."""
    if np.float64(2.0**-1074) * np.float64(1.0) == 0.0:
        remedy = "find the imported library that was built with -ffast-math, and import it after twodof or not at all"
        raise CompileError("this process rounds subnormal numbers to zero", "", remedy)


@dataclass(frozen=True)
class Native:
    """Target of this computer: `compiler` "cc", "gcc", "clang", "zig" or a path; `cpu` uses all its instructions."""

    compiler: str | None = None
    optimise: str | None = None
    cpu: bool = True
    flags: tuple[str, ...] = ()
    name = "native"

    def compile(self, programs: Sequence[EmittedProgram]) -> list[NativeBackend]:
        """Compile the programs of one source into one library; raises CompileError, see `load`."""
        found = compilers.find_compiler(self.compiler)
        library = load(programs[0].source, found, self.optimise or programs[0].optimise, self.cpu, self.flags)
        return [NativeBackend(program, library) for program in programs]


class NativeBackend:
    """A program's functions in a loaded library.

    Raises CompileError if the library's structs are not of the expected sizes.
    """

    def __init__(self, program: EmittedProgram, library: ctypes.CDLL) -> None:
        self.program = program
        self.library = library
        sizes = list((ctypes.c_size_t * 5).in_dll(library, f"{program.name}_sizes"))
        if sizes != program.sizes:
            raise CompileError(
                f"its structs have the sizes {sizes}, expected {program.sizes}", program.name, "report this as a fault"
            )

    def instance(self) -> NativeInstance:
        """Return a fresh instance, whose structs are numpy arrays."""
        return NativeInstance(self)


class NativeInstance:
    """Structs of one instance; the calls are C functions bound to their addresses, with no Python between."""

    def __init__(self, backend: NativeBackend) -> None:
        self.structs: dict[str, NDArray[Any]] = {k: np.zeros(1, t) for k, t in backend.program.dtypes.items()}
        p, s, u, y = map(_address, self.structs.values())

        def bound(name: str, *arguments: Any) -> Any:
            function = getattr(backend.library, f"{backend.program.name}_{name}")
            function.restype = None
            return partial(function, *arguments)

        self.defaults = bound("defaults", p)
        self.prepare = bound("prepare", p)
        self.init = bound("init", p, s)
        self.step = bound("step", p, s, u, y)
        self._run = bound("run", p, s)

    def run(self, steps: int, u: NDArray[Any], y: NDArray[Any]) -> None:
        """Run `steps` ticks on the caller's own arrays; see `TargetInstance.run`."""
        size = ctypes.c_size_t
        self._run(_address(u), size(len(u) > 1), _address(y), size(len(y) > 1), size(steps))


def _address(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
