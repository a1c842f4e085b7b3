"""The reference and compiled programs side by side, bit for bit, on any target."""

import itertools
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.compile.random_diagrams import Maker, random_inputs
from tests.compile.v8 import V8
from twodof.blocks import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.graph import walk
from twodof.blocks.expressions.numbers import Integer
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.c.emitter import emit
from twodof.compile.cortex_m7.processor import CortexM7
from twodof.compile.machine import CompiledProgram
from twodof.compile.native import Native
from twodof.compile.program.lower import lower
from twodof.compile.target import EmittedProgram, Target
from twodof.compile.wasm.target import Wasm

DT = 0.01
Columns = dict[str, NDArray[Any]]
States = dict[str, Any]


@dataclass
class Case:
    """A diagram, the signals to compare, its inputs row by row, and the source of its random blocks."""

    diagram: Diagram
    paths: Sequence[str]
    rows: Sequence[Mapping[str, Any]]
    sources: dict[str, str]

    def columns(self, steps: int) -> dict[str, Any]:
        """The first `steps` inputs as columns: an input that a row does not name keeps its value."""
        zero = {n: False if p.kind == "bool" else 0 for n, p in self.diagram.inputs.items()}
        present: dict[str, Any] = {
            n: zero[n] if p.width is None else [zero[n]] * p.width for n, p in self.diagram.inputs.items()
        }
        made: dict[str, list[Any]] = {n: [] for n in present}
        for row in self.rows[:steps]:
            present |= row
            for n, v in present.items():
                made[n].append(v)
        return {n: np.array(v) for n, v in made.items()}


CHEAP = 45.0  # about 25 us a step


def random_cases(seeds: Iterable[int], steps: int) -> list[Case]:
    """Random diagrams with random inputs."""
    return [_case(Maker(seed), seed, steps) for seed in seeds]


def cheap_cases(first: int, count: int, steps: int) -> list[Case]:
    """The next `count` small random diagrams that cost the reference little."""
    cases: list[Case] = []
    for seed in itertools.count(first):
        case = _case(Maker(seed, small=True), seed, steps)
        if cost(case.diagram) < CHEAP:
            cases.append(case)
        if len(cases) == count:
            return cases
    raise AssertionError


def _case(maker: Maker, seed: int, steps: int) -> Case:
    diagram = maker.diagram(f"r{seed}")
    # A signal that is logged is computed and kept: what nothing reads and what only some read is another program.
    share = (1.0, 0.3, 0.0)[seed % 3]
    chance = random.Random(seed)
    paths = [path for path in maker.paths if chance.random() < share]
    return Case(diagram, paths, random_inputs(seed, steps), maker.sources)


def cost(diagram: Diagram, ticks: float = 1.0) -> float:
    """Roughly the reference's operations in a step, each stage of an integration counted once, lest none be chosen."""
    total = 0.0
    for part in diagram.parts.values():
        often = ticks * part.rate.divider
        if isinstance(part.item, Diagram):
            total += cost(part.item, often)
            continue
        t = part.item.trace
        for e in walk([*t.outputs.values(), *t.update.values(), *t.derivative.values(), *t.project.values()]):
            weight = 30.0 if e.op == "call" else e.data[0] * 3.0 if e.op in ("build", "fold") else e.width or 1.0
            total += weight / often
        total += 5.0
    return total


@dataclass
class Judgement:
    """Reference's result for a case: signals, and states after some numbers of steps."""

    signals: Columns
    states: dict[int, States]


def reference_run(case: Case, precision: str, integrator: str, stops: Iterable[int] = ()) -> Judgement:
    """All steps of a case on the reference; the states after the last and after each of `stops`."""
    program = Reference(case.diagram, DT, precision, case.paths, integrator)
    machine = program.machine()
    wanted = {*stops, len(case.rows)}
    rows, states = [], {}
    with numbers.precision(precision):
        for k, row in enumerate(case.rows, 1):
            rows.append(machine.exact_step(row))
            if k in wanted:
                states[k] = {
                    f"{c.path}.{s.name}": machine.state(f"{c.path}.{s.name}")
                    for c in program.hierarchy.cells
                    for s in c.block.states
                }
    return Judgement({n: _column([row[n] for row in rows]) for n in program.signals}, states)


