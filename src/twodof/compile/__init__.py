"""From a diagram to C99 and to machine code. See docs/language.md section 6."""

from twodof.compile.program import Machine, Program, build

__all__ = ["Machine", "Program", "build"]
