"""From a diagram to C99 and to machine code.

See docs/explanation/language.md, section 6, and docs/reference/compilation.md.
"""

from twodof.compile.machine import Machine
from twodof.compile.program import Program, build

__all__ = ["Machine", "Program", "build"]