def _column(values: Sequence[Any]) -> NDArray[Any]:
    def plain(v: Any) -> Any:
        if isinstance(v, tuple):
            return [plain(e) for e in v]
        return v.value if isinstance(v, Integer) else v

    return np.array([plain(v) for v in values])


def emitted(cases: Sequence[Case], precision: str, integrator: str) -> list[EmittedProgram]:
    """All cases in one C file."""
    with numbers.precision(precision):
        return emit([lower(c.diagram, DT, c.paths, integrator) for c in cases], precision)


def changed(programs: Sequence[EmittedProgram], change: Callable[[str], str]) -> list[EmittedProgram]:
    """The programs with another C source; raises if the change changes nothing."""
    source = change(programs[0].source)
    assert source != programs[0].source
    return [replace(p, source=source) for p in programs]


def differences(
    cases: Sequence[Case],
    expected: Sequence[Judgement],
    programs: Sequence[EmittedProgram],
    target: Target,
    most: int | None = None,
) -> list[str]:
    """Every signal and state that differs from the reference within `most` steps (None: all), described."""
    found = []
    for case, want, program, backend in zip(cases, expected, programs, target.compile(programs), strict=True):
        steps = min(len(case.rows), most or len(case.rows))
        machine = CompiledProgram(program, backend).machine()
        results = machine.run(steps, case.columns(steps))
        name = case.diagram.name
        for path, column in want.signals.items():
            at = np.flatnonzero(~same(column[:steps], results[path]))
            if at.size:
                k = int(at[0])
                found.append(f"{name} {path} step {k}: {column[k]} by the reference, {results[path][k]}")
        for path, last in want.states[steps].items():
            state = machine.state(path)
            if not np.all(same(np.atleast_1d(np.array(last)), np.atleast_1d(np.array(state)))):
                found.append(f"{name} state {path} after {steps}: {last} by the reference, {state}")
    return found


def same(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Row by row the same bits, all NaNs being one value; `a` has matrices column after column, `b` as rows."""
    if a.ndim == 2 and b.ndim == 3:
        b = np.ascontiguousarray(b.transpose(0, 2, 1)).reshape(a.shape)
    if a.dtype.kind == "f":
        bits = f"u{a.dtype.itemsize}"
        same = (a.view(bits) == b.view(bits)) | (np.isnan(a) & np.isnan(b))
    else:
        same = a == b
    return same.reshape(len(a), -1).all(axis=1)


STEPS = 20_000
EMULATED_STEPS = 5_000  # on the emulated processor


@dataclass(frozen=True)
class Kind:
    """A target with the options that matter, the programs it needs, and how many steps it runs."""

    target: Target
    needs: tuple[str, ...] = ()
    steps: int = STEPS

    def differences(
        self, cases: Sequence[Case], expected: Sequence[Judgement], programs: Sequence[EmittedProgram]
    ) -> list[str]:
        """As the function of this name."""
        return differences(cases, expected, programs, self.target, self.steps)


M7 = "qemu-system-arm"
KINDS = {
    "gcc-O0": Kind(Native("gcc", "-O0", cpu=False), ("gcc",)),
    "gcc-O3": Kind(Native("gcc", "-O3", cpu=False), ("gcc",)),
    "gcc-O3-native": Kind(Native("gcc", "-O3", cpu=True), ("gcc",)),
    "zig-O0": Kind(Native("zig", "-O0", cpu=False)),
    "zig-O3": Kind(Native("zig", "-O3", cpu=False)),
    "zig-O3-native": Kind(Native("zig", "-O3", cpu=True)),
    "wasm": Kind(Wasm()),
    "v8": Kind(V8(), ("node",)),
    "m7-gcc": Kind(CortexM7("gcc"), (M7, "arm-none-eabi-gcc"), EMULATED_STEPS),
    "m7-zig": Kind(CortexM7("zig"), (M7,), EMULATED_STEPS),
}
