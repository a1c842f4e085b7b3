"""From a diagram to C99 and to machine code.

See docs/explanation/language.md, section 6, and docs/reference/compilation.md.
"""

from twodof.compile.builder import CompiledProgram, build
from twodof.compile.machine import CompiledMachine

__all__ = ["CompiledMachine", "CompiledProgram", "build"]
