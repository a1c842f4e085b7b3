"""From a diagram to C99 and to machine code.

See docs/explanation/language.md, section 6, and docs/reference/compilation.md.
"""

from twodof.compile.builder import build
from twodof.compile.machine import CompiledMachine, CompiledProgram

__all__ = ["CompiledMachine", "CompiledProgram", "build"]
