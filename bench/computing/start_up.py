"""How long it takes to begin: the import, and from a diagram to loaded native code, each in processes of their own."""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from bench.measure import Figure
from twodof.blocks import Diagram
from twodof.blocks.library import Gain, LowPass, Saturation, Sum, Trigonometry, UnitDelay
from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError

IMPORT_SECONDS = 0.3
BUILD_SECONDS = 1.0
LARGE = 900
PROJECT = Path(__file__).resolve().parents[2]

IMPORT = """
import time
start = time.perf_counter()
import {module}
print(time.perf_counter() - start)
"""

# Each round compiles another source, its tick differs in the last digits, so that no cache knows it.
BUILD = """
import json, sys, time
from bench.computing.start_up import large_diagram
from twodof.compile import build
from twodof.compile.builder import emit_program
from twodof.sim.closed_loop import closed_loop

def make():
    return closed_loop() if sys.argv[1] == "closed_loop" else large_diagram(int(sys.argv[1]))

found = []
for k in range(int(sys.argv[3])):
    dt = 0.001 * (1.0 + 1e-9 * k)
    start = time.perf_counter()
    build(make(), dt, compiler=sys.argv[2])
    built = time.perf_counter()
    build(make(), dt, compiler=sys.argv[2])
    again = time.perf_counter()
    emit_program(make(), dt)
    found.append([built - start, again - built, time.perf_counter() - again])
print(json.dumps(found))
"""


def large_diagram(blocks: int) -> Diagram:
    """At least `blocks` blocks: rows of six; each is a loop of a gain, sum, low-pass, limit, sine and delay."""
    d = Diagram(f"large_{blocks}")
    d.input("u")
    last = "u"
    for k in range(0, blocks, 6):
        d.add(f"gain_{k}", Gain(1.0 + 1e-3 * k), u=last)
        d.add(f"sum_{k}", Sum("+-"), a=f"gain_{k}", b=f"delay_{k}")
        d.add(f"low_pass_{k}", LowPass(5.0 + 0.01 * k), u=f"sum_{k}")
        d.add(f"limit_{k}", Saturation(-2.0, 2.0), u=f"low_pass_{k}")
        d.add(f"sine_{k}", Trigonometry("sin"), u=f"limit_{k}")
        d.add(f"delay_{k}", UnitDelay(), u=f"sine_{k}")
        last = f"sine_{k}"
    d.output("y", last)
    return d


def fresh_python(code: str, *arguments: str, environment: Mapping[str, str] | None = None) -> str:
    """Run `code` in a fresh interpreter and return its output. Raises CompileError if it fails."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        cwd=PROJECT,
        env={**os.environ, **(environment or {})},
        timeout=600,
        check=False,
    )
    if done.returncode:
        raise CompileError(done.stderr.strip()[-2000:], "bench.computing.start_up", "run it alone to see more")
    return done.stdout


def import_seconds(module: str, repeats: int) -> list[float]:
    """Time [s] of `import module` in fresh interpreters, their own start left out."""
    return [float(fresh_python(IMPORT.format(module=module))) for _ in range(repeats)]


def build_seconds(what: str, compiler: str, rounds: int) -> list[tuple[float, float, float]]:
    """(new source, the same again from the cache, only tracing and emitting) [s] for "closed_loop" or a number of
    blocks. The caches are empty, except for what zig keeps of its own runtime.
    """
    with tempfile.TemporaryDirectory(prefix="twodof-bench-") as folder:
        environment = {
            "TWODOF_CACHE": f"{folder}/cache",
            "ZIG_GLOBAL_CACHE_DIR": f"{folder}/zig",
            "ZIG_LOCAL_CACHE_DIR": f"{folder}/zig",
        }
        if compiler == "zig":
            fresh_python(BUILD, "6", compiler, "1", environment=environment)
        said = fresh_python(BUILD, what, compiler, str(rounds), environment=environment)
        return [tuple(row) for row in json.loads(said)]


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs. Raises CompileError without a compiler."""
    repeats, rounds = (1, 1) if quick else (7, 5)
    figures = []
    for module, target in (("twodof", IMPORT_SECONDS), ("twodof.sim.closed_loop", None)):
        took = import_seconds(module, repeats)
        figures.append(
            Figure(
                f"import {module}",
                min(took),
                "s",
                target,
                at_most=True,
                remark=f"best of {len(took)}; first {took[0]:.3f}, median {statistics.median(took):.3f}",
            )
        )
    for compiler in _compilers()[: 1 if quick else None]:
        for what, name, target in (
            ("60" if quick else "closed_loop", "closed loop", BUILD_SECONDS),
            ("60" if quick else str(LARGE), f"{60 if quick else LARGE} blocks", None),
        ):
            took = build_seconds(what, compiler, rounds if what == "closed_loop" else 1)
            new, again, emitted = (min(row[i] for row in took) for i in range(3))
            first = f"first {took[0][0]:.2f}; " if len(took) > 1 else ""
            figures += [
                Figure(
                    f"{name}: source to loaded native code, {compiler}",
                    new,
                    "s",
                    target,
                    at_most=True,
                    remark=f"{first}of which tracing and emitting {emitted:.3f}",
                ),
                Figure(f"{name}: the same from the cache, {compiler}", again, "s"),
            ]
    return figures


def _compilers() -> list[str]:
    found = []
    for name in ("cc", "zig"):
        try:
            find_compiler(name)
        except CompileError:
            continue
        found.append(name)
    if not found:
        raise CompileError("no C compiler was found", "bench", "install cc, or the wheel ziglang")
    return found
