"""WebAssembly module of a diagram, without imports, and its interface for a host."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import CostMeter
from twodof.blocks.expressions.numbers import dtype_of
from twodof.compile.c.operators import FREESTANDING_FILES, FREESTANDING_MEMORY
from twodof.compile.program.flat_program import FlatProgram, Node
from twodof.compile.program.layout import Member
from twodof.compile.target import EmittedProgram, layout_checks
from twodof.compile.toolchain import compilers
from twodof.compile.toolchain.compilers import Compiler
from twodof.errors import CompileError

FUNCTIONS = ("defaults", "prepare", "init", "step", "run", "tick")
PAGE = 65536  # bytes
STACK = 1 << 20  # bytes; of these 320 kB for the arrays of a step
ROWS = 4096  # at most; ticks whose inputs and outputs stand in the memory at once
ROW_BYTES = 1 << 18  # of all rows of one program, if one row is not larger
LARGEST = 256 << 20  # bytes of memory that a module may have
OPTIMISATION_BUDGET = 100_000_000
"""`EmittedProgram.cost` above which code is not optimised, as zig's -O3 would need 4 s and soon much longer."""
INTERFACE = 1  # version of what `WasmModule.interface` returns

FLAGS = (
    *compilers.FLAGS,
    "-ffreestanding",  # no library; the loops of our memset must not become a call of it
    "-mno-bulk-memory",  # filling and copying cost fuel as other loops do
    "-g0",
    "-I.",
    "-nostdlib",
    "-Wl,--no-entry",
    "-Wl,--strip-all",
    f"-Wl,-z,stack-size={STACK}",
)


