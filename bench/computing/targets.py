"""The targets: how soon a changed diagram runs on each, and how fast WebAssembly is beside native code."""

import json
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench.computing.closed_loop import HOVER, CompiledLoop, numbered
from bench.computing.start_up import LARGE, fresh_python
from bench.measure import Figure, one_core, timed
from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError

WARM_SECONDS = 1.0
COLD_SECONDS = 5.0
LARGE_SECONDS = 3.0

# Each round changes one block, so that no cache knows the source; the last thing timed is the first step.
CHANGED = """
import json, resource, sys, time
from bench.computing.start_up import large_diagram
from twodof.blocks.library import Gain
from twodof.compile import build
from twodof.sim.closed_loop import closed_loop

what, target, compiler, rounds = sys.argv[1:]
output = "true_theta" if what == "closed_loop" else "y"
def worked():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)

found = []
for k in range(int(rounds)):
    start, before = time.perf_counter(), worked()
    diagram = closed_loop() if what == "closed_loop" else large_diagram(int(what))
    diagram.add("changed", Gain(1.0 + 0.001 * k), u=diagram.outputs[output])
    diagram.output("changed", "changed")
    machine = build(diagram, 0.001, target=target, compiler=compiler or None).machine()
    machine.step()
    found.append([time.perf_counter() - start, worked() - before])
print(json.dumps(found))
"""


@dataclass(frozen=True)
class Changed:
    """Times of each round [s]: wall-clock time and CPU time, compilers included.

    `process` is the time of the whole process, with the start of Python and all imports.
    """

    wall: tuple[float, ...]
    work: tuple[float, ...]
    process: float

    def figure(self, name: str, target: float | None) -> Figure:
        """The best round."""
        remark = f"best of {len(self.wall)}, worst {max(self.wall):.2f}; {min(self.work):.2f} s of CPU time"
        return Figure(name, min(self.wall), "s", target, at_most=True, remark=remark)


def changed(what: str, target: str, compiler: str, rounds: int, warm: bool) -> Changed:
    """From a changed block of "closed_loop", or of a number of blocks, to its first step done. All caches, zig's own
    too, are empty at first; `warm` builds something else before.
    """
    with tempfile.TemporaryDirectory(prefix="twodof-bench-") as folder:
        environment = {
            "TWODOF_CACHE": f"{folder}/cache",
            "ZIG_GLOBAL_CACHE_DIR": f"{folder}/zig",
            "ZIG_LOCAL_CACHE_DIR": f"{folder}/zig",
        }
        if warm:
            fresh_python(CHANGED, "6", target, compiler, "1", environment=environment)
        start = time.perf_counter()
        rows = json.loads(fresh_python(CHANGED, what, target, compiler, str(rounds), environment=environment))
        process = time.perf_counter() - start
    wall, work = zip(*rows, strict=True)
    return Changed(wall, work, process)


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs. Raises CompileError without any compiler."""
    rounds, large = (1, 60) if quick else (5, LARGE)
    figures: list[Figure] = []
    for target in ("wasm", "native")[: 1 if quick else None]:
        took = changed("closed_loop", target, "zig", 1, warm=False)
        remark = "a fresh process with all its imports; all caches empty, zig's own too"
        name = f"closed loop running, cold, {target} by zig"
        figures.append(Figure(name, took.process, "s", COLD_SECONDS, at_most=True, remark=remark))
    for target, compiler in _targets()[: 1 if quick else None]:
        by = f"changed block to running, {target} by {compiler}"
        goal = WARM_SECONDS if target in ("native", "wasm") else None
        loop = changed("closed_loop", target, compiler, rounds, warm=not quick)
        many = changed(str(large), target, compiler, min(rounds, 2), warm=not quick)
        figures += [loop.figure(f"closed loop, {by}", goal), many.figure(f"{large} blocks, {by}", LARGE_SECONDS)]
    with one_core():
        return [*figures, *_speed(quick)]


def _targets() -> list[tuple[str, str]]:
    found = [("wasm", "zig"), ("native", "zig")]
    for name in ("cc", "clang"):
        try:
            find_compiler(name)
        except CompileError:
            continue
        found.append(("native", name))
    if shutil.which("qemu-system-arm"):
        found.append(("cortex-m7", "zig"))
    if shutil.which("qemu-system-arm") and shutil.which("arm-none-eabi-gcc"):
        found.append(("cortex-m7", "gcc"))
    return found


def _speed(quick: bool) -> list[Figure]:
    ticks, calls, repeats = (100, 10, 2) if quick else (20_000, 2000, 9)
    hover, figures = numbered(HOVER), []
    for precision in ("float64", "float32"):
        loops = [CompiledLoop(precision, target=target) for target in ("native", "wasm")]
        native, sandboxed = timed([partial(loop.spin, ticks, hover) for loop in loops], repeats)
        metered = f"metered by fuel; {sandboxed.median / native.median:.2f} times native's time"
        figures += [
            Figure(f"{precision}: closed loop, native", ticks / native.median, "steps/s"),
            Figure(f"{precision}: closed loop, WebAssembly", ticks / sandboxed.median, "steps/s", remark=metered),
        ]
        if precision == "float64":
            took = timed([partial(_calls, loop.machine.step, calls) for loop in loops], repeats)
            figures += [
                Figure(f"one call of Machine.step, {name}", 1e6 * one.median / calls, "us", remark="26 outputs")
                for name, one in zip(("native", "WebAssembly"), took, strict=True)
            ]
    return figures


def _calls(function: Callable[[], Any], calls: int) -> None:
    for _ in range(calls):
        function()
