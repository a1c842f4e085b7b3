"""Lanes and scalar programs side by side, bit for bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.compile.differential import DT, Case, emitted, same
from twodof.blocks import Diagram
from twodof.blocks.expressions import numbers
from twodof.compile.c.emitter import emit
from twodof.compile.lanes.lanes_program import LanesMachine, LanesProgram, compile_lanes, shape
from twodof.compile.lanes.style import LaneStyle as Style
from twodof.compile.machine import CompiledMachine, CompiledProgram
from twodof.compile.native.target import Native
from twodof.compile.program.lower import lower
from twodof.compile.toolchain import compilers

SPECIAL = (
    float("nan"),
    float("inf"),
    -float("inf"),
    -0.0,
    0.0,
    5e-324,
    1e-310,
    1e-40,
    -1e-45,
    1e308,
    3e38,
    4294967296.5,
)
"""Values for single inputs of single lanes: NaN, infinities, zeros, subnormals of both precisions, ends of ranges."""

Columns = dict[str, NDArray[Any]]


def lane_programs(
    cases: Sequence[Case],
    precision: str,
    integrator: str,
    lanes: int,
    simd: str,
    compiler: str | None = None,
    optimise: str = "-O1",
) -> list[LanesProgram]:
    """All cases for `lanes` instances each, in one C file."""
    with numbers.precision(precision):
        lowered = [lower(c.diagram, DT, c.paths, integrator) for c in cases]
        programs = emit(lowered, precision, style=Style(shape(simd, precision)))
    return compile_lanes(programs, lanes, simd, compilers.find_compiler(compiler), optimise)


def spread_inputs(case: Case, lanes: int, seed: int) -> Columns:
    """Inputs (steps, lanes[, width]): lane 0 has the case's own, the others random ones, with special values."""
    rng = np.random.default_rng(seed)
    inputs = {}
    for name, column in case.columns(len(case.rows)).items():
        made = np.repeat(column[:, np.newaxis], lanes, axis=1)
        others = made[:, 1:]
        if made.dtype.kind == "f":
            others += rng.normal(0.0, 1.0, others.shape) * (rng.random(others.shape) < 0.3)
            odd = rng.random(others.shape) < 0.02
            others[odd] = rng.choice(SPECIAL, int(odd.sum()))
        elif made.dtype.kind == "b":
            others ^= rng.random(others.shape) < 0.2
        else:
            odd = rng.random(others.shape) < 0.1
            others[odd] = rng.integers(0, 50, int(odd.sum()))
        inputs[name] = made
    return inputs


def vary(machine: LanesMachine, lanes: int, seed: int) -> dict[str, list[Any]]:
    """Sets each lane's tunable scalar real parameters but lane 0's within their bounds; returns what was set."""
    rng = np.random.default_rng(seed)
    values = {}
    for path, p in machine.parameters.items():
        if p.kind == "real" and p.width is None:
            spread = float(p.value) * (1.0 + rng.uniform(-0.3, 0.3, lanes))
            spread[0] = float(p.value)
            values[path] = np.clip(spread, p.low, p.high).tolist()
    machine.set_many(values)
    machine.reset()
    return values


def lane_differences(
    cases: Sequence[Case],
    precision: str,
    integrator: str,
    simd: str,
    lanes: int = 9,
    compiler: str | None = None,
    optimise: str = "-O1",
) -> list[str]:
    """Every signal and state of a lane that differs from the scalar program's (compiled without vectors), described.

    Lane 0 has the case's own inputs and parameters, the other lanes others.
    """
    scalar = emitted(cases, precision, integrator)
    backends = Native(compiler, "-O1", cpu=False).compile(scalar)
    found = []
    for seed, (case, program, lone, backend) in enumerate(
        zip(
            cases,
            lane_programs(cases, precision, integrator, lanes, simd, compiler, optimise),
            scalar,
            backends,
            strict=True,
        )
    ):
        machine = program.machine()
        parameters = vary(machine, lanes, seed)
        inputs = spread_inputs(case, lanes, seed)
        results = machine.run(len(case.rows), inputs)
        for lane in range(lanes):
            single = CompiledProgram(lone, backend).machine()
            single.set_many({path: values[lane] for path, values in parameters.items()})
            single.reset()
            want = single.run(len(case.rows), {n: np.ascontiguousarray(v[:, lane]) for n, v in inputs.items()})
            found += compared(case.diagram, lane, want, results, single, machine)
    return found


def compared(
    diagram: Diagram,
    lane: int,
    want: Mapping[str, Any],
    results: Mapping[str, Any],
    single: CompiledMachine,
    machine: LanesMachine,
) -> list[str]:
    """What differs between a scalar machine and a lane, described."""
    found = []
    for path, column in want.items():
        ours = np.ascontiguousarray(results[path][:, lane])
        at = np.flatnonzero(~same(column, ours))
        if at.size:
            k = int(at[0])
            found.append(f"{diagram.name} lane {lane} {path} step {k}: {column[k]} alone, {ours[k]} in the lane")
    for path in single.program.states:
        ours = np.atleast_1d(machine.state(path)[lane])
        alone = np.atleast_1d(np.array(single.state(path), dtype=ours.dtype))
        if not same(alone, ours).all():
            found.append(f"{diagram.name} lane {lane} state {path}: {alone} alone, {ours} in the lane")
    return found
