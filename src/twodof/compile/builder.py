"""Build of a program from a diagram, for a target by name or with options."""

import warnings
from collections.abc import Iterable

from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.c.emitter import emit
from twodof.compile.cortex_m7.image import OPTIMISE
from twodof.compile.cortex_m7.processor import CortexM7
from twodof.compile.machine import CompiledProgram
from twodof.compile.native import Native
from twodof.compile.program.lower import lower
from twodof.compile.target import EmittedProgram, Target
from twodof.compile.toolchain import compilers
from twodof.compile.wasm.target import Wasm
from twodof.errors import CompileError

TARGETS = ("native", "wasm", "cortex-m7")


def build(
    diagram: Diagram,
    dt: float,
    precision: str = "float64",
    log: Iterable[str] = (),
    integrator: str = "rk4",
    compiler: str | None = None,
    optimise: str | None = None,
    native_cpu: bool = True,
    target: str | Target = "native",
) -> CompiledProgram | Reference:
    """Build the program of `diagram` at the base tick `dt` [s], with the signals at the paths `log`.

    `target` is "native", "wasm" (the sandbox), "cortex-m7" (on an emulated processor), or a Target with options of its
    own. For a target by name, `compiler` is "cc", "gcc", "clang", "zig" or a path, `optimise` a compiler option, and
    `native_cpu` tunes for this processor. With `compiler=None` the first installed compiler is used. Without any,
    "native" returns the reference interpreter (same results, thousands of times slower) with a warning. Raises
    DiagramError for a faulty diagram, CompileError for an unknown target or a missing or failing compiler or engine.
    """
    log = tuple(log)
    source = emit_program(diagram, dt, precision, log, integrator)
    chosen = _target(target, compiler, optimise, native_cpu) if isinstance(target, str) else target
    if isinstance(chosen, Native) and chosen.compiler is None:
        try:
            compilers.find_compiler()
        except CompileError:
            warnings.warn(
                f"no C compiler is here: {diagram.name!r} runs on the reference interpreter, thousands of times "
                "slower; install gcc, or the wheel ziglang (pip install ziglang)",
                RuntimeWarning,
                stacklevel=2,
            )
            return Reference(diagram, dt, precision, log, integrator)
    (backend,) = chosen.compile([source])
    return CompiledProgram(source, backend)


def _target(name: str, compiler: str | None, optimise: str | None, native_cpu: bool) -> Target:
    match name:
        case "native":
            return Native(compiler, optimise, native_cpu)
        case "wasm":
            return Wasm(compiler, optimise or "-O3")
        case "cortex-m7":
            return CortexM7(compiler, optimise or OPTIMISE)
    raise CompileError(f"unknown target {name!r:.80}", "", f"use one of {', '.join(TARGETS)}")


def emit_program(
    diagram: Diagram, dt: float, precision: str = "float64", log: Iterable[str] = (), integrator: str = "rk4"
) -> EmittedProgram:
    """Emit the C of `diagram`; arguments and errors as those of `build`."""
    with numbers.precision(precision):  # refuses an unknown one
        (emitted,) = emit([lower(diagram, dt, log, integrator)], precision)
    return emitted
