"""Many copies of one block: flash of 64 PIDs on the Cortex-M7, and compiling time of 2,400 blocks."""

from __future__ import annotations

from bench.computing.start_up import build_seconds
from bench.measure import Figure
from twodof.blocks import Diagram
from twodof.blocks.library import Pid
from twodof.compile.builder import emit_program
from twodof.compile.c.freestanding import layout_checks
from twodof.compile.cortex_m7.image import build_image, find_cross_compiler
from twodof.compile.cortex_m7.report import FUNCTIONS
from twodof.compile.cortex_m7.usage import Usage
from twodof.errors import CompileError

MANY = 64
FLASH_BYTES = 8000
LARGE = 2400
SECONDS = 6.0
PERIOD = 0.001


def bank(count: int) -> Diagram:
    """`count` PIDs of different gains, each with an input and an output of its own."""
    d = Diagram(f"bank_{count}")
    for k in range(count):
        d.input(f"e{k}")
        d.add(f"pid{k}", Pid(1.0 + 0.01 * k, 0.1 * k, 0.01), e=f"e{k}")
        d.output(f"M{k}", f"pid{k}")
    return d


def flash(count: int, precision: str, compiler: str = "gcc") -> int:
    """Bytes of flash of `count` PIDs: step, start and constants. Raises CompileError without a cross compiler."""
    program = emit_program(bank(count), PERIOD, precision)
    source = program.source + layout_checks([program])
    image = build_image(source, [(program.name, program.sizes)], find_cross_compiler(compiler))
    return Usage(image).sizes([f"{program.name}_{name}" for name in FUNCTIONS]).flash


def run(quick: bool = False) -> list[Figure]:
    """The figures; without a cross compiler only the compiling time."""
    figures = []
    for precision in ("float64", "float32")[: 1 if quick else None]:
        try:
            few, many = flash(MANY // 2, precision), flash(MANY, precision)
        except CompileError as error:
            figures.append(Figure("flash not measured", 0.0, "", remark=str(error)))
            break
        remark = f"{(many - few) / (MANY - MANY // 2):.0f} for one more"
        figures.append(
            Figure(f"{precision}: {MANY} PIDs", many, "bytes of flash", FLASH_BYTES, at_most=True, remark=remark)
        )
    blocks = 60 if quick else LARGE
    new, _, emitted = build_seconds(str(blocks), "cc", 1)[0]
    remark = f"of which tracing and emitting {emitted:.2f}"
    name = f"{blocks} blocks: source to loaded native code"
    return [*figures, Figure(name, new, "s", SECONDS, at_most=True, remark=remark)]
