"""The reference and compiled programs side by side, bit for bit."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.compile.random_diagrams import Maker, random_inputs
from twodof.blocks import Diagram, numbers
from twodof.blocks.graph import walk
from twodof.blocks.numbers import Integer
from twodof.blocks.reference import Reference
from twodof.compile import native, toolchain
from twodof.compile.c99 import Source, emit
from twodof.compile.lower import lower
from twodof.compile.program import Program
from twodof.compile.target import Emitted

DT = 0.01
Columns = dict[str, NDArray[Any]]


@dataclass
class Case:
    """A diagram, the signals to compare, its inputs row by row, and the reference's results by precision."""

    diagram: Diagram
    paths: list[str]
    rows: list[dict[str, Any]]
    sources: dict[str, str]

    def columns(self) -> dict[str, Any]:
        """The inputs as columns: an input that a row does not name keeps its value."""
        present: dict[str, Any] = {
            n: (0 if p.kind != "bool" else False) if p.width is None else [0] * p.width
            for n, p in self.diagram.inputs.items()
        }
        made: dict[str, list[Any]] = {n: [] for n in present}
        for row in self.rows:
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
    return Case(diagram, maker.paths, random_inputs(seed, steps), maker.sources)


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


def reference_run(case: Case, precision: str, integrator: str) -> tuple[Columns, dict[str, Any]]:
    """Signals and last states by the reference."""
    program = Reference(case.diagram, DT, precision, case.paths, integrator)
    machine = program.machine()
    with numbers.precision(precision):
        rows = [machine.exact_step(row) for row in case.rows]
    columns = {name: _column([row[name] for row in rows], precision) for name in program.signals}
    states = {
        f"{c.path}.{s.name}": machine.state(f"{c.path}.{s.name}")
        for c in program.hierarchy.cells
        for s in c.block.states
    }
    return columns, states


def _column(values: Sequence[Any], precision: str) -> NDArray[Any]:
    def plain(v: Any) -> Any:
        if isinstance(v, tuple):
            return [plain(e) for e in v]
        return v.value if isinstance(v, Integer) else v

    made = np.array([plain(v) for v in values])
    return made.astype(precision) if made.dtype.kind == "f" else made


def sources(cases: Sequence[Case], precision: str, integrator: str) -> tuple[Source, list[Any]]:
    """All cases in one C file."""
    with numbers.precision(precision):
        lowered = [lower(c.diagram, DT, c.paths, integrator) for c in cases]
        return emit(lowered, precision), lowered


def differences(
    cases: Sequence[Case],
    expected: Sequence[tuple[Columns, dict[str, Any]]],
    source: Source,
    lowered: Sequence[Any],
    compiler: str,
    optimise: str,
    flags: Sequence[str] = (),
) -> list[str]:
    """Every signal and state that differs from the reference, described."""
    library = native.load(source.text, toolchain.find_compiler(compiler), optimise, flags=flags)
    found = []
    for case, (columns, states), flat in zip(cases, expected, lowered, strict=True):
        emitted = Emitted(flat, source.text, source.layouts[case.diagram.name], source.precision)
        machine = Program(emitted, native.NativeBackend(emitted, library)).machine()
        results = machine.run(len(case.rows), case.columns())
        for name, want in columns.items():
            at = np.flatnonzero(~same(want, results[name]))
            if at.size:
                k = int(at[0])
                found.append(f"{case.diagram.name} {name} step {k}: {want[k]} by the reference, {results[name][k]}")
        for path, last in states.items():
            state = machine.state(path)
            if not np.all(same(np.atleast_1d(np.array(last)), np.atleast_1d(np.array(state)))):
                found.append(f"{case.diagram.name} state {path}: {last} by the reference, {state}")
    return found


def same(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Row by row the same bits, all NaNs being one value."""
    if a.dtype.kind == "f":
        bits = f"u{a.dtype.itemsize}"
        same = (a.view(bits) == b.view(bits)) | (np.isnan(a) & np.isnan(b))
    else:
        same = a == b
    return same.reshape(len(a), -1).all(axis=1)
