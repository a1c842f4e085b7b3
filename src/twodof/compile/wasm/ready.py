"""Whether WebAssembly can be made and run here: said at once, with everything that is missing and the one remedy."""

from __future__ import annotations

import importlib
from importlib.util import find_spec

from twodof.compile.wasm.module import find_wasm_compiler
from twodof.errors import CompileError

REMEDY = (
    "run `make sandbox` in twodof's folder; where it was installed without make: pip install wasmtime ziglang "
    "into the same environment"
)


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
            REMEDY,
        )
