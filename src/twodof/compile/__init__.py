"""From a diagram to C99 and to machine code.

See docs/explanation/language.md, section 6, and docs/reference/compilation.md. Importing this loads nothing else: a
program that only needs the cache, as every one that speaks MAVLink does, starts without the compiler.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twodof.compile.builder import build
    from twodof.compile.machine import CompiledMachine, CompiledProgram

__all__ = ["CompiledMachine", "CompiledProgram", "build"]
_MODULES = {"build": "builder", "CompiledMachine": "machine", "CompiledProgram": "machine"}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
