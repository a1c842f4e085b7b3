"""What a module computes under wasmtime is, to the bit, what native code computes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blocks.library.samples import ROOMS, random_inputs, room
from tests.compile import examples
from tests.compile.differential import same
from twodof.blocks import Diagram
from twodof.blocks.expressions import numbers
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.compile.c.emitter import emit
from twodof.compile.native import Native
from twodof.compile.program.lower import lower
from twodof.compile.target import Target
from twodof.compile.wasm.target import Wasm
from twodof.flight.core import core
from twodof.rig.rig import BASE_DT
from twodof.signals import PERIOD
from twodof.sim.closed_loop import closed_loop

pytestmark = pytest.mark.slow

PRECISIONS = ("float64", "float32")
EXAMPLES = (examples.loop, examples.switched, examples.edge, examples.delay)


def batch(diagrams: list[Diagram], dt: float, precision: str, target: Target) -> Iterator[CompiledMachine]:
    """Machines of `diagrams`, all compiled from one source."""
    with numbers.precision(precision):
        programs = emit([lower(d, dt) for d in diagrams], precision)
    for program, backend in zip(programs, target.compile(programs), strict=True):
        yield CompiledProgram(program, backend).machine()


def everything(machine: CompiledMachine, runs: list[dict[str, Any]], steps: int) -> dict[str, NDArray[Any]]:
    """All outputs of the runs, one behind the other, and the states at their end."""
    found = [machine.run(steps, inputs) for inputs in runs]
    columns = {name: np.concatenate([f[name] for f in found]) for name in found[0]}
    return columns | {path: np.atleast_1d(np.array(machine.state(path))) for path in machine.program.states}


def differing(first: dict[str, NDArray[Any]], second: dict[str, NDArray[Any]]) -> list[str]:
    assert first.keys() == second.keys()
    return [name for name, a in first.items() if a.shape != second[name].shape or not same(a, second[name]).all()]


def typed(inputs: dict[str, NDArray[Any]], precision: str) -> dict[str, NDArray[Any]]:
    with np.errstate(over="ignore"):  # 1e300 is infinite in float32
        return {n: v.astype(precision) if v.dtype.kind == "f" else v for n, v in inputs.items()}


@pytest.mark.soak
@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_block_of_the_library_gives_the_bits_of_native_code(precision: str) -> None:
    """With NaN, infinities, subnormals, signed zeros and integers of all sizes among the inputs."""
    diagrams = [room(name) for name in ROOMS]
    machines = zip(*(batch(diagrams, 0.004, precision, t) for t in (Native(), Wasm())), strict=True)
    for diagram, (native, sandboxed) in zip(diagrams, machines, strict=True):
        runs = [
            typed(random_inputs(diagram, 200, seed, strange), precision) for seed, strange in ((1, False), (2, True))
        ]
        assert differing(everything(native, runs, 200), everything(sandboxed, runs, 200)) == [], diagram.name


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("make", "dt"), [(core, PERIOD), (closed_loop, BASE_DT)], ids=["flight core", "closed loop"])
def test_flight_core_and_rig_give_the_bits_of_native_code(
    make: Callable[[], Diagram], dt: float, precision: str
) -> None:
    """Over thousands of steps with set-points that change; the rig has all its noise."""
    diagram, steps = make(), 8_000
    inputs = random_inputs(diagram, steps, 5, False)
    inputs["mode"] = np.repeat(np.arange(steps // 1000, dtype=np.int32) % 6, 1000)
    inputs["thrust"] = np.full(steps, 0.4)
    machines = [build(diagram, dt, precision, target=t).machine() for t in ("native", "wasm")]
    results = [everything(m, [typed(inputs, precision)], steps) for m in machines]
    assert differing(*results) == []
    assert (
        len({row.tobytes() for row in results[0]["theta"]}) > steps // 5
    )  # it moves; the core of the rig runs at every fourth tick


@pytest.mark.parametrize("make", EXAMPLES, ids=[m.__name__ for m in EXAMPLES])
def test_single_steps_and_runs_of_any_length_are_the_same(make: Callable[[], Diagram]) -> None:
    """Longer than the rows that stand in the memory; inputs as columns and as one value."""
    program = build(make(), 0.01, target="wasm")
    assert isinstance(program, CompiledProgram)
    rows = program.backend.module.places[program.flat.name].rows
    steps = 2 * rows + 3
    inputs = random_inputs(make(), steps, 3, False)
    whole = program.machine().run(steps, inputs)
    stepped, pieces = program.machine(), program.machine()
    first = [stepped.step({n: v[k].item() for n, v in inputs.items()}) for k in range(50)]
    cuts = (0, 1, 7, rows + 9, steps)
    parts = [pieces.run(b - a, {n: v[a:b] for n, v in inputs.items()}) for a, b in itertools.pairwise(cuts)]
    for name, column in whole.items():
        assert np.array([row[name] for row in first], column.dtype).tobytes() == column[:50].tobytes()
        assert np.concatenate([p[name] for p in parts]).tobytes() == column.tobytes()
    held = {n: v[0].item() for n, v in inputs.items()}
    native = build(make(), 0.01).machine()
    ours = program.machine()
    assert differing(native.run(steps, held), ours.run(steps, held)) == []
    assert differing(native.run(1, {}), ours.run(1, {})) == []


def test_instances_do_not_share_anything() -> None:
    program = build(examples.delay(3), 0.01, target="wasm")
    one, two = program.machine(), program.machine()
    one.run(5, {"u": 1.0})
    assert two.run(5, {"u": 0.0})["y"].tolist() == [0.0] * 5
    assert one.step({})["y"] == 1.0
