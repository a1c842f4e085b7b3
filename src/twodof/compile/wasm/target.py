"""The target "wasm": modules that any engine loads, run by wasmtime; and whether both can be had here."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from twodof.compile.target import EmittedProgram
from twodof.compile.wasm.engine import WasmBackend, backends
from twodof.compile.wasm.module import compile_module, find_wasm_compiler
from twodof.errors import CompileError

INSTALL = (
    "run `make sandbox` in twodof's folder; where it was installed without make: pip install wasmtime ziglang "
    "into the same environment"
)
"""What brings the sandbox, as a remedy of an error."""


def check_ready(compiler: str | None = None) -> None:
    """Raises CompileError that names everything missing for the sandbox, wasmtime and a compiler (`compiler`, or any).

    Asked again after an installation it looks anew, so a program that runs need not be started again.
    """
    importlib.invalidate_caches()
    missing = [] if find_spec("wasmtime") is not None else ["the package wasmtime"]
    try:
        find_wasm_compiler(compiler)
    except CompileError:
        if compiler is not None:  # one that was named: the remedy is another name
            raise
        missing.append("a compiler for WebAssembly (the package ziglang)")
    if missing:
        lack = "are" if len(missing) > 1 else "is"
        raise CompileError(
            f"the sandbox in which your own controllers fly cannot be set up: {' and '.join(missing)} {lack} "
            "not installed",
            "target wasm",
            INSTALL,
        )


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
