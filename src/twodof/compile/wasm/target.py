"""The target "wasm": modules that any engine loads, run by wasmtime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twodof.compile.target import EmittedProgram
from twodof.compile.wasm.engine import WasmBackend, backends
from twodof.compile.wasm.module import compile_module
from twodof.compile.wasm.ready import check_ready


@dataclass(frozen=True)
class Wasm:
    """WebAssembly run by wasmtime. `compiler` is "zig", "clang" or a path to a clang.

    `fuel` is what one step may use, about one unit an instruction; None: what `step_fuel` gives.
    """

    compiler: str | None = None
    optimise: str = "-O3"
    fuel: int | None = None
    name = "wasm"

    def compile(self, programs: Sequence[EmittedProgram]) -> list[WasmBackend]:
        """The programs of one source in one module; raises CompileError, also if wasmtime is not there."""
        check_ready(self.compiler)
        module = compile_module(programs, self.compiler, self.optimise)
        return backends(module, self.fuel)