@dataclass(frozen=True)
class WasmAddresses:
    """Addresses of a program's structs, and of arrays of `rows` further inputs and outputs, in the module's memory."""

    structs: Mapping[str, int]
    inputs: int
    outputs: int
    rows: int
    end: int

    @classmethod
    def of(cls, program: EmittedProgram) -> WasmAddresses:
        """Place the structs between the stack, which ends at STACK, and the constants, from `end` on."""
        sizes = dict(zip("PSUY", program.sizes[1:], strict=True))
        rows = max(1, min(ROWS, ROW_BYTES // (sizes["U"] + sizes["Y"])))
        found, at = {}, STACK
        wanted = [*sizes.items(), ("inputs", rows * sizes["U"]), ("outputs", rows * sizes["Y"])]
        for name, size in wanted:
            found[name] = at
            at += -(-size // 16) * 16
        if at > LARGEST:
            raise CompileError(
                f"it needs {at >> 20} MiB of memory, the sandbox gives {LARGEST >> 20}", program.name, "shorten delays"
            )
        return cls({k: found[k] for k in "PSUY"}, found["inputs"], found["outputs"], rows, at)


@dataclass(frozen=True)
class WasmModule:
    """A module: `data` is the .wasm, `pages` its memory in pages of 64 KiB, `programs` by the prefix of their names."""

    data: bytes
    pages: int
    programs: Mapping[str, EmittedProgram]
    places: Mapping[str, WasmAddresses]

    def interface(self, name: str | None = None) -> dict[str, Any]:
        """Return the interface of the program `name`, by default the first: see docs/reference/compilation.md.

        It is plain data for JSON, with None for an infinite bound. Addresses are in the module's memory, in bytes.
        """
        name = name or next(iter(self.programs))
        program, places = self.programs[name], self.places[name]
        layout, flat = program.layout, program.flat
        sizes = dict(zip("PSUY", program.sizes[1:], strict=True))
        return {
            "twodof": INTERFACE,
            "name": name,
            "dt": flat.dt,
            "precision": program.precision,
            "pages": self.pages,
            "fuel": step_fuel(program),
            "functions": {f: f"{name}_{f}" for f in FUNCTIONS},
            "structs": {k: {"address": places.structs[k], "size": sizes[k]} for k in "PSUY"},
            "rows": {
                "count": places.rows,
                "U": {"address": places.inputs, "stride": sizes["U"]},
                "Y": {"address": places.outputs, "stride": sizes["Y"]},
            },
            "parameters": [
                _entry(program, places, "P", m, path)
                | {"low": _finite(q.declared.low), "high": _finite(q.declared.high), "tunable": q.declared.tunable}
                for path, q in flat.parameters.items()
                for m in (layout.parameters[q],)
            ],
            "inputs": [_entry(program, places, "U", layout.inputs[s], path) for path, s in flat.inputs.items()],
            "outputs": [_entry(program, places, "Y", layout.outputs[path], path) for path in flat.outputs],
            "states": [
                _entry(program, places, "S", layout.states[node, s.name], f"{node.path}.{s.name}", s.continuous)
                for node in flat.nodes
                for s in node.block.states
            ],
        }


def _entry(
    program: EmittedProgram, places: WasmAddresses, struct: str, member: Member, path: str, continuous: bool = False
) -> dict[str, Any]:
    """Return a member's path, unit, type, number of elements and address."""
    offset, _ = program.places[struct][f"x.{member.name}" if continuous else member.name]
    return {
        "path": path,
        "unit": member.unit,
        "type": dtype_of(member.kind, program.precision).name,
        "count": member.width or 1,
        "array": member.width is not None,
        "address": places.structs[struct] + offset,
    }


def _finite(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None


def find_wasm_compiler(name: str | None = None) -> Compiler:
    """Return the compiler `name` ("zig", "clang" or a path to a clang), by default the first that is installed.

    Raises CompileError, which names the package to install, if there is none.
    """
    if name in (None, "zig") and compilers.find_zig():
        found = compilers.find_compiler("zig")
        return Compiler(found.name, found.command, (*found.flags, "-target", "wasm32-freestanding"))
    clang = None if name == "zig" else shutil.which(name or "clang")
    linker = shutil.which("wasm-ld")
    if clang and "clang" in clang and linker:
        # --stack-first: so that a stack that overflows leaves the memory instead of overwriting constants.
        return Compiler("clang", (clang,), ("--target=wasm32", f"-fuse-ld={linker}", "-Wl,--stack-first"))
    what = f"no compiler {name!r:.80} for WebAssembly was found" if name else "no compiler for WebAssembly was found"
    remedy = "run `pip install ziglang` where twodof is installed, or install clang and lld"
    raise CompileError(what, "target wasm", remedy)


def compile_module(
    programs: Sequence[EmittedProgram], compiler: str | None = None, optimise: str = "-O3"
) -> WasmModule:
    """Compile `programs`, which share one source, to one module. No engine is needed.

    Code that would take too long to optimise (`EmittedProgram.cost`) is compiled with -O0 in place of `optimise`.
    Raises CompileError if the compiler is missing or refuses, or if a program needs too much memory.
    """
    found = find_wasm_compiler(compiler)
    places = {p.name: WasmAddresses.of(p) for p in programs}
    functions = [f"{p.name}_{f}" for p in programs for f in FUNCTIONS]
    start = max(p.end for p in places.values())
    # Constants stand in the source: a number of 4 bytes with 2 characters at least, one of 8 bytes with 7.
    pages = -(-(start + 2 * len(programs[0].source)) // PAGE) + 1
    if pages * PAGE > LARGEST:
        what = f"it needs {pages * PAGE >> 20} MiB of memory, the sandbox gives {LARGEST >> 20}"
        raise CompileError(what, ", ".join(list(places)[:3]), "shorten tables")
    options = (
        *FLAGS,
        "-O0" if programs[0].cost > OPTIMISATION_BUDGET else optimise,
        *found.flags,
        f"-Wl,--global-base={start}",
        f"-Wl,--initial-memory={pages * PAGE}",  # which is also the largest: it cannot grow
        f"-Wl,--max-memory={pages * PAGE}",
        *(f"-Wl,--export={f}" for f in functions),
    )
    ticks = (_tick(p.name, places[p.name]) for p in programs)
    source = "".join([programs[0].source, *ticks, FREESTANDING_MEMORY, layout_checks(programs)])
    data = compilers.compiled(source, found, options, ".wasm", Path.read_bytes, files=FREESTANDING_FILES)
    return WasmModule(data, pages, {p.name: p for p in programs}, places)


def _tick(name: str, places: WasmAddresses) -> str:
    """Return the C of a step on the structs at their places: without arguments a call takes a quarter of the time."""
    arguments = ", ".join(
        f"({const}{name}_{k} *){places.structs[k]}u"
        for k, const in (("P", "const "), ("S", ""), ("U", "const "), ("Y", ""))
    )
    return f"""
void {name}_tick(void);
void {name}_tick(void)
{{
    {name}_step({arguments});
}}
"""


PER_OPERATION = 100
PER_BYTE = 8
AT_LEAST = 10_000


def step_fuel(program: EmittedProgram) -> int:
    """Return the fuel for one call of a function other than `run`: about as many instructions of WebAssembly.

    It is an upper bound with a wide margin: PER_OPERATION for each operation of the language on any path, PER_BYTE for
    each byte that is filled or copied, and AT_LEAST. If a program needs more, it or its compiler has a fault.
    """
    return PER_OPERATION * operations(program.flat) + PER_BYTE * sum(program.sizes[1:]) + AT_LEAST


def operations(program: FlatProgram) -> int:
    """Return a bound of the number of the language's operations in a step; one on an array counts its elements."""
    stages = (4 if program.integrator == "rk4" else 1) * (len(program.edged) + 1)
    continuous = bool(program.integrated)
    total = 0
    for node in program.nodes:
        trace = node.trace
        edges = [e for pair in trace.edges.values() for e in pair]
        outputs = list(trace.outputs.values())
        once = _cost([*outputs, *edges, *trace.update.values(), *trace.project.values(), *trace.prepare.values()])
        again = _cost([*outputs, *trace.derivative.values()]) if continuous else 0
        total += once + stages * again + _moved(node)
    return total


def _cost(expressions: Iterable[Expr]) -> int:
    return CostMeter(None).measure(expressions).operations


def _moved(node: Node) -> int:
    """Return the operations that hold, reset, zero and commit values: a few for each element."""
    block = node.block
    started = len(node.starts) * sum(s.width or 1 for s in block.states)
    declared: list[Port | State | Param] = [*block.states, *block.outputs, *block.inputs, *block.params]
    return sum(4 * (d.width or 1) for d in declared) + started + 8
