"""Compilation of diagrams to C99 and to machine code.

See docs/explanation/language.md, section 6, and docs/reference/compilation.md. Importing this package loads nothing
else, so that programs which only need the cache (those that speak MAVLink) start fast.
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
